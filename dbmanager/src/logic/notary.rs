//! The authors of transactions, in a team whose robots have keys.
//!
//! *Records.* For each `sys/members/<origin>` there is a `sys/keys/<origin>`: a [`Claim`]. With it,
//! a robot signs that this origin is its own, and lists the other origins that it has given up. The
//! claim is written with the admission. So a replica that has a transaction of an origin also has
//! the origin's key.
//!
//! *Rule.* A transaction is accepted only if it is signed with the key of its origin. It may admit an origin only if it has that
//! origin's claim. It may retire an origin only if that belongs to the same robot, is given up in a claim, or its key is revoked. No
//! date is after the year 2200 unless earlier ones were, in any epoch. Epochs rise by a few at a time, so dates cannot be used up. A
//! transaction that breaks the rule is refused by all replicas alike. The exception are revocations that some replicas do not know
//! yet; these replicas ask again.
//!
//! *Not covered.* A replica that takes over a whole state, as a newcomer does, trusts its sponsor.

use crate::logic::key::Key;
use crate::logic::member;
use crate::logic::state::State;
use crate::logic::txn::{Encoding, Txn, Value, Write};
use crate::logic::version_vector::ReplicaId;
use serde::{Deserialize, Serialize};
use std::fmt;

const KEYS: &str = "sys/keys/";
/// The most bytes of a claim.
const CLAIM_MAX: usize = 32 << 10;
/// The length of a signature in bytes.
pub const SIGNATURE_SIZE: usize = 64;

/// Signs as this robot, and checks signatures of others. It only computes: no I/O, no waiting.
pub trait Notary: fmt::Debug + Send + Sync {
    /// Signs a digest.
    fn sign(&self, digest: &[u8; 32]) -> Vec<u8>;

    /// Returns the credential that proves the owner of this key.
    fn credential(&self) -> Vec<u8>;

    /// Returns the owner of the key in a credential, even if the credential is old or the key was revoked since.
    ///
    /// # Errors
    /// The credential is not from the team; the reason is for people.
    fn holder(&self, credential: &[u8]) -> Result<Holder, String>;

    /// Returns whether a key has signed a digest.
    fn is_signed(&self, holder: &Holder, digest: &[u8; 32], signature: &[u8]) -> bool;

    /// Returns whether the team has revoked a key, as far as this robot knows.
    fn is_revoked(&self, holder: &Holder) -> bool;
}

/// The owner of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// The name of the robot, from its certificate.
    pub robot: String,
    /// The two public keys of the robot.
    pub keys: [u8; 64],
}

/// A robot's signed statement that an origin is its own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claim {
    credential: Vec<u8>,
    /// Origins that the robot has given up.
    replaces: Vec<ReplicaId>,
    signature: Vec<u8>,
}

/// Why a transaction of another robot is not accepted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// The owner of the transaction's origin is not known.
    Unknown,
    /// The transaction breaks a rule; the text is for people.
    Forged(String),
}

impl Claim {
    /// Claims an origin for this robot, and names the origins that this robot has given up.
    pub fn make(notary: &dyn Notary, origin: ReplicaId, replaces: &[ReplicaId]) -> Self {
        let signature = notary.sign(&claimed(origin, replaces));
        Self { credential: notary.credential(), replaces: replaces.to_vec(), signature }
    }

    /// Returns the owner of an origin according to this claim.
    ///
    /// # Errors
    /// The claim is forged, or for another origin.
    pub fn check(&self, notary: &dyn Notary, origin: ReplicaId) -> Result<Holder, String> {
        let holder = notary.holder(&self.credential)?;
        if notary.is_signed(&holder, &claimed(origin, &self.replaces), &self.signature) {
            Ok(holder)
        } else {
            Err(format!("`{}` has not claimed {origin}", holder.robot))
        }
    }

    /// Returns the bytes of the claim, in the form for messages and the database.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// Reads a claim from its bytes; none if they are not a claim.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        if bytes.len() > CLAIM_MAX { None } else { postcard::from_bytes(bytes).ok() }
    }
}

/// Returns the digest of the bytes of a transaction.
pub fn written(body: &[u8]) -> [u8; 32] {
    blake3::derive_key("dca txn 1", body)
}

