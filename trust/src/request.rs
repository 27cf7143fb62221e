//! A request that its sender has signed end to end: a relay cannot change it, and repeating it has no effect.
//!
//! The node that executes the request checks it, the cheapest checks first: size, team, audience, time, epoch and number; then the
//! signature, the signer and the signer's rights; the body last. The node writes the number to the disk before it does anything. So
//! a request has an effect at most once, even over a restart.

mod replay;

pub use replay::{ReplayError, ReplayWrite, Replays, SIGNERS_MAX};

use crate::identity::{KeyId, SIGNATURE_LEN, SecretKeys};
use crate::name::{Name, UnixTime};
use crate::role::Action;
use crate::team::{CREDENTIAL_MAX, Credential, Judge, SKEW, TrustError};
use crate::wire::{FormError, Reader, Writer};
use thiserror::Error;

/// The longest request without its body, in bytes.
pub const REQUEST_MAX: usize = 512 + CREDENTIAL_MAX;
/// The longest body, in bytes: 16 MiB, as for every message.
pub const BODY_MAX: usize = 16 << 20;
/// How long a request may be valid while its user waits, in seconds.
pub const INTERACTIVE_MAX: u64 = 60;
/// How long the request for a deployment may be valid, in seconds: 7 days, since it may be in transit for days. Its epoch stops
/// older requests.
pub const DEPLOY_MAX: u64 = 7 * 24 * 3600;

/// How far the number of a request may be above the time, in seconds: a day. A number is the time, or one more than the previous
/// number.
pub const AHEAD_MAX: u64 = crate::certificate::DAY;
const REQUEST: &str = "dca request 1";

/// The receiver of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Audience {
    /// To every node of the team.
    Team,
    /// One node, by the id of its keys.
    Node(KeyId),
    /// To the nodes of a deployment.
    Deployment(Name),
    /// One node, by the name in its certificate.
    Host(Name),
}

/// A requested action, its receiver, and its time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// The team.
    pub team: KeyId,
    /// The receiver of the request.
    pub audience: Audience,
    /// The requested action.
    pub action: Action,
    /// A random number by which the request can be found in logs.
    pub id: [u8; 16],
    /// The signer's number of the request. Each number is used once, and numbers grow roughly.
    pub sequence: u64,
    /// The epoch of the deployment; 0 if the request has none.
    pub epoch: u64,
    /// The time from which the request is valid.
    pub not_before: UnixTime,
    /// The time at which the request ends.
    pub not_after: UnixTime,
}

/// The facts with which a node checks a request.
#[derive(Clone, Copy, Debug)]
pub struct Context<'a> {
    /// The team and the clock of the node.
    pub judge: Judge<'a>,
    /// The node itself.
    pub node: KeyId,
    /// The name in the node's certificate.
    pub name: &'a Name,
    /// The deployment of the request, if the node takes part in it.
    pub deployment: Option<&'a Name>,
    /// The lowest epoch that is still accepted.
    pub epoch_min: u64,
}

/// A request that has passed every check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// The requested action.
    pub request: Request,
    /// The sender's credential.
    pub credential: Credential,
    /// The write that has to be on the disk before the request is executed.
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
    /// The request is for another team.
    #[error("the request is for another team")]
    OtherTeam,
    /// The request is for another receiver.
    #[error("the request is for another host")]
    Audience,
    /// The request is valid for longer than such a request may be.
    #[error("the request is valid for longer than {0} s")]
    Window(u64),
    /// The request is not valid yet, by this clock.
    #[error("the request is not valid yet: is a clock wrong?")]
    NotYet,
    /// The request has ended.
    #[error("the request came {0} s too late")]
    Late(u64),
    /// The number of the request is more than [`AHEAD_MAX`] above the time. If it were accepted, no lower number would be accepted
    /// afterwards.
    #[error("request number {0} of this signer is more than a day ahead of the clock")]
    Ahead(u64),
    /// The epoch of the request is outdated.
    #[error("the request has epoch {found}, but {known} is known")]
    Epoch {
        /// The epoch of the request.
        found: u64,
        /// The lowest accepted epoch.
        known: u64,
    },
    /// The number of the request was used, or is too old to know.
    #[error("{0}")]
    Replay(ReplayError),
    /// The request is not signed by the named sender.
    #[error("the request is not signed by the key that it names")]
    Signature,
    /// The signer is not trusted, or has no right to this action.
    #[error("{0}")]
    Trust(TrustError),
    /// The body differs from the signed one.
    #[error("the body differs from the signed body")]
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

    /// Reads the content of a request, and the name of the sender, without any check.
    ///
    /// # Errors
    /// If the bytes are not a request.
    pub fn peek(bytes: &[u8]) -> Result<(Self, Name), FormError> {
        let head = Head::read(bytes)?;
        let credential = Credential::from_bytes(head.credential)?;
        Ok((head.request, credential.certificate().claims().name.clone()))
    }

    /// Reads the claimed signer of a request, and its number, without any check.
    ///
    /// # Errors
    /// If the bytes are not a request.
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

/// A received request. This part of it can be read without any cryptography.
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

    /// Checks the signature, and that the signer has the right to the action.
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

/// Checks a request, and marks its number as used.
///
/// # Errors
/// The reason, if the request is refused. Nothing has changed then.
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

/// Checks a request again that this node has accepted before, to resume its action. Its number is already used, and it may have
/// expired: `context` has the time at which it was accepted. The request is refused if its sender was revoked since.
///
/// # Errors
/// The errors of [`check`].
pub fn check_again(bytes: &[u8], body: &[u8], context: &Context<'_>) -> Result<(Request, Credential), Refusal> {
    let head = Head::of(bytes, body)?;
    head.request.check_address(context)?;
    let credential = head.verify(body, context)?;
    Ok((head.request, credential))
}
