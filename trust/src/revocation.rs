//! Revoked keys, which are no longer trusted.
//!
//! The team's key, and each admin, sign separate sets with growing numbers. Two copies of one signer's keys may
//! continue from the same number, so the numbers decide nothing. If one of two sets of a signer has all keys of the
//! other, it replaces the other. If each set has a key that the other lacks, both are held. Members send all sets that
//! they hold at every contact. So all members finally hold the same sets, regardless of the order in which they
//! arrived. A revocation is never undone; the owner of a revoked key gets a new one.

use crate::identity::{KeyId, SIGNATURE_LEN, SecretKeys};
use crate::name::UnixTime;
use crate::role::Action;
use crate::team::{CREDENTIAL_MAX, Credential, Judge, Team, TrustError};
use crate::wire::{FormError, Reader, Writer};
use std::collections::{BTreeMap, BTreeSet};
use thiserror::Error;

/// The most keys of a set.
pub const REVOKED_MAX: usize = 4096;
/// The most sets of the team's key that a member holds at a time. None of them contains another.
pub const SETS_MAX: usize = 16;
/// The most bytes of admins' sets that a member holds. They do not reduce the room for sets of the team's key.
pub const ADMINS_BYTES_MAX: usize = 1 << 20;
/// The most bytes of a set.
pub const SET_MAX: usize = 256 + CREDENTIAL_MAX + 40 * REVOKED_MAX;

const SET: &str = "dca revoked 1";

/// The revocations of one signer under one number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RevokedSet {
    team: KeyId,
    signer: KeyId,
    number: u64,
    keys: BTreeMap<KeyId, UnixTime>,
    signature: [u8; SIGNATURE_LEN],
    /// The credential of the signer; none for the team's key. The signature does not cover it, because it may be
    /// renewed.
    credential: Option<Credential>,
}

/// Why a set was refused, or cannot be made.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RevocationError {
    /// The signer is neither the team's key nor an admin, or the signature is not valid.
    #[error("the revocations are not signed by the team or one of its admins")]
    Signer,
    /// The signer is not trusted.
    #[error("the signer of the revocations is not trusted: {0}")]
    Trust(TrustError),
    /// There are too many keys.
    #[error("no more than {REVOKED_MAX} keys can be revoked by one signer")]
    TooMany,
    /// The member already holds as many sets as it can.
    #[error(
        "a node holds at most {SETS_MAX} sets of revocations that do not contain each other; to join these sets, run `dca team revoke \
         NAME` or `dca team user remove NAME` on a machine whose node knows them"
    )]
    Full,
}

/// The effect of receiving a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// All keys of the set are already known, and the held sets pass them on.
    Known,
    /// The set is new: store it, pass it on, and cut the links of the keys that were trusted until now. The value is
    /// their number.
    New(usize),
}

impl RevokedSet {
    /// Signs a set. `credential` is the credential of the signer. None for the team's key.
    ///
    /// # Errors
    /// If there are too many keys.
    pub fn sign(
        team: &Team,
        number: u64,
        keys: BTreeMap<KeyId, UnixTime>,
        signer: &SecretKeys,
        credential: Option<Credential>,
    ) -> Result<Self, RevocationError> {
        if keys.len() > REVOKED_MAX {
            return Err(RevocationError::TooMany);
        }
        let signature = [0; SIGNATURE_LEN];
        let mut set = Self { team: team.id(), signer: signer.public().id(), number, keys, signature, credential };
        set.signature = signer.sign(&set.form());
        Ok(set)
    }

    /// Returns the number of the set.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Returns the revoked keys, each with the time of its revocation.
    pub const fn keys(&self) -> &BTreeMap<KeyId, UnixTime> {
        &self.keys
    }

    /// Returns whether the set claims to be signed with the team's key, not by an admin.
    #[must_use]
    pub const fn is_of_the_team(&self) -> bool {
        self.credential.is_none()
    }

    /// Checks the signer, and the signer's right to revoke.
    pub(crate) fn check(&self, judge: &Judge<'_>) -> Result<(), RevocationError> {
        let keys = match &self.credential {
            None => *judge.team.root(),
            // Refused, so that each set of the team's key has only one form.
            Some(_) if self.signer == judge.team.id() => return Err(RevocationError::Signer),
            Some(credential) => {
                // An admin's revocations remain valid after the admin's certificate has ended: its end does not make a
                // revoked key trusted again.
                let judge = Judge { now: judge.now.min(credential.certificate().claims().not_after), ..*judge };
                credential.require(Action::Revoke, &judge).map_err(RevocationError::Trust)?;
                credential.certificate().claims().keys
            }
        };
        let is_signed = keys.id() == self.signer && keys.has_signed(&self.form(), &self.signature);
        if self.team == judge.team.id() && is_signed { Ok(()) } else { Err(RevocationError::Signer) }
    }

