//! A team: its key, and the credentials of its members.
//!
//! The key of the team signs the certificates of admins, and any others that its keeper wants; admins sign the
//! others. So a chain has at most two certificates. The key stays on the operator's machine, and never gets to a
//! robot. Everything is checked offline, with the credential that the client sends.

use crate::certificate::{CERTIFICATE_MAX, Certificate, RENEWAL_MAX, Renewal};
use crate::identity::{KeyId, PUBLIC_LEN, PublicKeys, SIGNATURE_LEN, SecretKeys};
use crate::name::{Name, UnixTime};
use crate::revocation::Revocations;
use crate::role::{Action, Kind, Role};
use crate::wire::{FormError, Reader, Writer};
use thiserror::Error;

/// By how much two clocks may differ, in seconds.
pub const SKEW: u64 = 300;
/// For how long a node is still trusted after its certificate has ended, by default and in seconds: 7 days.
pub const OFFLINE_GRACE: u64 = 7 * crate::certificate::DAY;
/// The most bytes of a team's form.
pub const TEAM_MAX: usize = 300;
/// The most bytes of a credential.
pub const CREDENTIAL_MAX: usize = 64 + 4 * CERTIFICATE_MAX + RENEWAL_MAX;

const TEAM: &str = "dca team 1";
const CREDENTIAL: &str = "dca credential 1";

/// The public part of a team: its name and its public keys, signed by the team itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Team {
    name: Name,
    root: PublicKeys,
    signature: [u8; SIGNATURE_LEN],
}

impl Team {
    /// Founds a team.
    pub fn found(name: Name, root: &SecretKeys) -> Self {
        let signature = root.sign(&Self::form(&name, root.public()));
        Self { name, root: *root.public(), signature }
    }

    /// Returns the name of the team.
    pub const fn name(&self) -> &Name {
        &self.name
    }

    /// Returns the public keys of the team.
    pub const fn root(&self) -> &PublicKeys {
        &self.root
    }

    /// Returns the id of the team, which is the id of its keys. The name does not identify a team.
    pub fn id(&self) -> KeyId {
        self.root.id()
    }

    fn form(name: &Name, root: &PublicKeys) -> Vec<u8> {
        let mut writer = Writer::new(TEAM);
        writer.short(name.as_str().as_bytes());
        writer.fixed(&root.to_bytes());
        writer.finish()
    }

    /// Returns the bytes of the team in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Self::form(&self.name, &self.root);
        bytes.extend_from_slice(&self.signature);
        bytes
    }

    /// Reads the bytes of a team, and checks the signature.
    ///
    /// # Errors
    /// If the bytes are not a team, or are not signed by it.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, TEAM, TEAM_MAX)?;
        let name = Name::read(&mut reader, "name")?;
        let root = PublicKeys::from_bytes(&reader.fixed::<PUBLIC_LEN>()?)?;
        let signature = reader.fixed()?;
        reader.finish()?;
        if !root.has_signed(&Self::form(&name, &root), &signature) {
            return Err(FormError::Field("signature"));
        }
        Ok(Self { name, root, signature })
    }
}

/// A certificate and, unless the team's key has signed it, the certificate of the admin who has signed it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chain {
    /// The subject's certificate.
    pub certificate: Certificate,
    /// The certificate of the admin.
    pub issuer: Option<Certificate>,
}

/// The complete proof of a member's identity: a chain, and the newest renewal with the chain of its renewer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Credential {
    /// The certificate of the subject, and the certificate of its issuer.
    pub chain: Chain,
    /// The newest renewal, and the chain of its renewer.
    pub renewal: Option<(Renewal, Chain)>,
}

/// The knowledge for checking a member.
#[derive(Clone, Copy, Debug)]
pub struct Judge<'a> {
    /// The team.
    pub team: &'a Team,
    /// The keys that the team has revoked.
    pub revoked: &'a Revocations,
    /// The present time.
    pub now: UnixTime,
    /// For how long a node is still trusted after its certificate has ended, in seconds. Users have no grace period.
    pub grace: u64,
}