fn claimed(origin: ReplicaId, replaces: &[ReplicaId]) -> [u8; 32] {
    let origins = std::iter::once(&origin).chain(replaces);
    let bytes: Vec<u8> = origins.flat_map(|origin| origin.number().to_le_bytes()).collect();
    blake3::derive_key("dca claim 1", &bytes)
}

/// Returns whether a key is the record of a claim. Such records are facts of one team and are not moved to another team.
pub fn is_record(key: &Key) -> bool {
    key.as_str().starts_with(KEYS)
}

fn origin_of(key: &Key) -> Option<ReplicaId> {
    ReplicaId::parse(key.as_str().strip_prefix(KEYS)?)
}

/// Returns the write that stores a claim.
pub fn record(origin: ReplicaId, claim: &[u8]) -> Option<Write> {
    let value = Value { encoding: Encoding::BYTES, bytes: claim.into() };
    Some(Write { key: Key::new(format!("{KEYS}{origin}")).ok()?, value: Some(value) })
}

/// Returns the owner of an origin according to the state: the robot of the membership, if it has claimed the origin.
pub fn holder(notary: &dyn Notary, origin: ReplicaId, state: &State) -> Option<Holder> {
    let key = Key::new(format!("{KEYS}{origin}")).ok()?;
    let robots = member::robots(state, origin);
    let claims = state.versions(&key).iter().filter_map(|version| Claim::from_bytes(&version.value.as_ref()?.bytes));
    claims.filter_map(|claim| claim.check(notary, origin).ok()).find(|holder| robots.contains(&holder.robot))
}

/// Returns whether the robot `by` may retire an origin with the owner `whose`. An origin from before the team had keys cannot write
/// any more.
pub fn may_retire(notary: &dyn Notary, by: &Holder, whose: Option<&Holder>) -> bool {
    whose.is_none_or(|whose| whose.robot == by.robot || notary.is_revoked(whose))
}

/// Checks the membership records that a transaction of `author` writes, given the earlier owners of origins.
///
/// # Errors
/// If the transaction admits or retires an origin without the right to do so; the reason is for people.
pub fn check_records(
    notary: &dyn Notary,
    txn: &Txn,
    author: &Holder,
    holder: impl Fn(ReplicaId) -> Option<Holder>,
) -> Result<(), String> {
    let bytes = |write: &Write| write.value.as_ref().map(|value| value.bytes.to_vec()).unwrap_or_default();
    let mut claims = Vec::new();
    for write in txn.writes.iter().filter(|write| is_record(&write.key)) {
        let read = origin_of(&write.key).zip(Claim::from_bytes(&bytes(write)));
        let (origin, claim) = read.ok_or_else(|| format!("`{}` is not a claim", write.key))?;
        let by = claim.check(notary, origin)?;
        claims.push((origin, claim, by));
    }
    let mut admitted = Vec::new();
    for write in &txn.writes {
        let Some(origin) = member::admitted_by(&write.key) else { continue };
        let claim = claims.iter().find(|(claimed, ..)| *claimed == origin);
        let (_, _, by) = claim.ok_or_else(|| format!("{origin} is admitted without a claim of its own"))?;
        if by.robot.as_bytes() != bytes(write) {
            return Err(format!("{origin} is admitted under the name of another robot"));
        }
        if holder(origin).is_some_and(|known| known != *by) {
            return Err(format!("{origin} is another robot's already"));
        }
        admitted.push(origin);
    }
    if let Some((origin, ..)) = claims.iter().find(|(origin, ..)| !admitted.contains(origin)) {
        return Err(format!("{origin} is claimed without being admitted"));
    }
    for origin in txn.writes.iter().filter_map(|write| member::retired_by(&write.key)) {
        let known = holder(origin);
        let gives_up = |(_, claim, by): &(ReplicaId, Claim, Holder)| {
            claim.replaces.contains(&origin) && known.as_ref().is_none_or(|known| known.robot == by.robot)
        };
        if !may_retire(notary, author, known.as_ref()) && !claims.iter().any(gives_up) {
            let robot = known.map_or_else(|| origin.to_string(), |known| known.robot);
            return Err(format!("`{}` retires `{robot}`, whose key is not revoked", author.robot));
        }
    }
    Ok(())
}
