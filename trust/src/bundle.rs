//! The public knowledge about a team, as one text: its keys, the certificates that it has issued, and the keys that it has revoked.
//!
//! ```text
//! dca-team 2
//! team KTP…
//! certificate 4N8…
//! revoked 92A…
//! end 6TW…
//! ```
//!
//! The operator's machine stores it as a file, which is not secret. Each line is protected by its signatures, so a changed file is
//! noticed. The last line has the hash of all previous lines, so the loss of a part is noticed as well. An attacker who removes lines
//! can write a matching last line. But this does not remove anything already known, because a file is merged with the known bundle.
//! There may be several lines with revocations, if none of them contains another. Version 1 had no last line, and can still be read.

use crate::certificate::Certificate;
use crate::identity::KeyId;
use crate::name::{Name, UnixTime};
use crate::revocation::{Received, RevocationError, Revocations, RevokedSet};
use crate::role::Kind;
use crate::team::{Credential, Judge, Standing, Team, TrustError};
use crate::text::{decode, encode};
use thiserror::Error;

/// The most certificates of a bundle.
pub const CERTIFICATES_MAX: usize = 4096;
/// The most bytes of a bundle.
pub const BUNDLE_MAX: usize = 8 << 20;

const BEGIN: &str = "dca-team 2";
/// The first line of files of version 1, which have no last line.
const BEGIN_OLD: &str = "dca-team 1";
const END: &str = "end ";

/// A team, with its certificates and revocations.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bundle {
    team: Team,
    certificates: Vec<Certificate>,
    revoked: Revocations,
}

/// Why a text is not a bundle, or a certificate cannot be added to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BundleError {
    /// The text is longer than a bundle may be.
    #[error("it is longer than {BUNDLE_MAX} bytes, or has more than {CERTIFICATES_MAX} certificates")]
    TooLong,
    /// The text does not begin with the first line of a bundle.
    #[error("its first line is not `{BEGIN}`")]
    Begin,
    /// The last line is missing, or does not match the other lines.
    #[error("its last line does not fit the other lines: a part was lost or changed; export the team again")]
    Cut,
    /// A line of the text is not valid at its place.
    #[error("line {0} cannot be read, or does not belong there")]
    Line(usize),
    /// A line is not signed by the team.
    #[error("line {0} is not signed by the team")]
    Signature(usize),
}

/// A holder of a certificate in a bundle, and whether the holder is trusted.
#[derive(Debug)]
pub struct Holder<'a> {
    /// The certificate.
    pub certificate: &'a Certificate,
    /// Until when the holder is trusted, or why the holder is not trusted.
    pub standing: Result<Standing, TrustError>,
}

impl Bundle {
    /// Returns the bundle of a new team.
    #[must_use]
    pub fn new(team: Team) -> Self {
        Self { team, certificates: Vec::new(), revoked: Revocations::default() }
    }

    /// Returns the team.
    pub const fn team(&self) -> &Team {
        &self.team
    }

    /// Returns the revocations that are signed with the team's key.
    pub const fn revocations(&self) -> &Revocations {
        &self.revoked
    }

    /// Adds a certificate. It replaces an older one for the same keys.
    ///
    /// # Errors
    /// If there are too many certificates.
    pub fn add(&mut self, certificate: Certificate) -> Result<(), BundleError> {
        self.certificates.retain(|known| known.subject() != certificate.subject());
        if self.certificates.len() >= CERTIFICATES_MAX {
            return Err(BundleError::TooLong);
        }
        self.certificates.push(certificate);
        Ok(())
    }

    /// Adds revocations that are signed with the team's key. Sets by admins are not part of a bundle; nodes pass them on to each
    /// other.
    ///
    /// # Errors
    /// If the set is not signed with the team's key.
    pub fn revoke(&mut self, set: RevokedSet) -> Result<Received, RevocationError> {
        if set.is_of_the_team() { self.revoked.restore(set, &self.team) } else { Err(RevocationError::Signer) }
    }

    /// Adds the knowledge of another bundle of the team. If both bundles have a certificate for the
    /// same keys, the younger certificate is kept. If both certificates have the same age, the
    /// certificate of the other bundle is kept. No revocation is undone.
    ///
    /// # Errors
    /// If the bundle belongs to another team, or there are too many certificates.
    pub fn merge(&mut self, other: &Self) -> Result<(), BundleError> {
        if other.team != self.team {
            return Err(BundleError::Signature(2));
        }
        for certificate in &other.certificates {
            let known = self.certificates.iter().position(|known| known.subject() == certificate.subject());
            match known.and_then(|index| self.certificates.get_mut(index)) {
                Some(known) if known.claims().not_before > certificate.claims().not_before => {}
                Some(known) => *known = certificate.clone(),
                None => self.add(certificate.clone())?,
            }
        }
        for set in other.revoked.sets() {
            // The set was already checked when the other bundle was read.
            drop(self.revoke(set.clone()));
        }
        Ok(())
    }

