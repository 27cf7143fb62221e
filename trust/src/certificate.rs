//! Certificates and their renewals: small forms, each with one signature.
//!
//! A certificate names the owner of keys, for a short time. A member with the right to renew may extend it, again and
//! again, but never beyond a time that its issuer has set (`renewable_until`). So a robot that never meets the team's
//! key stays in the team. A stolen renewer can extend existing certificates, until that time or until it is revoked,
//! but it cannot admit new members.

use crate::identity::{KeyId, PUBLIC_LEN, PublicKeys, SIGNATURE_LEN, SecretKeys};
use crate::name::{Name, UnixTime};
use crate::role::{Kind, Role};
use crate::wire::{FormError, Reader, Writer};
use thiserror::Error;

/// The most bytes of a certificate.
pub const CERTIFICATE_MAX: usize = 400;
/// The most bytes of a renewal.
pub const RENEWAL_MAX: usize = 200;
/// The longest time for which a certificate or a renewal is valid, in seconds: 31 days.
pub const LIFE_MAX: u64 = 31 * DAY;
/// The longest time for which a certificate can be renewed, in seconds: 3 years of 366 days.
pub const RENEWABLE_MAX: u64 = 3 * 366 * DAY;
/// A day, in seconds.
pub const DAY: u64 = 24 * 3600;

const CERTIFICATE: &str = "dca certificate 1";
const RENEWAL: &str = "dca renewal 1";

/// The content of a certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claims {
    /// The id of the team's key.
    pub team: KeyId,
    /// The subject's name.
    pub name: Name,
    /// The rights of the subject; its kind follows from them.
    pub role: Role,
    /// The subject's keys.
    pub keys: PublicKeys,
    /// When it begins to be valid.
    pub not_before: UnixTime,
    /// When it ends, unless it is renewed.
    pub not_after: UnixTime,
    /// The end beyond which no member can renew it.
    pub renewable_until: UnixTime,
    /// A random number, so that two certificates of one subject differ.
    pub serial: [u8; 16],
}

/// Claims with the signature of their issuer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certificate {
    claims: Claims,
    issuer: KeyId,
    signature: [u8; SIGNATURE_LEN],
}

/// A certificate would break a rule that holds for every one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ClaimsError {
    /// The times are not in order.
    #[error("the times of a certificate have to be in order: it begins, ends, and can be renewed until then or later")]
    Order,
    /// It is valid for too long.
    #[error("a certificate is valid for at most {} days; for a longer time, renew it", LIFE_MAX / DAY)]
    Life,
    /// It can be renewed for too long.
    #[error("a certificate can be renewed for {} days at most", RENEWABLE_MAX / DAY)]
    Renewable,
}

impl Claims {
    fn check(&self) -> Result<(), ClaimsError> {
        if self.not_before >= self.not_after || self.not_after > self.renewable_until {
            return Err(ClaimsError::Order);
        }
        if self.not_after.since(self.not_before) > LIFE_MAX {
            return Err(ClaimsError::Life);
        }
        if self.renewable_until.since(self.not_before) > RENEWABLE_MAX {
            return Err(ClaimsError::Renewable);
        }
        Ok(())
    }

    fn form(&self, issuer: &KeyId) -> Vec<u8> {
        let mut writer = Writer::new(CERTIFICATE);
        writer.fixed(&self.team.0);
        writer.short(self.name.as_str().as_bytes());
        writer.u8(self.role.kind().number());
        writer.u8(self.role.number());
        writer.fixed(&self.keys.to_bytes());
        writer.u64(self.not_before.0);
        writer.u64(self.not_after.0);
        writer.u64(self.renewable_until.0);
        writer.fixed(&self.serial);
        writer.fixed(&issuer.0);
        writer.finish()
    }
}

impl Certificate {
    /// Signs claims.
    ///
    /// # Errors
    /// They are valid for too long, or their times are not in order.
    pub fn issue(claims: Claims, issuer: &SecretKeys) -> Result<Self, ClaimsError> {
        claims.check()?;
        let id = issuer.public().id();
        let signature = issuer.sign(&claims.form(&id));
        Ok(Self { claims, issuer: id, signature })
    }

    /// Returns its content. The content is not proven to be true: see [`crate::team::Credential::check`].
    pub const fn claims(&self) -> &Claims {
        &self.claims
    }

