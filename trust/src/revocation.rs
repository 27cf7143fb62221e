//! Whose keys are not trusted any more.
//!
//! The team's key, and each admin, signs a set of their own with a number that only grows. Members pass the newest set of each
//! signer on with every contact. What a member has once heard of as revoked stays so: a key is never taken back, its
//! owner gets another.

use crate::identity::{KeyId, SIGNATURE_LEN, SecretKeys};
use crate::name::UnixTime;
use crate::role::Action;
use crate::team::{CREDENTIAL_MAX, Credential, Judge, Team, TrustError};
use crate::wire::{FormError, Reader, Writer};
use std::collections::{BTreeMap, BTreeSet};
use thiserror::Error;

/// The most keys of a set.
pub const REVOKED_MAX: usize = 4096;
/// The most signers of whom a member keeps a set.
pub const SIGNERS_MAX: usize = 64;
/// The most bytes of a set.
pub const SET_MAX: usize = 256 + CREDENTIAL_MAX + 40 * REVOKED_MAX;

const SET: &str = "dca revoked 1";

/// What one signer has revoked, in one number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RevokedSet {
    team: KeyId,
    signer: KeyId,
    number: u64,
    keys: BTreeMap<KeyId, UnixTime>,
    signature: [u8; SIGNATURE_LEN],
    /// Who the signer is; none for the team's key. It is outside of the signature, for it may be renewed.
    credential: Option<Credential>,
}

/// Why a set was refused, or cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RevocationError {
    /// A newer set of the same signer is known.
    #[error("the revocations with number {found} are older than those that are known, {known}")]
    Old {
        /// The number of the one that was refused.
        found: u64,
        /// The number of the one that is known.
        known: u64,
    },
    /// The signer is not the team's key or an admin of it, or has not signed it.
    #[error("the revocations are not signed by the team or one of its admins")]
    Signer,
    /// The signer is not trusted.
    #[error("who signed the revocations is not trusted: {0}")]
    Trust(TrustError),
    /// There are too many keys or signers.
    #[error("no more than {REVOKED_MAX} keys by each of {SIGNERS_MAX} signers can be revoked")]
    Full,
}

/// What receiving a set has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// It is known already.
    Known,
    /// It is new; keep it, pass it on, and cut the links to these many keys that were trusted until now.
    New(usize),
}

impl RevokedSet {
    /// Signs a set. `credential` is the signer's; none for the team's key.
    ///
    /// # Errors
    /// There are too many keys.
    pub fn sign(
        team: &Team,
        number: u64,
        keys: BTreeMap<KeyId, UnixTime>,
        signer: &SecretKeys,
        credential: Option<Credential>,
    ) -> Result<Self, RevocationError> {
        if keys.len() > REVOKED_MAX {
            return Err(RevocationError::Full);
        }
        let signature = [0; SIGNATURE_LEN];
        let mut set = Self { team: team.id(), signer: signer.public().id(), number, keys, signature, credential };
        set.signature = signer.sign(&set.form());
        Ok(set)
    }

    /// Returns its number.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Returns the keys, and since when each is revoked.
    pub const fn keys(&self) -> &BTreeMap<KeyId, UnixTime> {
        &self.keys
    }

    /// Returns whether it says that the team's key has signed it, not an admin.
    #[must_use]
    pub const fn is_of_the_team(&self) -> bool {
        self.credential.is_none()
    }

    /// Checks who has signed it, and that the signer may.
    pub(crate) fn check(&self, judge: &Judge<'_>) -> Result<(), RevocationError> {
        let keys = match &self.credential {
            None => *judge.team.root(),
            Some(credential) => {
                // What an admin revoked stays revoked after the admin's certificate has ended: that is no reason to trust anybody.
                let judge = Judge { now: judge.now.min(credential.certificate().claims().not_after), ..*judge };
                credential.require(Action::Revoke, &judge).map_err(RevocationError::Trust)?;
                credential.certificate().claims().keys
            }
        };
        let is_signed = keys.id() == self.signer && keys.has_signed(&self.form(), &self.signature);
        if self.team == judge.team.id() && is_signed { Ok(()) } else { Err(RevocationError::Signer) }
    }