    /// Returns all holders of a certificate, each with the result of the check at the time `now`.
    #[must_use]
    pub fn holders(&self, now: UnixTime) -> Vec<Holder<'_>> {
        let judge = Judge { team: &self.team, revoked: &self.revoked, now, grace: 0 };
        let standing = |certificate: &Certificate| self.credential(certificate).check(&judge);
        self.certificates.iter().map(|certificate| Holder { certificate, standing: standing(certificate) }).collect()
    }

    /// Returns the certificates with this name.
    pub fn named<'a>(&'a self, name: &'a Name) -> impl Iterator<Item = &'a Certificate> {
        self.certificates.iter().filter(move |certificate| certificate.claims().name == *name)
    }

    /// Returns whether the team has revoked a key.
    pub fn has_revoked(&self, key: &KeyId) -> bool {
        self.revoked.has(key)
    }

    /// Returns whether the team has a node that is not revoked.
    pub fn has_nodes(&self) -> bool {
        let is_node = |known: &Certificate| known.kind() == Kind::Node && !self.has_revoked(&known.subject());
        self.certificates.iter().any(is_node)
    }

    /// Returns the credential of the holder of a key; none if the key has no certificate.
    #[must_use]
    pub fn credential_of(&self, key: &KeyId) -> Option<Credential> {
        self.certificates.iter().find(|known| known.subject() == *key).map(|known| self.credential(known))
    }

    /// Returns a credential: a certificate, with the certificate of the admin who issued it.
    fn credential(&self, certificate: &Certificate) -> Credential {
        let by = certificate.issuer();
        let issuer = self.certificates.iter().find(|known| known.subject() == by && by != self.team.id());
        Credential::new(certificate.clone(), issuer.cloned())
    }

    /// Returns the bundle as text.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!("{BEGIN}\nteam {}\n", encode(&self.team.to_bytes()));
        for certificate in &self.certificates {
            text += &format!("certificate {}\n", encode(&certificate.to_bytes()));
        }
        for set in self.revoked.sets() {
            text += &format!("revoked {}\n", encode(&set.to_bytes()));
        }
        let end = encode(blake3::hash(text.as_bytes()).as_bytes());
        text + &format!("{END}{end}\n")
    }

    /// Reads a text, and checks the signatures of its lines. Expired certificates are accepted.
    ///
    /// # Errors
    /// If the text is not a bundle. No part of it is used then.
    pub fn from_text(text: &str) -> Result<Self, BundleError> {
        if text.len() > BUNDLE_MAX {
            return Err(BundleError::TooLong);
        }
        let lines = match text.lines().next() {
            Some(BEGIN) => whole(text)?,
            Some(BEGIN_OLD) => text.lines().collect(),
            _ => return Err(BundleError::Begin),
        };
        let mut lines = lines.into_iter().enumerate().map(|(index, line)| (index + 1, line)).skip(1);
        let (number, line) = lines.next().unwrap_or((2, ""));
        let team = field(number, line, "team ")?;
        let mut bundle = Self::new(Team::from_bytes(&team).map_err(|_no_team| BundleError::Line(2))?);
        for (number, line) in lines {
            if line.starts_with("revoked ") {
                bundle.take_revoked(number, line)?;
                continue;
            }
            if !bundle.revoked.sets().is_empty() {
                return Err(BundleError::Line(number));
            }
            let certificate = Certificate::from_bytes(&field(number, line, "certificate ")?);
            let certificate = certificate.map_err(|_no_certificate| BundleError::Line(number))?;
            let is_new = bundle.certificates.iter().all(|known| known.subject() != certificate.subject());
            if !is_new || bundle.certificates.len() >= CERTIFICATES_MAX {
                return Err(BundleError::Line(number));
            }
            if !bundle.is_true(&certificate) {
                return Err(BundleError::Signature(number));
            }
            bundle.certificates.push(certificate);
        }
        Ok(bundle)
    }

    fn take_revoked(&mut self, number: usize, line: &str) -> Result<(), BundleError> {
        let set = RevokedSet::from_bytes(&field(number, line, "revoked ")?);
        let set = set.map_err(|_no_set| BundleError::Line(number))?;
        match self.revoke(set) {
            Ok(Received::New(_)) => Ok(()),
            Ok(Received::Known) => Err(BundleError::Line(number)),
            Err(_) => Err(BundleError::Signature(number)),
        }
    }

    /// Returns whether a certificate was valid when it began. The line of its issuer has to come first.
    fn is_true(&self, certificate: &Certificate) -> bool {
        let now = certificate.claims().not_before;
        let nobody = Revocations::default();
        let judge = Judge { team: &self.team, revoked: &nobody, now, grace: 0 };
        self.credential(certificate).check(&judge).is_ok()
    }
}

/// Returns the lines before the last one, whose hash is in the last line.
fn whole(text: &str) -> Result<Vec<&str>, BundleError> {
    let mut lines: Vec<&str> = text.lines().collect();
    let end = lines.pop().and_then(|line| line.strip_prefix(END)).ok_or(BundleError::Cut)?;
    let mut hasher = blake3::Hasher::new();
    for line in &lines {
        hasher.update(line.as_bytes()).update(b"\n");
    }
    if encode(hasher.finalize().as_bytes()) == end { Ok(lines) } else { Err(BundleError::Cut) }
}

fn field(number: usize, line: &str, name: &str) -> Result<Vec<u8>, BundleError> {
    let text = line.strip_prefix(name).ok_or(BundleError::Line(number))?;
    let bytes = decode(text).map_err(|_no_text| BundleError::Line(number))?;
    // Capitals and look-alike letters are accepted only in lines that people type.
    if encode(&bytes) == text { Ok(bytes) } else { Err(BundleError::Line(number)) }
}
