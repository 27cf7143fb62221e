//! A request that its sender has signed, from end to end: a relay can change nothing, and a repeated request has no
//! effect.
//!
//! The node that acts checks it, the cheapest checks first: its size, its team, its audience, its time, its epoch, its
//! number; then the signature, the signer and the signer's rights; its body last. The number is spent on the disk
//! before anything is done, so a request has an effect at most once, even over a restart.

mod replay;

pub use replay::{ReplayError, ReplayWrite, Replays, SIGNERS_MAX};

use crate::identity::{KeyId, SIGNATURE_LEN, SecretKeys};
use crate::name::{Name, UnixTime};
use crate::role::Action;
use crate::team::{CREDENTIAL_MAX, Credential, Judge, SKEW, TrustError};
use crate::wire::{FormError, Reader, Writer};
use thiserror::Error;

/// The most bytes of a request without its body.
pub const REQUEST_MAX: usize = 512 + CREDENTIAL_MAX;
/// The most bytes of a body: 16 MiB, as of every message.
pub const BODY_MAX: usize = 16 << 20;
/// How long a request with a waiting user may be valid, in seconds.
pub const INTERACTIVE_MAX: u64 = 60;
/// How long the request for a deployment may be valid, in seconds: 7 days, since it may travel for days. Its epoch stops older ones.
pub const DEPLOY_MAX: u64 = 7 * 24 * 3600;

/// How far the number of a request may be above the time, in seconds: a day. Numbers are the time, or one more than the last.
pub const AHEAD_MAX: u64 = crate::certificate::DAY;
const REQUEST: &str = "dca request 1";

/// The receiver of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Audience {
    /// To every node of the team.
    Team,
    /// To one node, by its key.
    Node(KeyId),
    /// To the nodes of a deployment.
    Deployment(Name),
    /// To one node, by the name in its certificate.
    Host(Name),
}

/// A requested action, its receiver, and its time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The team.
    pub team: KeyId,
    /// Its receiver.
    pub audience: Audience,
    /// The requested action.
    pub action: Action,
    /// A random number by which the request is found in logs.
    pub id: [u8; 16],
    /// The signer's number of the request: each is used once, roughly in order.
    pub sequence: u64,
    /// The epoch of the deployment; 0 where there is none.
    pub epoch: u64,
    /// When it begins to be valid.
    pub not_before: UnixTime,
    /// When it ends.
    pub not_after: UnixTime,
}

/// The node's knowledge for checking a request.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a> {
    /// Its team and its clock.
    pub judge: Judge<'a>,
    /// The node itself.
    pub node: KeyId,
    /// The name in its certificate.
    pub name: &'a Name,
    /// The deployment that the request is about, if the node takes part in it.
    pub deployment: Option<&'a Name>,
    /// The lowest epoch that is not outdated.
    pub epoch_min: u64,
}

/// A request that passed every check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// The requested action.
    pub request: Request,
    /// The sender's credential.
    pub credential: Credential,
    /// The write that has to be on the disk before anything is done.
    pub write: ReplayWrite,
}

/// Why a request was refused.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// The bytes are not a request.
    #[error("the request cannot be read: {0}")]
    Form(FormError),
    /// The body is too long.
    #[error("the body of the request is longer than {BODY_MAX} bytes")]
    BodyTooLong,
    /// It is for another team.
    #[error("the request is for another team")]
    OtherTeam,
    /// It is for another receiver.
    #[error("the request is for another host")]
    Audience,
    /// It is valid for longer than such a request may be.
    #[error("the request is valid for longer than {0} s")]
    Window(u64),
    /// It is not valid yet, by this clock.
    #[error("the request is not valid yet: is a clock wrong?")]
    NotYet,
    /// It has ended.
    #[error("the request came {0} s too late")]
    Late(u64),
    /// Its number is more than [`AHEAD_MAX`] above the time. If it were accepted, no lower number would be accepted afterwards.
    #[error("request number {0} of this signer is more than a day ahead of the clock")]
    Ahead(u64),
    /// Its epoch is outdated.
    #[error("the request has epoch {found}, but {known} is known")]
    Epoch {
        /// The epoch of the request.
        found: u64,
        /// The lowest epoch that is accepted.
        known: u64,
    },
    /// Its number was used, or is too old to know.
    #[error("{0}")]
    Replay(ReplayError),
    /// It is not signed by the named sender.
    #[error("the request is not signed by the key that it names")]
    Signature,
    /// The signer is not trusted, or may not do that.
    #[error("{0}")]
    Trust(TrustError),
    /// The body is another one than was signed.
    #[error("the body is not the one that was signed")]
    Body,
}