    fn form(&self) -> Vec<u8> {
        let mut writer = Writer::new(SET);
        writer.fixed(&self.team.0);
        writer.fixed(&self.signer.0);
        writer.u64(self.number);
        writer.count(self.keys.len());
        for (key, since) in &self.keys {
            writer.fixed(&key.0);
            writer.u64(since.0);
        }
        writer.finish()
    }

    /// Returns its form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.form();
        bytes.extend_from_slice(&self.signature);
        bytes.extend(self.credential.iter().flat_map(Credential::to_bytes));
        bytes
    }

    /// Reads its form. The signature is not checked here.
    ///
    /// # Errors
    /// The bytes are no set.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, SET, SET_MAX)?;
        let (team, signer) = (KeyId(reader.fixed()?), KeyId(reader.fixed()?));
        let number = reader.u64()?;
        let mut keys = BTreeMap::new();
        for _ in 0..reader.count(REVOKED_MAX, "keys")? {
            let key = KeyId(reader.fixed()?);
            if keys.last_key_value().is_some_and(|(last, _)| *last >= key) {
                return Err(FormError::Field("keys"));
            }
            keys.insert(key, UnixTime(reader.u64()?));
        }
        let signature = reader.fixed()?;
        let rest = reader.rest();
        let credential = if rest.is_empty() { None } else { Some(Credential::from_bytes(rest)?) };
        Ok(Self { team, signer, number, keys, signature, credential })
    }
}

/// Everything that a member knows of as revoked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Revocations {
    /// The newest set of each signer: what is passed on.
    newest: BTreeMap<KeyId, RevokedSet>,
    /// All keys that any accepted set has ever named.
    keys: BTreeSet<KeyId>,
}

impl Revocations {
    /// Returns those of one set that was checked before.
    pub(crate) fn of_checked(set: RevokedSet) -> Self {
        let keys = set.keys.keys().copied().collect();
        Self { newest: [(set.signer, set)].into(), keys }
    }

    /// Returns whether a key is revoked.
    #[must_use]
    pub fn has(&self, key: &KeyId) -> bool {
        self.keys.contains(key)
    }

    /// Returns the number of the newest set of each signer: what two members tell each other first.
    pub fn numbers(&self) -> impl Iterator<Item = (KeyId, u64)> {
        self.newest.iter().map(|(signer, set)| (*signer, set.number))
    }

    /// Returns the newest set of a signer.
    pub fn of(&self, signer: &KeyId) -> Option<&RevokedSet> {
        self.newest.get(signer)
    }

    /// Returns the sets that somebody with these numbers lacks.
    pub fn newer_than(&self, numbers: &BTreeMap<KeyId, u64>) -> Vec<&RevokedSet> {
        self.newest.values().filter(|set| numbers.get(&set.signer).is_none_or(|known| *known < set.number)).collect()
    }

    /// Takes a set in. It is checked against what was revoked before: who is revoked revokes nobody any more.
    ///
    /// A signer whose machine was set back may sign two sets with one number. The keys of both stay revoked.
    ///
    /// # Errors
    /// The set is older than a known one, or not signed by somebody who may.
    pub fn receive(&mut self, set: RevokedSet, judge: &Judge<'_>) -> Result<Received, RevocationError> {
        let known = self.newest.get(&set.signer);
        if known == Some(&set) {
            return Ok(Received::Known);
        }
        if let Some(known) = known.filter(|known| known.number > set.number) {
            return Err(RevocationError::Old { found: set.number, known: known.number });
        }
        if known.is_none() && self.newest.len() >= SIGNERS_MAX {
            return Err(RevocationError::Full);
        }
        set.check(&Judge { revoked: self, ..*judge })?;
        let before = self.keys.len();
        self.keys.extend(set.keys.keys());
        // Of two with one number, everybody passes the same on.
        let is_first = known.is_none_or(|known| known.number < set.number || known.signature < set.signature);
        if is_first {
            self.newest.insert(set.signer, set);
        }
        Ok(Received::New(self.keys.len() - before))
    }
}
