//! Certificates and their renewals: short signed statements with one signature each.
//!
//! A certificate names the owner of keys, for a short time. A member with the right to renew may extend it repeatedly, but
//! never beyond a time that its issuer has set (`renewable_until`). So a robot that never meets the team's key stays in the
//! team. An attacker with the keys of a renewer can extend existing certificates, until that time or until the renewer is
//! revoked. But the attacker cannot admit new members.

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
    /// The rights of the subject. The role also determines its kind.
    pub role: Role,
    /// The subject's keys.
    pub keys: PublicKeys,
    /// The time from which the certificate is valid.
    pub not_before: UnixTime,
    /// The time at which the certificate ends, unless it is renewed.
    pub not_after: UnixTime,
    /// The time beyond which no member can renew the certificate.
    pub renewable_until: UnixTime,
    /// A random number, so that two certificates of the same subject differ.
    pub serial: [u8; 16],
}

/// Claims with the signature of their issuer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Certificate {
    claims: Claims,
    issuer: KeyId,
    signature: [u8; SIGNATURE_LEN],
}

/// Why a certificate would break a rule for all certificates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ClaimsError {
    /// The times are not in order.
    #[error("the times of a certificate have to be in order: it begins, ends, and can be renewed until then or later")]
    Order,
    /// The certificate is valid for too long.
    #[error("a certificate is valid for at most {} days; for a longer time, renew it", LIFE_MAX / DAY)]
    Life,
    /// The certificate can be renewed for too long.
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
    /// If the claims are valid for too long, or their times are not in order.
    pub fn issue(claims: Claims, issuer: &SecretKeys) -> Result<Self, ClaimsError> {
        claims.check()?;
        let id = issuer.public().id();
        let signature = issuer.sign(&claims.form(&id));
        Ok(Self { claims, issuer: id, signature })
    }

    /// Returns the claims. They are not proven: see [`crate::team::Credential::check`].
    pub const fn claims(&self) -> &Claims {
        &self.claims
    }

    /// Returns the kind of the subject.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.claims.role.kind()
    }

    /// Returns the id of the subject's keys.
    pub fn subject(&self) -> KeyId {
        self.claims.keys.id()
    }

    /// Returns the id of the keys that the certificate claims to be signed with.
    pub const fn issuer(&self) -> KeyId {
        self.issuer
    }

    /// Returns the hash of the certificate, which a renewal names.
    pub fn hash(&self) -> [u8; 32] {
        blake3::derive_key("dca certificate hash 1", &self.to_bytes())
    }

    pub(crate) fn is_signed_by(&self, keys: &PublicKeys) -> bool {
        keys.id() == self.issuer && keys.has_signed(&self.claims.form(&self.issuer), &self.signature)
    }

    /// Returns the bytes of the certificate in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.claims.form(&self.issuer);
        bytes.extend_from_slice(&self.signature);
        bytes
    }

    /// Reads the bytes of a certificate. The signature is not checked here.
    ///
    /// # Errors
    /// If the bytes are not a certificate.
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
    /// Renews a certificate for `seconds`, but at most [`LIFE_MAX`], and not beyond its `renewable_until`. Whether the renewer
    /// has the right to do so is not checked here.
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

    /// Returns the time at which the renewal ends.
    #[must_use]
    pub const fn not_after(&self) -> UnixTime {
        self.not_after
    }

    /// Returns the id of the keys that the renewal claims to be signed with.
    pub const fn renewer(&self) -> KeyId {
        self.renewer
    }

    /// Returns whether this renews the certificate, for no longer than permitted, and is signed by these keys.
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

    /// Returns the bytes of the renewal in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.form();
        bytes.extend_from_slice(&self.signature);
        bytes
    }

    /// Reads the bytes of a renewal. The signature is not checked here.
    ///
    /// # Errors
    /// If the bytes are not a renewal.
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
