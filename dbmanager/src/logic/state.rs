//! The versions of each key, and the complete merge rule.
//!
//! *State.* `key -> {version}`. A version is `(dot, stamp, value | deleted)`: a write that no other write has seen.
//!
//! *Merge rule.* A transaction `T` with context `ctx` is applied once, after everything in `ctx`. At each key that it writes, it
//! takes away the versions whose dot is in `ctx`, and adds its own. A transaction that was rebased from another life of its replica (see
//! [`merge`](crate::logic::merge)) removes fewer versions: within `ctx`, it removes only deletions and the versions that it names. A read
//! shows the version with the largest timestamp. Versions with different values are a conflict.
//! Versions with the same value are not a conflict. So several replicas that resolve a conflict in
//! the same way, or rebase the same write, make no new conflict.
//!
//! *T1, convergence.* Write `w ▷ v` if `w` takes away `v`. This relation between writes is fixed when `w` is committed. `w ▷ v`
//! requires `v` in `w`'s context, which must be here before `w` is applied. So in each pair, `v` is applied first. So after any
//! order of application that the log permits, the versions of a key are `{v | no w ▷ v}`, which depends only on the set of
//! transactions. Equal version vectors mean equal sets (T6), and so equal states. Sets grow by union, which is a semilattice.
//!
//! *T2, one serial order.* Timestamps extend causality. So the largest timestamp among the versions is the largest timestamp
//! of all writes to the key. The reason: a removed write has a smaller timestamp than the write that removed it. The visible
//! state is the result of running all transactions one after another by timestamp, in the same order for every key. So
//! concurrent transactions never overwrite each other partly in one way and partly in the other.
//!
//! *T3, whole transactions.* One call applies all writes of a transaction, and readers see the state before or after it.
//!
//! *Deletions* are versions without a value. They are kept until every later write must have seen them: see
//! `State::drop_deleted`. The digest leaves out keys that have only deletions, so dropping them does not change it.

use crate::logic::clock::Timestamp;
use crate::logic::key::Key;
use crate::logic::txn::{Condition, Require, TxnError, Value, Write};
use crate::logic::version_vector::{Dot, VersionVector};
use imbl::OrdMap;
use serde::{Deserialize, Serialize};
use std::ops::Bound;
use std::sync::Arc;

/// A write that no other write has seen.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Version {
    /// The transaction that wrote it.
    pub dot: Dot,
    /// The timestamp of the write, in the total order.
    pub stamp: Timestamp,
    /// The value; `None` for a deletion.
    pub value: Option<Value>,
}

/// The causal context of a transaction: everything that its writer had seen.
#[derive(Clone, Copy, Debug)]
pub struct CausalContext<'a> {
    /// The context of the transaction.
    pub context: &'a VersionVector,
    /// Set if the transaction was rebased: within the context, it takes away only these versions (sorted) and deletions.
    pub only: Option<&'a [Dot]>,
}

impl CausalContext<'_> {
    fn takes_away(&self, version: &Version) -> bool {
        let deletion = version.value.is_none();
        let named = |only: &[Dot]| deletion || only.binary_search(&version.dot).is_ok();
        self.context.contains(version.dot) && self.only.is_none_or(named)
    }
}

/// The versions of every key. A clone is a snapshot and is cheap: it shares everything that is not written afterwards.
#[derive(Clone, Debug, Default)]
pub struct State {
    entries: OrdMap<Key, Arc<[Version]>>,
    digest: u128,
}

impl PartialEq for State {
    fn eq(&self, other: &Self) -> bool {
        let pending = |state: &Self| state.entries.iter().filter(|(_, versions)| !is_deleted(versions)).count();
        let same =
            |(key, versions): (&Key, &Arc<[Version]>)| is_deleted(versions) || other.entries.get(key) == Some(versions);
        pending(self) == pending(other) && self.entries.iter().all(same)
    }
}

impl State {
    /// Applies one transaction. All transactions that it has seen must be applied already, and it must not be applied yet.
    pub fn apply(&mut self, dot: Dot, stamp: Timestamp, seen: CausalContext<'_>, writes: &[Write]) {
        for Write { key, value } in writes {
            let mut versions = self.take(key);
            versions.retain(|version| !seen.takes_away(version));
            versions.push(Version { dot, stamp, value: value.clone() });
            versions.sort_by_key(|version| (version.stamp, version.dot));
            self.put(key.clone(), versions);
        }
    }

    /// Returns the number of keys, including deleted ones.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns whether the state is empty.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Returns the versions of a key, sorted by timestamp: a read shows the last one.
    pub fn versions(&self, key: &Key) -> &[Version] {
        self.entries.get(key).map_or(&[], AsRef::as_ref)
    }