impl Request {
    /// Signs the request with its body, and adds the signer's credential.
    pub fn sign(&self, body: &[u8], signer: &SecretKeys, credential: &Credential) -> Vec<u8> {
        let mut bytes = self.form(&hash(body), &signer.public().id());
        bytes.extend_from_slice(&signer.sign(&bytes));
        bytes.extend(credential.to_bytes());
        bytes
    }

    /// Reads the content of a request, and the named sender. Nothing of it is checked.
    ///
    /// # Errors
    /// The bytes are not a request.
    pub fn peek(bytes: &[u8]) -> Result<(Self, Name), FormError> {
        let head = Head::read(bytes)?;
        let credential = Credential::from_bytes(head.credential)?;
        Ok((head.request, credential.certificate().claims().name.clone()))
    }

    /// Reads the claimed signer of a request, and its number. Nothing of it is checked.
    ///
    /// # Errors
    /// The bytes are not a request.
    pub fn mark(bytes: &[u8]) -> Result<(KeyId, u64), FormError> {
        let head = Head::read(bytes)?;
        Ok((head.signer, head.request.sequence))
    }

    fn form(&self, body: &[u8; 32], signer: &KeyId) -> Vec<u8> {
        let mut writer = Writer::new(REQUEST);
        writer.fixed(&self.team.0);
        match &self.audience {
            Audience::Team => writer.u8(0),
            Audience::Node(node) => {
                writer.u8(1);
                writer.fixed(&node.0);
            }
            Audience::Deployment(name) => {
                writer.u8(2);
                writer.short(name.as_str().as_bytes());
            }
            Audience::Host(name) => {
                writer.u8(3);
                writer.short(name.as_str().as_bytes());
            }
        }
        writer.u8(self.action.number());
        writer.fixed(&self.id);
        writer.u64(self.sequence);
        writer.u64(self.epoch);
        writer.u64(self.not_before.0);
        writer.u64(self.not_after.0);
        writer.fixed(body);
        writer.fixed(&signer.0);
        writer.finish()
    }

    fn check_address(&self, context: &Context<'_>) -> Result<(), Refusal> {
        if self.team != context.judge.team.id() {
            return Err(Refusal::OtherTeam);
        }
        let is_ours = match &self.audience {
            Audience::Team => true,
            Audience::Node(node) => *node == context.node,
            Audience::Deployment(name) => context.deployment == Some(name),
            Audience::Host(name) => context.name == name,
        };
        if is_ours { Ok(()) } else { Err(Refusal::Audience) }
    }

    fn check_time(&self, context: &Context<'_>) -> Result<(), Refusal> {
        let longest = if self.action == Action::Deploy { DEPLOY_MAX } else { INTERACTIVE_MAX };
        if self.not_after < self.not_before || self.not_after.since(self.not_before) > longest {
            return Err(Refusal::Window(longest));
        }
        let now = context.judge.now;
        if now.plus(SKEW) < self.not_before {
            return Err(Refusal::NotYet);
        }
        if now > self.not_after.plus(SKEW) {
            return Err(Refusal::Late(now.since(self.not_after)));
        }
        let (found, known) = (self.epoch, context.epoch_min);
        if found < known { Err(Refusal::Epoch { found, known }) } else { Ok(()) }
    }
}