    /// Returns whether this set has everything that another set has. If two sets have the same keys, one of them covers
    /// the other; it is the same one on every member.
    fn covers(&self, other: &Self) -> bool {
        let is_of_same = self.team == other.team && self.signer == other.signer;
        let rank = |set: &Self| (set.number, set.signature, set.credential.as_ref().map(Credential::to_bytes));
        is_of_same
            && other.keys.keys().all(|key| self.keys.contains_key(key))
            && (self.keys.len() > other.keys.len() || rank(self) >= rank(other))
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

    /// Returns the bytes of the set in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.form();
        bytes.extend_from_slice(&self.signature);
        bytes.extend(self.credential.iter().flat_map(Credential::to_bytes));
        bytes
    }

    /// Reads the bytes of a set. The signature is not checked here.
    ///
    /// # Errors
    /// If the bytes are not a set.
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

/// All revocations that a member knows. Revoked keys are only ever added.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Revocations {
    /// The sets that are passed on and stored on the disk, sorted by signer and number. None of them covers another.
    sets: Vec<RevokedSet>,
    /// The keys in all sets.
    keys: BTreeSet<KeyId>,
}

impl Revocations {
    /// Returns whether a key is revoked.
    #[must_use]
    pub fn has(&self, key: &KeyId) -> bool {
        self.keys.contains(key)
    }

    /// Returns the keys that are revoked.
    pub const fn keys(&self) -> &BTreeSet<KeyId> {
        &self.keys
    }

    /// Returns the held sets, which members send to each other.
    #[must_use]
    pub fn sets(&self) -> &[RevokedSet] {
        &self.sets
    }

    /// Returns the highest number of a signer's sets; 0 if there are none.
    #[must_use]
    pub fn number_of(&self, signer: &KeyId) -> u64 {
        self.sets.iter().filter(|set| set.signer == *signer).map(RevokedSet::number).max().unwrap_or(0)
    }

    /// Adds a set. It is checked against the earlier revocations: a revoked signer cannot revoke any more.
    ///
    /// # Errors
    /// If the set is not signed by a permitted signer, or has more new keys than fit. Nothing is added then.
    pub fn receive(&mut self, set: RevokedSet, judge: &Judge<'_>) -> Result<Received, RevocationError> {
        if self.covers(&set) {
            return Ok(Received::Known);
        }
        set.check(&Judge { revoked: self, ..*judge })?;
        if self.has_room(&set) {
            Ok(self.insert(set))
        } else if set.keys.keys().all(|key| self.has(key)) {
            Ok(Received::Known)
        } else {
            Err(RevocationError::Full)
        }
    }

    /// Adds a stored set that was checked when it was received. It remains valid, even if its signer was revoked or has
    /// ended since.
    ///
    /// # Errors
    /// If the set is not signed by a possible signer.
    pub fn restore(&mut self, set: RevokedSet, team: &Team) -> Result<Received, RevocationError> {
        set.check(&Judge { team, revoked: &Self::default(), now: UnixTime(u64::MAX), grace: 0 })?;
        Ok(if self.covers(&set) { Received::Known } else { self.insert(set) })
    }

    fn covers(&self, set: &RevokedSet) -> bool {
        self.sets.iter().any(|known| known.covers(set))
    }

    fn has_room(&self, set: &RevokedSet) -> bool {
        let is_beside = |known: &&RevokedSet| known.is_of_the_team() == set.is_of_the_team() && !set.covers(known);
        let beside = self.sets.iter().filter(is_beside);
        if set.is_of_the_team() {
            beside.count() < SETS_MAX
        } else {
            let size = |set: &RevokedSet| set.to_bytes().len();
            beside.map(size).sum::<usize>() + size(set) <= ADMINS_BYTES_MAX
        }
    }

    fn insert(&mut self, set: RevokedSet) -> Received {
        let before = self.keys.len();
        self.keys.extend(set.keys.keys());
        self.sets.retain(|known| !set.covers(known));
        self.sets.push(set);
        self.sets.sort_by_key(|set| (set.signer, set.number, set.signature));
        Received::New(self.keys.len() - before)
    }
}
