//! Replica ids, dots and version vectors: the writer, one of its transactions, and how many of each writer are included.
//!
//! The transactions of one origin are numbered from 1 without gaps and are taken over in that order. So a version
//! vector (one number for each origin) gives exactly the transactions that a replica has, and the difference of two
//! version vectors is exactly the set that one side lacks: no search tree and no set reconciliation is needed.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// One life of one store: random, minted when the store is made, never derived from a robot's name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ReplicaId(#[serde(with = "comms::logic::human::hex")] u64);

impl ReplicaId {
    /// Returns the origin with this number.
    pub const fn new(number: u64) -> Self {
        Self(number)
    }

    /// Returns its number.
    pub const fn number(self) -> u64 {
        self.0
    }

    /// Reads what [`Display`](fmt::Display) wrote.
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
    /// The replica that committed it.
    pub origin: ReplicaId,
    /// Its number there, from 1.
    pub seq: u64,
}

impl fmt::Display for Dot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.origin, self.seq)
    }
}

/// All transactions of each origin up to a number. Origins without transactions are not in it.
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
    /// Returns up to which number `origin`'s transactions are in it; 0 for none.
    pub fn get(&self, origin: ReplicaId) -> u64 {
        self.0.get(&origin).copied().unwrap_or(0)
    }

    /// Returns whether the transaction is in it.
    pub fn contains(&self, dot: Dot) -> bool {
        dot.seq <= self.get(dot.origin)
    }

    /// Returns whether everything in `other` is in it.
    pub fn dominates(&self, other: &Self) -> bool {
        other.0.iter().all(|(origin, seq)| self.get(*origin) >= *seq)
    }

    /// Grows so that the transaction, and all earlier ones of its origin, are in it.
    pub fn include(&mut self, dot: Dot) {
        if dot.seq > self.get(dot.origin) {
            self.0.insert(dot.origin, dot.seq);
        }
    }

    /// Grows so that `other` is in it.
    pub fn join(&mut self, other: &Self) {
        for (origin, seq) in other.iter() {
            self.include(Dot { origin, seq });
        }
    }

    /// Extends the context of an origin to its next transaction `to`, which only names the additions `more`.
    pub fn go_on(&mut self, to: Dot, more: &Self) {
        self.join(more);
        self.include(Dot { seq: to.seq.saturating_sub(1), ..to });
    }

    /// Shrinks to the common part with `other`.
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

    /// Returns how many origins are in it.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns whether nothing is in it.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns eight bytes that two equal version vectors share and two others practically never do.
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