fn hash(body: &[u8]) -> [u8; 32] {
    blake3::derive_key("dca request body 1", body)
}

/// A received request, with the part that can be read without any cryptography.
struct Head<'a> {
    request: Request,
    body: [u8; 32],
    signer: KeyId,
    signed: &'a [u8],
    signature: [u8; SIGNATURE_LEN],
    credential: &'a [u8],
}

impl<'a> Head<'a> {
    fn of(bytes: &'a [u8], body: &[u8]) -> Result<Self, Refusal> {
        if body.len() > BODY_MAX {
            return Err(Refusal::BodyTooLong);
        }
        Self::read(bytes).map_err(Refusal::Form)
    }

    /// Checks the signature, and that the signer has the right to ask for it.
    fn verify(&self, body: &[u8], context: &Context<'_>) -> Result<Credential, Refusal> {
        let credential = Credential::from_bytes(self.credential).map_err(Refusal::Form)?;
        let keys = credential.certificate().claims().keys;
        if keys.id() != self.signer || !keys.has_signed(self.signed, &self.signature) {
            return Err(Refusal::Signature);
        }
        credential.require(self.request.action, &context.judge).map_err(Refusal::Trust)?;
        if hash(body) != self.body {
            return Err(Refusal::Body);
        }
        Ok(credential)
    }

    fn read(bytes: &'a [u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, REQUEST, REQUEST_MAX)?;
        let team = KeyId(reader.fixed()?);
        let audience = match reader.u8()? {
            0 => Audience::Team,
            1 => Audience::Node(KeyId(reader.fixed()?)),
            2 => Audience::Deployment(Name::read(&mut reader, "audience")?),
            3 => Audience::Host(Name::read(&mut reader, "audience")?),
            _ => return Err(FormError::Field("audience")),
        };
        let action = Action::from_number(reader.u8()?)?;
        let id = reader.fixed()?;
        let (sequence, epoch) = (reader.u64()?, reader.u64()?);
        let (not_before, not_after) = (UnixTime(reader.u64()?), UnixTime(reader.u64()?));
        let (body, signer) = (reader.fixed()?, KeyId(reader.fixed()?));
        let signed = &bytes[..bytes.len() - reader.left()];
        let signature = reader.fixed()?;
        let request = Request { team, audience, action, id, sequence, epoch, not_before, not_after };
        Ok(Self { request, body, signer, signed, signature, credential: reader.rest() })
    }
}

/// Checks a request, and spends its number.
///
/// # Errors
/// It is refused, with the reason. Then nothing has changed.
pub fn check(bytes: &[u8], body: &[u8], context: &Context<'_>, replays: &mut Replays) -> Result<Accepted, Refusal> {
    let head = Head::of(bytes, body)?;
    head.request.check_address(context)?;
    head.request.check_time(context)?;
    if head.request.sequence > context.judge.now.plus(AHEAD_MAX).0 {
        return Err(Refusal::Ahead(head.request.sequence));
    }
    replays.check(&head.signer, head.request.sequence).map_err(Refusal::Replay)?;
    let credential = head.verify(body, context)?;
    let write = replays.spend(head.signer, head.request.sequence).map_err(Refusal::Replay)?;
    Ok(Accepted { request: head.request, credential, write })
}

/// Checks a request that this node has accepted before, to resume its action. Its number is spent, and it may have
/// expired: `context` has the time at which it was accepted. A sender that was revoked since is refused.
///
/// # Errors
/// As of [`check`].
pub fn check_again(bytes: &[u8], body: &[u8], context: &Context<'_>) -> Result<(Request, Credential), Refusal> {
    let head = Head::of(bytes, body)?;
    head.request.check_address(context)?;
    let credential = head.verify(body, context)?;
    Ok((head.request, credential))
}