/// The end of a member's trust.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// The certificate is valid until this time.
    Valid(UnixTime),
    /// The certificate has ended. The grace period for nodes that were offline ends at this time.
    Grace(UnixTime),
}

/// Why a member is not trusted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TrustError {
    /// The certificate belongs to another team.
    #[error("`{0}` belongs to another team")]
    OtherTeam(Name),
    /// The issuer of the certificate is neither the team nor one of its admins.
    #[error("the certificate of `{0}` was issued by a member that may not")]
    Issuer(Name),
    /// A signature is not valid.
    #[error("the certificate of `{0}` is not signed by its issuer")]
    Signature(Name),
    /// The keys of the member, or of the issuer, are revoked.
    #[error("the key of `{0}` is revoked")]
    Revoked(Name),
    /// The certificate is not valid yet, by this clock.
    #[error("the certificate of `{0}` is not valid yet: is a clock wrong?")]
    NotYet(Name),
    /// The certificate has ended.
    #[error("the certificate of `{0}` has ended; renew it")]
    Expired(Name),
    /// The renewal is not for this certificate, or the renewer has no right to renew it.
    #[error("the renewal of the certificate of `{0}` is not valid")]
    Renewal(Name),
    /// The role does not permit the action.
    #[error("`{name}` has the role {role}, which may not {action}")]
    Role {
        /// The member that requested the action.
        name: Name,
        /// The role.
        role: Role,
        /// The requested action.
        action: Action,
    },
}

impl Chain {
    /// Checks the identity of the owner, but not whether the certificate has ended.
    fn check(&self, judge: &Judge<'_>) -> Result<(), TrustError> {
        let claims = self.certificate.claims();
        let name = || claims.name.clone();
        if claims.team != judge.team.id() {
            return Err(TrustError::OtherTeam(name()));
        }
        if judge.revoked.has(&self.certificate.subject()) {
            return Err(TrustError::Revoked(name()));
        }
        let Some(issuer) = &self.issuer else {
            return if self.certificate.issuer() != judge.team.id() {
                Err(TrustError::Issuer(name()))
            } else if self.certificate.is_signed_by(judge.team.root()) {
                Ok(())
            } else {
                Err(TrustError::Signature(name()))
            };
        };
        let by = issuer.claims();
        let is_within = by.not_before <= claims.not_before && claims.renewable_until <= by.renewable_until;
        let may = by.role == Role::Admin && claims.role != Role::Admin && by.team == claims.team && is_within;
        if !may || issuer.issuer() != judge.team.id() || judge.now > by.renewable_until.plus(SKEW) {
            return Err(TrustError::Issuer(name()));
        }
        if judge.revoked.has(&issuer.subject()) {
            return Err(TrustError::Revoked(by.name.clone()));
        }
        if self.certificate.is_signed_by(&by.keys) && issuer.is_signed_by(judge.team.root()) {
            Ok(())
        } else {
            Err(TrustError::Signature(name()))
        }
    }

    fn write(&self, writer: &mut Writer) {
        writer.count(1 + usize::from(self.issuer.is_some()));
        for certificate in [Some(&self.certificate), self.issuer.as_ref()].into_iter().flatten() {
            writer.long(&certificate.to_bytes());
        }
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, FormError> {
        let count = reader.count(2, "chain")?;
        let mut next = || Certificate::from_bytes(reader.long(CERTIFICATE_MAX, "certificate")?);
        match count {
            1 => Ok(Self { certificate: next()?, issuer: None }),
            2 => Ok(Self { certificate: next()?, issuer: Some(next()?) }),
            _ => Err(FormError::Field("chain")),
        }
    }
}

impl Credential {
    /// Returns a credential without a renewal.
    #[must_use]
    pub const fn new(certificate: Certificate, issuer: Option<Certificate>) -> Self {
        Self { chain: Chain { certificate, issuer }, renewal: None }
    }

