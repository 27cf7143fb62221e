//! Both sides of joining, as state machines without a clock or a socket.
//!
//! ```text
//! joiner                                     inviter
//!   Hello(nonce)                        ──▶
//!                                       ◀──  Offer(team, who I am, nonce, signature)
//!   is that the team of the line?
//!   Proof(keys, name, sealed secret, signature) ──▶
//!                                              is it an open invitation? spend it on the disk, sign
//!                                       ◀──  Welcome(certificate)
//! ```

use super::message::{Hello, Message, Offer, Proof, Welcome, offered, place, proven, secret};
use super::{Invite, hash};
use crate::certificate::{Certificate, Claims, ClaimsError, LIFE_MAX, RENEWABLE_MAX};
use crate::identity::{Entropy, KeyId, PublicKeys, SecretKeys};
use crate::name::{Name, UnixTime};
use crate::revocation::Revocations;
use crate::role::{Action, Role};
use crate::seal::{Place, Sealed, Secret};
use crate::team::{Credential, Judge, Team, TrustError};
use std::collections::BTreeMap;
use thiserror::Error;
use zeroize::Zeroizing;

/// The most invitations that may be open at a time.
pub const INVITES_MAX: usize = 256;

/// Why joining failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum JoinError {
    /// The invitation has ended.
    #[error("the invitation has ended; ask for a new invitation")]
    Expired,
    /// The other side does not belong to the team in the line.
    #[error("the answer is not from the team of the invitation")]
    OtherTeam,
    /// The other side has no right to invite.
    #[error("the answering member may not invite: {0}")]
    Inviter(TrustError),
    /// A signature is not valid.
    #[error("the answering member has not signed its message")]
    Signature,
    /// A message is not expected in this state.
    #[error("an unexpected message came")]
    Unexpected,
    /// The other side refuses.
    #[error("the inviter refuses: the invitation was already used, has ended, or is not from this inviter")]
    Refused,
    /// The secret does not belong to an open invitation.
    #[error("a host tried to join without an open invitation")]
    NoInvite,
    /// There are too many open invitations.
    #[error("no more than {INVITES_MAX} invitations can be open")]
    Full,
    /// The certificate cannot be made.
    #[error("the certificate cannot be made: {0}")]
    Claims(ClaimsError),
    /// The received certificate does not belong to the joiner.
    #[error("the received certificate is for another member")]
    NotOurs,
    /// The received certificate is not valid.
    #[error("the received certificate is not valid: {0}")]
    Certificate(TrustError),
}

/// The side of the joining robot.
#[derive(Debug)]
pub struct Joiner {
    invite: Invite,
    name: Name,
    keys: SecretKeys,
    entropy: Entropy,
    nonce: [u8; 32],
    /// The team and the inviter, once they are checked.
    offer: Option<Box<Offer>>,
}

impl Joiner {
    /// Begins to join; returns the first message.
    ///
    /// # Errors
    /// If the invitation has ended.
    pub fn begin(
        invite: Invite,
        name: Name,
        keys: SecretKeys,
        now: UnixTime,
        mut entropy: Entropy,
    ) -> Result<(Self, Message), JoinError> {
        if now > invite.expires {
            return Err(JoinError::Expired);
        }
        let nonce = entropy.bytes();
        Ok((Self { invite, name, keys, entropy, nonce, offer: None }, Message::Hello(Hello { nonce })))
    }

    /// Checks the inviter's offer, and returns the proof.
    ///
    /// # Errors
    /// If the team is not the team in the line, or the inviter has no right to invite.
    pub fn offered(&mut self, offer: Offer, now: UnixTime) -> Result<Message, JoinError> {
        if offer.team.id() != self.invite.team {
            return Err(JoinError::OtherTeam);
        }
        let inviter = inviter(&offer, now)?;
        let said = offered(&offer.team, (&self.nonce, &offer.nonce));
        if !inviter.has_signed(&said, &offer.signature) {
            return Err(JoinError::Signature);
        }
        let keys = *self.keys.public();
        let sealed = self.seal(&said, inviter, offer.team.id());
        let signature = self.keys.sign(&proven(&said, &self.name, &keys, &sealed));
        self.offer = Some(Box::new(offer));
        Ok(Message::Proof(Box::new(Proof { name: self.name.clone(), keys, sealed, signature })))
    }

    /// Seals the secret for the inviter; it is valid only for this conversation and these keys.
    fn seal(&mut self, said: &[u8], inviter: PublicKeys, team: KeyId) -> Sealed {
        let path = place(said, self.keys.public());
        let secret = Secret::new(Zeroizing::new(self.invite.secret.to_vec())).expect("16 bytes are not too long");
        let place = Place { team, path: &path };
        Sealed::seal(&secret, &place, &[inviter], &mut self.entropy).expect("one reader, a short path")
    }

    /// Takes the certificate; returns the keys, the team, and the credential to store.
    ///
    /// # Errors
    /// If the certificate does not belong to the joiner, or is not valid.
    pub fn welcomed(self, welcome: Welcome, now: UnixTime) -> Result<(SecretKeys, Team, Credential), JoinError> {
        let offer = *self.offer.ok_or(JoinError::Unexpected)?;
        let claims = welcome.certificate.claims();
        // The inviter may have chosen another name, but not another kind.
        if claims.keys != *self.keys.public() || welcome.certificate.kind() != crate::role::Kind::Node {
            return Err(JoinError::NotOurs);
        }
        let issuer = offer.inviter.map(|credential| credential.chain.certificate);
        let credential = Credential::new(welcome.certificate, issuer);
        let judge = Judge { team: &offer.team, revoked: &Revocations::default(), now, grace: 0 };
        credential.check(&judge).map_err(JoinError::Certificate)?;
        Ok((self.keys, offer.team, credential))
    }
}