    /// Returns the version that a read shows; `None` if the key has no version, or only a deletion.
    pub fn get(&self, key: &Key) -> Option<&Version> {
        self.versions(key).last().filter(|version| version.value.is_some())
    }

    /// Returns whether the key has different values by writes that did not see each other.
    pub fn is_conflict(&self, key: &Key) -> bool {
        differ(self.versions(key))
    }

    /// Returns the keys below `prefix`, including deleted ones, with their versions.
    pub fn scan<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a Key, &'a [Version])> {
        // A prefix that is not itself a valid key gives no key to begin at.
        let start = Key::new(prefix.trim_end_matches('/')).map_or(Bound::Unbounded, Bound::Included);
        let below = move |key: &Key| key.as_str().starts_with(prefix);
        let behind = move |key: &Key| key.as_str() > prefix && !key.as_str().starts_with(prefix);
        let keys = self.entries.range((start, Bound::Unbounded)).take_while(move |(key, _)| !behind(key));
        keys.filter(move |(key, _)| below(key)).map(|(key, versions)| (key, versions.as_ref()))
    }

    /// Returns the keys below `prefix` whose versions have different values.
    pub fn conflicts<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a Key, &'a [Version])> {
        self.scan(prefix).filter(|(_, versions)| differ(versions))
    }

    /// Returns a digest of the state: equal for equal states, and almost certainly different for different states.
    pub fn digest(&self) -> u128 {
        self.digest
    }

    /// Checks a condition.
    ///
    /// # Errors
    /// If the condition does not hold; the error has the present version.
    pub fn check(&self, require: &Require) -> Result<(), TxnError> {
        let Require { key, condition } = require;
        let holds = match condition {
            Condition::Absent => self.get(key).is_none() && !self.is_conflict(key),
            Condition::Exists => self.get(key).is_some(),
            Condition::Is(dot) => self.get(key).is_some_and(|version| version.dot == *dot) && !self.is_conflict(key),
        };
        if holds {
            return Ok(());
        }
        let values = self.versions(key).iter().filter(|version| version.value.is_some());
        let actual = values.map(|version| version.dot).collect();
        Err(TxnError::Precondition { key: key.clone(), condition: *condition, actual })
    }

    /// Drops keys that have only deletions by transactions in `stable`. Returns these keys.
    pub(crate) fn drop_deleted(&mut self, stable: &VersionVector) -> Vec<Key> {
        let gone = |versions: &[Version]| is_deleted(versions) && versions.iter().all(|v| stable.contains(v.dot));
        let keys: Vec<Key> = self.entries.iter().filter(|(_, v)| gone(v)).map(|(key, _)| key.clone()).collect();
        for key in &keys {
            self.entries.remove(key);
        }
        keys
    }

    /// Restores a stored key.
    pub(crate) fn restore(&mut self, key: Key, versions: Vec<Version>) {
        drop(self.take(&key));
        self.put(key, versions);
    }

    fn take(&mut self, key: &Key) -> Vec<Version> {
        let versions = self.entries.remove(key).map_or_else(Vec::new, |versions| versions.to_vec());
        self.digest = self.digest.wrapping_sub(digest(key, &versions));
        versions
    }

    fn put(&mut self, key: Key, versions: Vec<Version>) {
        self.digest = self.digest.wrapping_add(digest(&key, &versions));
        if !versions.is_empty() {
            self.entries.insert(key, versions.into());
        }
    }
}

/// Returns whether all versions are deletions.
fn is_deleted(versions: &[Version]) -> bool {
    versions.iter().all(|version| version.value.is_none())
}

/// Returns whether the versions of a key have different values, so that a client has to choose. A deletion counts as a value.
pub fn differ(versions: &[Version]) -> bool {
    versions.iter().any(|version| version.value != versions[0].value)
}

fn digest(key: &Key, versions: &[Version]) -> u128 {
    if is_deleted(versions) {
        return 0;
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update(key.as_str().as_bytes());
    for Version { dot, stamp, value } in versions {
        hasher.update(&[0xff]).update(&dot.origin.number().to_le_bytes()).update(&dot.seq.to_le_bytes());
        hasher.update(&stamp.epoch.to_le_bytes()).update(&stamp.hlc.to_le_bytes());
        let (encoding, bytes) = value.as_ref().map_or((0, &[][..]), |value| (value.encoding.0, &value.bytes));
        hasher.update(&[u8::from(value.is_some()), encoding]).update(&bytes.len().to_le_bytes()).update(bytes);
    }
    let mut digest = [0; 16];
    digest.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
    u128::from_le_bytes(digest)
}

#[cfg(test)]
mod tests;
