//! The versions of each key, and the whole merge rule.
//!
//! *State.* `key -> {version}`, a version being `(dot, stamp, value | deleted)`: the writes that no other write has seen.
//!
//! *Merge rule.* A transaction `T` with context `ctx` is applied once, after everything in `ctx`. At each key it
//! writes, it takes away the versions whose dot is in `ctx` and adds its own. A transaction that was rebased from
//! another life of its replica (see [`merge`](crate::logic::merge)) takes away less: within `ctx`, only the versions it
//! names, and deletions. A read shows the version with the largest timestamp; versions with different values are a
//! conflict. With one value there is nothing to decide: several replicas that resolve in the same way, or rebase the
//! same write, make no new conflict.
//!
//! *T1, convergence.* Write `w ▷ v` if `w` takes away `v`: a relation between writes, fixed when `w` is committed. Since
//! `w ▷ v` needs `v` in `w`'s context, which must be here before `w` is applied, each pair is met in this order, `v` first.
//! So after any order of application that the guard allows, the versions of a key are `{v | no w ▷ v}`, which depends on
//! the set of transactions alone. Equal version vectors are equal sets (T6), hence equal states; sets grow by union, which is a
//! semilattice.
//!
//! *T2, one serial order.* Timestamps extend causality, so the largest timestamp among the versions is the largest of all writes to
//! the key: what it was taken away by has a larger timestamp. The visible state is that of running all transactions one after
//! another by timestamp, the same order for every key, so that none ends up half overwritten in different ways.
//!
//! *T3, whole transactions.* All writes of a transaction go in in one call, and readers see the state before or after it.
//!
//! *Deletions* are versions without a value, until every later write must have seen them: see `collect`. The digest
//! leaves out keys that are only deleted, so dropping them changes nothing.

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
    /// When, in the one order of all.
    pub stamp: Timestamp,
    /// The value; `None` for a deletion.
    pub value: Option<Value>,
}

/// The causal context of a transaction: all that its writer had seen.
#[derive(Clone, Copy, Debug)]
pub struct CausalContext<'a> {
    /// Its context.
    pub context: &'a VersionVector,
    /// Set if it was rebased: within the context, it takes away only these (in order) and deletions.
    pub only: Option<&'a [Dot]>,
}

impl CausalContext<'_> {
    fn takes_away(&self, version: &Version) -> bool {
        let deletion = version.value.is_none();
        let named = |only: &[Dot]| deletion || only.binary_search(&version.dot).is_ok();
        self.context.contains(version.dot) && self.only.is_none_or(named)
    }
}

/// The versions of every key. A clone is a snapshot: it shares everything that is not written afterwards, and costs nothing.
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
    /// Applies one transaction. All transactions it has seen must be applied already, and itself not yet.
    pub fn apply(&mut self, dot: Dot, stamp: Timestamp, seen: CausalContext<'_>, writes: &[Write]) {
        for Write { key, value } in writes {
            let mut versions = self.take(key);
            versions.retain(|version| !seen.takes_away(version));
            versions.push(Version { dot, stamp, value: value.clone() });
            versions.sort_by_key(|version| (version.stamp, version.dot));
            self.put(key.clone(), versions);
        }
    }

    /// Returns how many keys there are, deleted ones included.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns whether it has no keys.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Returns the versions of a key, by timestamp: a read shows the last.
    pub fn versions(&self, key: &Key) -> &[Version] {
        self.entries.get(key).map_or(&[], AsRef::as_ref)
    }

    /// Returns the version that a read shows; `None` if the key has no version, or only a deletion.
    pub fn get(&self, key: &Key) -> Option<&Version> {
        self.versions(key).last().filter(|version| version.value.is_some())
    }

    /// Returns whether there are writes to the key that did not see each other.
    pub fn is_conflict(&self, key: &Key) -> bool {
        differ(self.versions(key))
    }

    /// Returns the keys below `prefix`, deleted ones included, with their versions.
    pub fn scan<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a Key, &'a [Version])> {
        // A prefix that is not itself a key gives no key to begin at.
        let start = Key::new(prefix.trim_end_matches('/')).map_or(Bound::Unbounded, Bound::Included);
        let below = move |key: &Key| key.as_str().starts_with(prefix);
        let behind = move |key: &Key| key.as_str() > prefix && !key.as_str().starts_with(prefix);
        let keys = self.entries.range((start, Bound::Unbounded)).take_while(move |(key, _)| !behind(key));
        keys.filter(move |(key, _)| below(key)).map(|(key, versions)| (key, versions.as_ref()))
    }

    /// Returns the keys below `prefix` with versions that differ.
    pub fn conflicts<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a Key, &'a [Version])> {
        self.scan(prefix).filter(|(_, versions)| differ(versions))
    }

    /// Returns a number that equal states share, and that different states practically never share.
    pub fn digest(&self) -> u128 {
        self.digest
    }

    /// Checks a condition.
    ///
    /// # Errors
    /// If it does not hold, with the present version.
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

    /// Drops keys that are only deleted, and by nothing but transactions in `stable`. Returns them.
    pub(crate) fn drop_deleted(&mut self, stable: &VersionVector) -> Vec<Key> {
        let gone = |versions: &[Version]| is_deleted(versions) && versions.iter().all(|v| stable.contains(v.dot));
        let keys: Vec<Key> = self.entries.iter().filter(|(_, v)| gone(v)).map(|(key, _)| key.clone()).collect();
        for key in &keys {
            self.entries.remove(key);
        }
        keys
    }

    /// Puts back a key as it was stored.
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

/// Returns whether nothing but deletions is there.
fn is_deleted(versions: &[Version]) -> bool {
    versions.iter().all(|version| version.value.is_none())
}

/// Returns whether the versions of a key have different values, so that a client has to choose; a deletion is one too.
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
