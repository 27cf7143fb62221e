//! The four messages of joining.

use super::INVITE_SECRET;
use crate::certificate::{CERTIFICATE_MAX, Certificate};
use crate::identity::{PUBLIC_LEN, PublicKeys, SIGNATURE_LEN};
use crate::name::Name;
use crate::seal::Sealed;
use crate::team::{CREDENTIAL_MAX, Credential, TEAM_MAX, Team};
use crate::wire::{FormError, Reader, Writer};

/// The most bytes of a message.
pub const MESSAGE_MAX: usize = 4096;

const FORM: &str = "dca join 1";
const SEALED_MAX: usize = 512;

/// Joiner to inviter: a robot asks to join.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hello {
    /// A random number.
    pub nonce: [u8; 32],
}

/// Inviter to joiner: the team, and the proof of the inviter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// The team.
    pub team: Team,
    /// The credential of the inviter; none if it has the team's own key.
    pub inviter: Option<Credential>,
    /// A random number.
    pub nonce: [u8; 32],
    /// The signature of the inviter over both numbers and the team.
    pub signature: [u8; SIGNATURE_LEN],
}

/// Joiner to inviter: the keys of the joiner, and the secret of the invitation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proof {
    /// The name that the robot prefers.
    pub name: Name,
    /// The public keys of the robot.
    pub keys: PublicKeys,
    /// The secret, sealed for the inviter, and valid only for this conversation.
    pub sealed: Sealed,
    /// The signature of the joiner over all earlier messages. It proves that the joiner has the secret keys.
    pub signature: [u8; SIGNATURE_LEN],
}

/// Inviter to joiner: welcome.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Welcome {
    /// The joiner's certificate.
    pub certificate: Certificate,
}

/// A message of joining.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// A robot wants to join.
    Hello(Hello),
    /// The team, and the proof of the inviter.
    Offer(Box<Offer>),
    /// The keys of the joiner, and the secret.
    Proof(Box<Proof>),
    /// Welcome.
    Welcome(Box<Welcome>),
    /// The robot is refused. Only the inviter's log has the reason.
    Refused,
}

impl Message {
    /// Returns the bytes of the message in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer::new(FORM);
        match self {
            Self::Hello(hello) => {
                writer.u8(1);
                writer.fixed(&hello.nonce);
            }
            Self::Offer(offer) => {
                writer.u8(2);
                writer.long(&offer.team.to_bytes());
                writer.long(&offer.inviter.as_ref().map(Credential::to_bytes).unwrap_or_default());
                writer.fixed(&offer.nonce);
                writer.fixed(&offer.signature);
            }
            Self::Proof(proof) => {
                writer.u8(3);
                writer.short(proof.name.as_str().as_bytes());
                writer.fixed(&proof.keys.to_bytes());
                writer.long(&proof.sealed.to_bytes());
                writer.fixed(&proof.signature);
            }
            Self::Welcome(welcome) => {
                writer.u8(4);
                writer.long(&welcome.certificate.to_bytes());
            }
            Self::Refused => writer.u8(5),
        }
        writer.finish()
    }

    /// Reads the bytes of a message.
    ///
    /// # Errors
    /// If the bytes are not such a message.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, FORM, MESSAGE_MAX)?;
        let message = match reader.u8()? {
            1 => Self::Hello(Hello { nonce: reader.fixed()? }),
            2 => {
                let team = Team::from_bytes(reader.long(TEAM_MAX, "team")?)?;
                let inviter = reader.long(CREDENTIAL_MAX, "inviter")?;
                let inviter = if inviter.is_empty() { None } else { Some(Credential::from_bytes(inviter)?) };
                Self::Offer(Box::new(Offer { team, inviter, nonce: reader.fixed()?, signature: reader.fixed()? }))
            }
            3 => {
                let name = Name::read(&mut reader, "name")?;
                let keys = PublicKeys::from_bytes(&reader.fixed::<PUBLIC_LEN>()?)?;
                let sealed = Sealed::from_bytes(reader.long(SEALED_MAX, "sealed")?)?;
                Self::Proof(Box::new(Proof { name, keys, sealed, signature: reader.fixed()? }))
            }
            4 => {
                let certificate = Certificate::from_bytes(reader.long(CERTIFICATE_MAX, "certificate")?)?;
                Self::Welcome(Box::new(Welcome { certificate }))
            }
            5 => Self::Refused,
            _ => return Err(FormError::Field("message")),
        };
        reader.finish()?;
        Ok(message)
    }
}

/// Returns the bytes that the inviter signs.
pub(super) fn offered(team: &Team, nonces: (&[u8; 32], &[u8; 32])) -> Vec<u8> {
    let mut writer = Writer::new("dca join offer 1");
    writer.fixed(&team.id().0);
    writer.fixed(nonces.0);
    writer.fixed(nonces.1);
    writer.finish()
}

/// Returns the bytes that the joiner signs.
pub(super) fn proven(offered: &[u8], name: &Name, keys: &PublicKeys, sealed: &Sealed) -> Vec<u8> {
    let mut writer = Writer::new("dca join proof 1");
    writer.long(offered);
    writer.short(name.as_str().as_bytes());
    writer.fixed(&keys.to_bytes());
    writer.long(&sealed.to_bytes());
    writer.finish()
}

/// Returns the place for which the secret is sealed: this conversation and these keys.
pub(super) fn place(offered: &[u8], keys: &PublicKeys) -> String {
    let mut hasher = blake3::Hasher::new_derive_key("dca join place 1");
    hasher.update(offered);
    hasher.update(&keys.to_bytes());
    format!("join/{}", crate::text::encode(hasher.finalize().as_bytes()))
}

/// Returns the secret of an invitation from the opened seal.
pub(super) fn secret(opened: &[u8]) -> Option<[u8; INVITE_SECRET]> {
    opened.try_into().ok()
}