/// Returns the keys of a permitted inviter. The joiner does not know the team's revocations yet: the inviter sends them later.
fn inviter(offer: &Offer, now: UnixTime) -> Result<PublicKeys, JoinError> {
    let Some(credential) = &offer.inviter else { return Ok(*offer.team.root()) };
    let judge = Judge { team: &offer.team, revoked: &Revocations::default(), now, grace: 0 };
    credential.require(Action::Invite, &judge).map_err(JoinError::Inviter)?;
    Ok(credential.certificate().claims().keys)
}

/// An unused invitation, as stored by the inviter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OpenInvite {
    /// The time at which the invitation ends.
    pub expires: UnixTime,
    /// The role of the robot that joins with this invitation: [`Role::Member`] or [`Role::Renewer`].
    pub role: Role,
    /// The name of the robot. If there is none, the robot gets the name that it prefers.
    pub name: Option<Name>,
}

/// The effects of the inviter, to be executed in this order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InviterEffect {
    /// Write to the disk that the invitation with this hash is used, with the certificate for the joiner.
    Spend([u8; 32], Box<Certificate>),
    /// Then answer.
    Reply(Message),
}

/// The side of the inviter. It has keys that may sign certificates: the team's key, or an admin's.
#[derive(Debug)]
pub struct Inviter {
    team: Team,
    keys: SecretKeys,
    credential: Option<Credential>,
    open: BTreeMap<[u8; 32], OpenInvite>,
    /// The used invitations, by their hash. If the answer was lost and the robot repeats its proof, it gets its certificate again.
    used: BTreeMap<[u8; 32], Certificate>,
}

impl Inviter {
    /// Takes the team, and the keys and credential of the inviter; no credential for the team's own key.
    pub fn new(team: Team, keys: SecretKeys, credential: Option<Credential>) -> Self {
        let (open, used) = (BTreeMap::new(), BTreeMap::new());
        Self { team, keys, credential, open, used }
    }

    /// Opens an invitation.
    ///
    /// # Errors
    /// If there are too many, including those that have ended.
    pub fn open(&mut self, hash: [u8; 32], invite: OpenInvite, now: UnixTime) -> Result<(), JoinError> {
        self.open.retain(|_, open| now <= open.expires);
        if self.open.len() >= INVITES_MAX {
            return Err(JoinError::Full);
        }
        self.open.insert(hash, invite);
        Ok(())
    }

    /// Answers a robot that wants to join. `own` is the inviter's random number for this conversation; the caller also passes it to
    /// [`Inviter::proven`].
    pub fn hello(&self, hello: &Hello, own: [u8; 32]) -> Message {
        let signature = self.keys.sign(&offered(&self.team, (&hello.nonce, &own)));
        let inviter = self.credential.clone();
        Message::Offer(Box::new(Offer { team: self.team.clone(), inviter, nonce: own, signature }))
    }

    /// Checks a proof, uses up the invitation, and signs a certificate. Earlier failed proofs have no effect on a correct one.
    ///
    /// # Errors
    /// If the proof does not belong to an open invitation. The answer is then [`Message::Refused`].
    pub fn proven(
        &mut self,
        nonces: (&[u8; 32], &[u8; 32]),
        proof: &Proof,
        now: UnixTime,
        entropy: &mut Entropy,
    ) -> Result<Vec<InviterEffect>, JoinError> {
        let hash = self.opened(nonces, proof).ok_or(JoinError::NoInvite)?;
        if let Some(given) = self.used.get(&hash).filter(|given| given.claims().keys == proof.keys) {
            return Ok(vec![reply(given.clone())]);
        }
        let open = self.open.get(&hash).cloned().filter(|open| now <= open.expires).ok_or(JoinError::NoInvite)?;
        let certificate = self.issue(proof, open, now, entropy).map_err(JoinError::Claims)?;
        self.open.remove(&hash);
        if self.used.len() >= INVITES_MAX {
            self.used.pop_first();
        }
        self.used.insert(hash, certificate.clone());
        Ok(vec![InviterEffect::Spend(hash, Box::new(certificate.clone())), reply(certificate)])
    }

    /// Opens the sealed secret and returns its hash; none if the joiner's signature is not valid.
    fn opened(&self, nonces: (&[u8; 32], &[u8; 32]), proof: &Proof) -> Option<[u8; 32]> {
        let said = offered(&self.team, nonces);
        let signed = proven(&said, &proof.name, &proof.keys, &proof.sealed);
        if !proof.keys.has_signed(&signed, &proof.signature) {
            return None;
        }
        let path = place(&said, &proof.keys);
        let opened = proof.sealed.open(&Place { team: self.team.id(), path: &path }, &self.keys).ok()?;
        Some(hash(&Zeroizing::new(secret(opened.expose())?)))
    }

    fn issue(
        &self,
        proof: &Proof,
        open: OpenInvite,
        now: UnixTime,
        entropy: &mut Entropy,
    ) -> Result<Certificate, ClaimsError> {
        let end = now.plus(RENEWABLE_MAX);
        let own = self.credential.as_ref().map(|credential| credential.certificate().claims().renewable_until);
        let renewable_until = own.map_or(end, |own| own.min(end));
        let claims = Claims {
            team: self.team.id(),
            name: open.name.unwrap_or_else(|| proof.name.clone()),
            role: open.role,
            keys: proof.keys,
            not_before: now,
            not_after: now.plus(LIFE_MAX).min(renewable_until),
            renewable_until,
            serial: entropy.bytes(),
        };
        Certificate::issue(claims, &self.keys)
    }
}

fn reply(certificate: Certificate) -> InviterEffect {
    InviterEffect::Reply(Message::Welcome(Box::new(Welcome { certificate })))
}