    /// Returns the member's certificate, unchecked.
    pub const fn certificate(&self) -> &Certificate {
        &self.chain.certificate
    }

    /// Checks that the credential is authentic, and valid now.
    ///
    /// # Errors
    /// The reason, if it is not.
    pub fn check(&self, judge: &Judge<'_>) -> Result<Standing, TrustError> {
        self.chain.check(judge)?;
        let claims = self.certificate().claims();
        let grace = if self.certificate().kind() == Kind::Node { judge.grace } else { 0 };
        let renewed = self.renewal.as_ref().map(|(renewal, renewer)| self.renewed(renewal, renewer, judge));
        let end = match renewed {
            None => claims.not_after,
            Some(Ok(end)) => end.max(claims.not_after),
            // The renewer may have been revoked since. The certificate is then valid as if it had not been renewed.
            Some(Err(_)) if judge.now <= claims.not_after.plus(SKEW).plus(grace) => claims.not_after,
            Some(Err(why)) => return Err(why),
        };
        if judge.now.plus(SKEW) < claims.not_before {
            return Err(TrustError::NotYet(claims.name.clone()));
        }
        if judge.now <= end.plus(SKEW) {
            Ok(Standing::Valid(end))
        } else if judge.now <= end.plus(SKEW).plus(grace) {
            Ok(Standing::Grace(end.plus(SKEW).plus(grace)))
        } else {
            Err(TrustError::Expired(claims.name.clone()))
        }
    }

    /// Returns the end of a renewal. A renewer's right to renew ends with its `renewable_until`, not with its
    /// certificate. So two nodes can renew each other without a third.
    fn renewed(&self, renewal: &Renewal, renewer: &Chain, judge: &Judge<'_>) -> Result<UnixTime, TrustError> {
        renewer.check(judge)?;
        let (own, by) = (self.certificate(), &renewer.certificate);
        let may = by.claims().role.may(Action::Renew) && by.subject() != own.subject();
        let in_time = renewal.not_after() <= by.claims().renewable_until;
        if may && in_time && renewal.fits(own, &by.claims().keys) {
            Ok(renewal.not_after())
        } else {
            Err(TrustError::Renewal(own.claims().name.clone()))
        }
    }

    /// Checks that the credential is authentic, valid now, and that its role has the right to an action.
    ///
    /// # Errors
    /// The reason, if one of these is not so.
    pub fn require(&self, action: Action, judge: &Judge<'_>) -> Result<Standing, TrustError> {
        let standing = self.check(judge)?;
        let claims = self.certificate().claims();
        if claims.role.may(action) {
            Ok(standing)
        } else {
            Err(TrustError::Role { name: claims.name.clone(), role: claims.role, action })
        }
    }

    /// Returns the bytes of the credential in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer::new(CREDENTIAL);
        self.chain.write(&mut writer);
        writer.u8(u8::from(self.renewal.is_some()));
        if let Some((renewal, renewer)) = &self.renewal {
            writer.long(&renewal.to_bytes());
            renewer.write(&mut writer);
        }
        writer.finish()
    }

    /// Reads the bytes of a credential. No signature is checked here.
    ///
    /// # Errors
    /// If the bytes are not a credential.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, CREDENTIAL, CREDENTIAL_MAX)?;
        let chain = Chain::read(&mut reader)?;
        let renewal = match reader.u8()? {
            0 => None,
            1 => {
                let renewal = Renewal::from_bytes(reader.long(RENEWAL_MAX, "renewal")?)?;
                Some((renewal, Chain::read(&mut reader)?))
            }
            _ => return Err(FormError::Field("renewal")),
        };
        reader.finish()?;
        Ok(Self { chain, renewal })
    }
}