    /// Returns the kind of its subject.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.claims.role.kind()
    }

    /// Returns the id of its subject's keys.
    pub fn subject(&self) -> KeyId {
        self.claims.keys.id()
    }

    /// Returns the id of the keys that it claims to be signed with.
    pub const fn issuer(&self) -> KeyId {
        self.issuer
    }

    /// Returns the hash that a renewal names it by.
    pub fn hash(&self) -> [u8; 32] {
        blake3::derive_key("dca certificate hash 1", &self.to_bytes())
    }

    pub(crate) fn is_signed_by(&self, keys: &PublicKeys) -> bool {
        keys.id() == self.issuer && keys.has_signed(&self.claims.form(&self.issuer), &self.signature)
    }

    /// Returns its form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.claims.form(&self.issuer);
        bytes.extend_from_slice(&self.signature);
        bytes
    }

    /// Reads its form. The signature is not checked here.
    ///
    /// # Errors
    /// The bytes are not a certificate.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, CERTIFICATE, CERTIFICATE_MAX)?;
        let team = KeyId(reader.fixed()?);
        let name = Name::read(&mut reader, "name")?;
        let kind = Kind::from_number(reader.u8()?)?;
        let role = Role::from_number(reader.u8()?)?;
        if role.kind() != kind {
            return Err(FormError::Field("role"));
        }
        let keys = PublicKeys::from_bytes(&reader.fixed::<PUBLIC_LEN>()?)?;
        let mut time = || reader.u64().map(UnixTime);
        let (not_before, not_after, renewable_until) = (time()?, time()?, time()?);
        let serial = reader.fixed()?;
        let issuer = KeyId(reader.fixed()?);
        let signature = reader.fixed()?;
        reader.finish()?;
        let claims = Claims { team, name, role, keys, not_before, not_after, renewable_until, serial };
        claims.check().map_err(|_broken| FormError::Field("times"))?;
        Ok(Self { claims, issuer, signature })
    }
}

/// The extension of a certificate's validity, by a member that may renew.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Renewal {
    certificate: [u8; 32],
    not_before: UnixTime,
    not_after: UnixTime,
    renewer: KeyId,
    signature: [u8; SIGNATURE_LEN],
}

impl Renewal {
    /// Renews a certificate for so many seconds, at most [`LIFE_MAX`] and no longer than it can be renewed. Whether the renewer
    /// may do that is for others to check.
    pub fn issue(certificate: &Certificate, now: UnixTime, seconds: u64, renewer: &SecretKeys) -> Self {
        let end = certificate.claims.renewable_until;
        let mut renewal = Self {
            certificate: certificate.hash(),
            not_before: now.min(end),
            not_after: now.plus(seconds.min(LIFE_MAX)).min(end),
            renewer: renewer.public().id(),
            signature: [0; SIGNATURE_LEN],
        };
        renewal.signature = renewer.sign(&renewal.form());
        renewal
    }

    /// Returns when it ends.
    #[must_use]
    pub const fn not_after(&self) -> UnixTime {
        self.not_after
    }

    /// Returns the id of the keys that it claims to be signed with.
    pub const fn renewer(&self) -> KeyId {
        self.renewer
    }

    /// Returns whether it renews this certificate, for no longer than is allowed, and is signed by these keys.
    pub(crate) fn fits(&self, certificate: &Certificate, renewer: &PublicKeys) -> bool {
        self.certificate == certificate.hash()
            && self.not_after <= certificate.claims.renewable_until
            && renewer.id() == self.renewer
            && renewer.has_signed(&self.form(), &self.signature)
    }

    fn form(&self) -> Vec<u8> {
        let mut writer = Writer::new(RENEWAL);
        writer.fixed(&self.certificate);
        writer.u64(self.not_before.0);
        writer.u64(self.not_after.0);
        writer.fixed(&self.renewer.0);
        writer.finish()
    }

    /// Returns its form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.form();
        bytes.extend_from_slice(&self.signature);
        bytes
    }

    /// Reads its form. The signature is not checked here.
    ///
    /// # Errors
    /// The bytes are not a renewal.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, RENEWAL, RENEWAL_MAX)?;
        let certificate = reader.fixed()?;
        let (not_before, not_after) = (UnixTime(reader.u64()?), UnixTime(reader.u64()?));
        let renewer = KeyId(reader.fixed()?);
        let signature = reader.fixed()?;
        reader.finish()?;
        if not_before > not_after || not_after.since(not_before) > LIFE_MAX {
            return Err(FormError::Field("times"));
        }
        Ok(Self { certificate, not_before, not_after, renewer, signature })
    }
}
