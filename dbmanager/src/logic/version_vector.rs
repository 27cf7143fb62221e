//! Replica ids, dots and version vectors: a writer, one transaction of a writer, and a set of transactions given by one
//! number for each writer.
//!
//! The transactions of one origin are numbered from 1 without gaps and are taken over in that order. So a version vector
//! (one number for each origin) gives exactly the transactions that a replica has. The difference of two version vectors
//! is exactly the set that one side lacks. No search tree and no set reconciliation is needed.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// One life of one store: a random number that is drawn when the store is made. It is never derived from a robot's name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ReplicaId(#[serde(with = "comms::logic::human::hex")] u64);

impl ReplicaId {
    /// Returns the origin with this number.
    pub const fn new(number: u64) -> Self {
        Self(number)
    }

    /// Returns the number of the origin.
    pub const fn number(self) -> u64 {
        self.0
    }

    /// Reads the text that [`Display`](fmt::Display) writes.
    pub fn parse(text: &str) -> Option<Self> {
        let plain = text.len() == 16 && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'));
        plain.then(|| u64::from_str_radix(text, 16).ok().map(Self))?
    }
}

impl fmt::Display for ReplicaId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// The name of one transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Dot {
    /// The replica that committed the transaction.
    pub origin: ReplicaId,
    /// The number of the transaction at that replica, from 1.
    pub seq: u64,
}

impl fmt::Display for Dot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.origin, self.seq)
    }
}

/// A set of transactions: all of each origin up to a number. Origins without transactions are left out.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<(ReplicaId, u64)>", into = "Vec<(ReplicaId, u64)>")]
pub struct VersionVector(BTreeMap<ReplicaId, u64>);

impl From<Vec<(ReplicaId, u64)>> for VersionVector {
    fn from(entries: Vec<(ReplicaId, u64)>) -> Self {
        entries.into_iter().collect()
    }
}

impl FromIterator<(ReplicaId, u64)> for VersionVector {
    fn from_iter<T: IntoIterator<Item = (ReplicaId, u64)>>(entries: T) -> Self {
        let mut vector = Self::default();
        for (origin, seq) in entries {
            vector.include(Dot { origin, seq });
        }
        vector
    }
}

impl From<VersionVector> for Vec<(ReplicaId, u64)> {
    fn from(vector: VersionVector) -> Self {
        vector.0.into_iter().collect()
    }
}

impl VersionVector {
    /// Returns the number up to which `origin`'s transactions are included; 0 for none.
    pub fn get(&self, origin: ReplicaId) -> u64 {
        self.0.get(&origin).copied().unwrap_or(0)
    }

    /// Returns whether the transaction is included.
    pub fn contains(&self, dot: Dot) -> bool {
        dot.seq <= self.get(dot.origin)
    }

    /// Returns whether everything in `other` is included.
    pub fn dominates(&self, other: &Self) -> bool {
        other.0.iter().all(|(origin, seq)| self.get(*origin) >= *seq)
    }

    /// Grows to include the transaction, and all earlier ones of its origin.
    pub fn include(&mut self, dot: Dot) {
        if dot.seq > self.get(dot.origin) {
            self.0.insert(dot.origin, dot.seq);
        }
    }

    /// Grows to include `other`.
    pub fn join(&mut self, other: &Self) {
        for (origin, seq) in other.iter() {
            self.include(Dot { origin, seq });
        }
    }

    /// Extends the context of an origin to its next transaction `to`, which names only the additions `more`.
    pub fn go_on(&mut self, to: Dot, more: &Self) {
        self.join(more);
        self.include(Dot { seq: to.seq.saturating_sub(1), ..to });
    }

    /// Shrinks to the part that is common with `other`.
    pub fn meet(&mut self, other: &Self) {
        self.0.retain(|origin, seq| {
            *seq = (*seq).min(other.get(*origin));
            *seq > 0
        });
    }

    /// Returns the entries that are larger than in `base`.
    pub fn beyond(&self, base: &Self) -> Self {
        Self(self.0.iter().filter(|(origin, seq)| **seq > base.get(**origin)).map(|(o, s)| (*o, *s)).collect())
    }

    /// Returns the version vector without an origin.
    #[must_use]
    pub fn without(mut self, origin: ReplicaId) -> Self {
        self.0.remove(&origin);
        self
    }

    /// Returns the entries by origin.
    pub fn iter(&self) -> impl Iterator<Item = (ReplicaId, u64)> {
        self.0.iter().map(|(origin, seq)| (*origin, *seq))
    }

    /// Returns the number of origins.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether no transaction is included.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns a digest of 64 bits: the same for equal version vectors, and almost certainly different for others.
    pub fn digest(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        for (origin, seq) in self.iter() {
            hasher.update(&origin.number().to_le_bytes()).update(&seq.to_le_bytes());
        }
        let mut digest = [0; 8];
        digest.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
        u64::from_le_bytes(digest)
    }
}

impl fmt::Display for VersionVector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut between = "";
        for (origin, seq) in self.iter() {
            write!(f, "{between}{origin}:{seq}")?;
            between = " ";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = VersionVector> {
        proptest::collection::vec((0..4_u64, 0..4_u64), 0..6)
            .prop_map(|entries| entries.into_iter().map(|(origin, seq)| (ReplicaId::new(origin), seq)).collect())
    }

    proptest! {
        #[test]
        fn join_and_meet_are_a_lattice(a in vector(), b in vector()) {
            let (mut join, mut meet) = (a.clone(), a.clone());
            join.join(&b);
            meet.meet(&b);
            prop_assert!(join.dominates(&a) && join.dominates(&b) && a.dominates(&meet) && b.dominates(&meet));
            prop_assert_eq!(a.dominates(&b) && b.dominates(&a), a == b);
            let mut again = a.clone();
            again.join(&join.beyond(&a));
            prop_assert_eq!(&again, &join);
            prop_assert_eq!(a.digest() == b.digest(), a == b);
            let bytes = postcard::to_stdvec(&a).unwrap();
            prop_assert_eq!(postcard::from_bytes::<VersionVector>(&bytes).unwrap(), a);
        }
    }

    #[test]
    fn origins_are_read_as_they_are_written() {
        let origin = ReplicaId::new(0xab);
        assert_eq!(ReplicaId::parse(&origin.to_string()), Some(origin));
        assert_eq!(
            [ReplicaId::parse("ab"), ReplicaId::parse("00000000000000AB"), ReplicaId::parse("+0000000000000ab")],
            [None; 3]
        );
    }
}
