//! The transactions of each origin, without gaps, chained by hashes.
//!
//! *State.* For each origin: its *head* (number, hash, timestamp and full context of its last transaction), and the transactions
//! above the version vector `low`, in the order in which they were applied here.
//!
//! *Rule.* A transaction is taken if it is the next of its origin, names the hash of the previous one, and carries a larger
//! timestamp, and all transactions that it has seen are here. Other replicas are served in the order of application, which is causal.
//!
//! *T6, a dot names one transaction.* Two transactions with the same dot either have different hashes, or are the same bytes. The
//! hash is in the next transaction. So from a common head on, chains that differ once differ for ever, and the first exchange that
//! could notice it ends in [`Verdict::Fork`]. A transaction also has a digest of the hashes of the other transactions that it has
//! seen. It may have seen a different transaction under a number that is known here. Then it is not taken ([`Verdict::Apart`]), so it
//! cannot remove a version that its writer never saw.
//!
//! *T7, liveness.* Among transactions that are missing here and present at another replica, the first by causality can be applied,
//! and it is served first. So after one complete pull, the own version vector dominates the version
//! vector that the other replica had at the beginning of the pull.

use crate::logic::clock::Timestamp;
use crate::logic::txn::{ChainHash, EncodedTxn, Txn};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The last transaction of an origin.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Head {
    /// The number of the transaction.
    pub seq: u64,
    /// The hash that the next transaction names as its predecessor.
    pub hash: ChainHash,
    /// The timestamp of the transaction.
    pub stamp: Timestamp,
    /// The full context of the transaction.
    pub context: VersionVector,
}

impl Head {
    /// Returns the full context of the next transaction `next`, which reports `more` as seen.
    pub fn seen_after(&self, next: Dot, more: &VersionVector) -> VersionVector {
        let mut context = self.context.clone();
        context.go_on(next, more);
        context
    }
}

/// The verdict of the log on an arriving transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The transaction is the next one: apply it.
    Next,
    /// The transaction is already here.
    Known,
    /// A transaction before it is missing.
    Early,
    /// The origin has used a number twice, or its timestamps are in an impossible order.
    Fork,
    /// The transaction has seen another one under a number that belongs to a different transaction here.
    Apart,
}

/// An encoded transaction, and its position in the order of application.
#[derive(Clone, Debug)]
pub struct Logged {
    /// The position in the order of application.
    pub index: u64,
    /// The transaction.
    pub encoded: EncodedTxn,
}

/// The log of one replica.
#[derive(Clone, Debug, Default)]
pub struct Log {
    heads: BTreeMap<ReplicaId, Head>,
    txns: BTreeMap<Dot, Logged>,
    vector: VersionVector,
    next: u64,
    size: usize,
}

impl Log {
    /// Returns a log that begins after `heads`.
    pub fn new(heads: BTreeMap<ReplicaId, Head>) -> Self {
        let vector = heads.iter().map(|(origin, head)| (*origin, head.seq)).collect();
        Self { heads, vector, ..Self::default() }
    }

    /// Returns the version vector of the transactions in this log.
    pub fn vector(&self) -> &VersionVector {
        &self.vector
    }

    /// Returns the last transaction of `origin`.
    pub fn head(&self, origin: ReplicaId) -> Option<&Head> {
        self.heads.get(&origin)
    }

    /// Returns the number and hash of the last transaction of `origin`; zeros if there is none.
    pub fn tip(&self, origin: ReplicaId) -> (u64, ChainHash) {
        self.head(origin).map(|head| (head.seq, head.hash)).unwrap_or_default()
    }

    /// Returns the last transaction of every origin.
    pub fn heads(&self) -> &BTreeMap<ReplicaId, Head> {
        &self.heads
    }

    /// Returns a digest of 64 bits. Two logs have the same digest only if they have the same transactions, not only the same numbers.
    pub fn chains(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        for (origin, head) in &self.heads {
            hasher.update(&origin.number().to_le_bytes()).update(&head.seq.to_le_bytes()).update(&head.hash.0);
        }
        u64::from_le_bytes(ChainHash::of(&hasher).0)
    }

    /// Returns a transaction, encoded, if it is still kept.
    pub fn encoded(&self, dot: Dot) -> Option<&EncodedTxn> {
        self.txns.get(&dot).map(|logged| &logged.encoded)
    }

    /// Returns how many transactions are kept.
    pub fn len(&self) -> usize {
        self.txns.len()
    }

    /// Returns whether no transaction is kept.
    pub fn is_empty(&self) -> bool {
        self.txns.is_empty()
    }

    /// Returns the approximate size of the transactions in bytes.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Returns the largest timestamp.
    pub fn last_stamp(&self) -> Timestamp {
        self.heads.values().map(|head| head.stamp).max().unwrap_or_default()
    }

    /// Returns the version vector of the transactions that were dropped.
    pub fn low(&self) -> VersionVector {
        let kept = |origin: ReplicaId| {
            self.txns.range(Dot { origin, seq: 0 }..=Dot { origin, seq: u64::MAX }).next().map(|(dot, _)| dot.seq - 1)
        };
        self.vector.iter().map(|(origin, seq)| (origin, kept(origin).unwrap_or(seq))).collect()
    }

    /// Returns the transactions after `vector`, in the order of application. Each chain has no gap.
    pub(crate) fn after(&self, vector: &VersionVector) -> impl Iterator<Item = (Dot, &EncodedTxn)> {
        let next = |origin, after: u64| {
            let dot = Dot { origin, seq: after.saturating_add(1) };
            self.txns.get(&dot).map(|logged| (logged.index, (dot, &logged.encoded)))
        };
        let firsts = self.vector.iter().filter_map(|(origin, _)| next(origin, vector.get(origin)));
        let mut waiting: BTreeMap<u64, (Dot, &EncodedTxn)> = firsts.collect();
        std::iter::from_fn(move || {
            let (_, found) = waiting.pop_first()?;
            waiting.extend(next(found.0.origin, found.0.seq));
            Some(found)
        })
    }

    /// Returns the full context of a transaction that is the next of its origin.
    pub fn context(&self, txn: &Txn) -> VersionVector {
        let none = Head::default();
        self.head(txn.stamp.origin).unwrap_or(&none).seen_after(txn.dot(), &txn.context)
    }

    /// Returns the verdict on a transaction, which is given both decoded and encoded.
    pub fn judge(&self, txn: &Txn, encoded: &EncodedTxn) -> Verdict {
        let dot = txn.dot();
        let none = Head::default();
        let head = self.head(dot.origin).unwrap_or(&none);
        if dot.seq <= head.seq {
            let same = self.encoded(dot).is_none_or(|known| known == encoded);
            return if same && dot.seq > 0 { Verdict::Known } else { Verdict::Fork };
        }
        if dot.seq > head.seq + 1 {
            return Verdict::Early;
        }
        if dot.seq == head.seq + 1 && (txn.prev != head.hash || txn.stamp <= head.stamp) {
            return Verdict::Fork;
        }
        let missing = self.context(txn).beyond(&self.vector);
        if !missing.is_empty() {
            return Verdict::Early;
        }
        let differs = |said| self.seen(&txn.context).is_some_and(|here| here != said);
        if encoded.seen().is_some_and(differs) { Verdict::Apart } else { Verdict::Next }
    }

    /// Returns whether a transaction with this timestamp may be here. It cannot if the timestamp is later than the head of its
    /// origin. It also cannot if the transactions before and after it are kept and are neighbours. This happens when the origin was
    /// set back and has used a number again.
    pub fn may_have(&self, stamp: Timestamp) -> bool {
        let Some(head) = self.head(stamp.origin).filter(|head| stamp <= head.stamp) else { return false };
        let kept = |seq| Some(self.encoded(Dot { origin: stamp.origin, seq })?.open().ok()?.stamp);
        // The timestamps of an origin grow with its numbers, and the dropped transactions precede the kept ones.
        let (mut before, mut after) = (0, head.seq);
        while after - before > 1 {
            let middle = before + (after - before) / 2;
            if kept(middle).is_some_and(|other| other >= stamp) { after = middle } else { before = middle }
        }
        match kept(after) {
            Some(found) if found != stamp => before > 0 && kept(before).is_none(),
            _ => true,
        }
    }

    /// Returns the hash by which a transaction is known; `None` if it is unknown, or too few transactions are kept.
    pub fn hash(&self, dot: Dot) -> Option<ChainHash> {
        let head = self.head(dot.origin).filter(|head| head.seq == dot.seq).map(|head| head.hash);
        // If the transaction was dropped, the next one still has its hash.
        let next = || Some(self.encoded(Dot { seq: dot.seq.checked_add(1)?, ..dot })?.open().ok()?.prev);
        head.or_else(|| self.encoded(dot).map(EncodedTxn::hash)).or_else(next)
    }

    /// Returns a digest of the hashes of the last transactions in a version vector; `None` if some of these hashes are not known.
    pub fn seen(&self, vector: &VersionVector) -> Option<ChainHash> {
        let mut hasher = blake3::Hasher::new();
        for (origin, seq) in vector.iter() {
            hasher.update(&self.hash(Dot { origin, seq })?.0);
        }
        Some(ChainHash::of(&hasher))
    }

    /// Adds a transaction whose verdict is [`Verdict::Next`]; returns its position in the order of application.
    pub fn append(&mut self, txn: &Txn, encoded: EncodedTxn) -> u64 {
        let (dot, context) = (txn.dot(), self.context(txn));
        let head = Head { seq: dot.seq, hash: encoded.hash(), stamp: txn.stamp, context };
        self.heads.insert(dot.origin, head);
        let index = self.next;
        self.restore(dot, Logged { index, encoded });
        index
    }

    /// Restores a stored transaction; its head must be known.
    pub fn restore(&mut self, dot: Dot, logged: Logged) {
        self.vector.include(dot);
        self.next = self.next.max(logged.index.saturating_add(1));
        self.size += logged.encoded.size();
        self.txns.insert(dot, logged);
    }

    /// Returns the transactions beyond `vector` in the order of application, and whether there are more. These are at least one and
    /// about `size_max` bytes. `None` if some of the needed ones were dropped.
    pub fn beyond(&self, vector: &VersionVector, size_max: usize) -> Option<(Vec<EncodedTxn>, bool)> {
        if !vector.dominates(&self.low()) {
            return None;
        }
        let (mut txns, mut size) = (Vec::new(), 0);
        for (_, encoded) in self.after(vector) {
            size += encoded.size();
            if size > size_max && !txns.is_empty() {
                return Some((txns, true));
            }
            txns.push(encoded.clone());
        }
        Some((txns, false))
    }

    /// Returns the transactions in the order of application.
    pub fn in_order(&self) -> Vec<(Dot, &EncodedTxn)> {
        self.after(&self.low()).collect()
    }

    /// Drops the oldest transactions within `stable` until at most `size_max` bytes are left. Returns their dots.
    pub(crate) fn truncate(&mut self, stable: &VersionVector, size_max: usize) -> Vec<Dot> {
        let (mut dropped, mut size) = (Vec::new(), self.size);
        for (dot, encoded) in self.after(&self.low()) {
            // A transaction that was applied later may be stable earlier, but chains are only cut from the beginning.
            if size <= size_max || !stable.contains(dot) {
                break;
            }
            size -= encoded.size();
            dropped.push(dot);
        }
        self.size = size;
        dropped.iter().for_each(|dot| drop(self.txns.remove(dot)));
        dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Wall;

    fn txn(origin: u64, seq: u64, log: &Log, context: &[(u64, u64)]) -> (Txn, EncodedTxn) {
        let me = ReplicaId::new(origin);
        let prev = log.head(me).map(|head| head.hash).unwrap_or_default();
        let context = context.iter().map(|(origin, seq)| (ReplicaId::new(*origin), *seq)).collect();
        let stamp = Timestamp { epoch: 0, hlc: seq * 10, origin: me };
        let (wall, reason) = (Wall::default(), String::new());
        let txn = Txn {
            stamp,
            seq,
            prev,
            wall,
            context,
            reason,
            requires: vec![],
            writes: vec![],
            wants_ack: false,
            rebase: None,
        };
        let encoded = EncodedTxn::seal(&txn).unwrap();
        (txn, encoded)
    }

    fn take(log: &mut Log, origin: u64, seq: u64) {
        let (txn, encoded) = txn(origin, seq, log, &[]);
        assert_eq!(log.judge(&txn, &encoded), Verdict::Next);
        log.append(&txn, encoded);
    }

    #[test]
    fn what_is_taken() {
        let mut log = Log::default();
        take(&mut log, 1, 1);
        let (next, encoded) = txn(1, 2, &log, &[(2, 1)]);
        assert_eq!(log.judge(&next, &encoded), Verdict::Early, "what it saw is missing");
        let (early, early_encoded) = txn(1, 3, &log, &[]);
        assert_eq!(log.judge(&early, &early_encoded), Verdict::Early, "one before it is missing");
        take(&mut log, 2, 1);
        assert_eq!(log.judge(&next, &encoded), Verdict::Next);
        log.append(&next, encoded.clone());
        assert_eq!(log.judge(&next, &encoded), Verdict::Known);
        let mut other = next.clone();
        other.reason = "another life".into();
        let other_frame = EncodedTxn::seal(&other).unwrap();
        assert_eq!(log.judge(&other, &other_frame), Verdict::Fork, "a number was used twice");
        let (mut third, _) = txn(1, 3, &log, &[]);
        third.prev = other_frame.hash();
        assert_eq!(log.judge(&third, &EncodedTxn::seal(&third).unwrap()), Verdict::Fork, "the other branch goes on");
        assert_eq!(
            log.head(ReplicaId::new(1)).unwrap().context.to_string(),
            format!("{}:1 {}:1", ReplicaId::new(1), ReplicaId::new(2))
        );
    }

    #[test]
    fn what_is_served() {
        let mut log = Log::default();
        for (origin, seq) in [(1, 1), (2, 1), (1, 2), (2, 2)] {
            take(&mut log, origin, seq);
        }
        let served = |log: &Log, vector: &[(u64, u64)], size| {
            let vector = vector.iter().map(|(origin, seq)| (ReplicaId::new(*origin), *seq)).collect();
            let (txns, more) = log.beyond(&vector, size)?;
            let name = |encoded: &EncodedTxn| encoded.open().map(|txn| (txn.stamp.origin.number(), txn.seq)).unwrap();
            Some((txns.iter().map(name).collect::<Vec<_>>(), more))
        };
        assert_eq!(served(&log, &[], 1 << 20), Some((vec![(1, 1), (2, 1), (1, 2), (2, 2)], false)));
        assert_eq!(served(&log, &[(1, 1)], 1), Some((vec![(2, 1)], true)));
        assert_eq!(served(&log, &[(1, 9), (2, 9)], 1), Some((vec![], false)));
        let stable: VersionVector = [(ReplicaId::new(1), 2)].into_iter().collect();
        assert_eq!(
            log.truncate(&stable, 0),
            [Dot { origin: ReplicaId::new(1), seq: 1 }],
            "up to the first that is not stable"
        );
        assert_eq!(served(&log, &[], 1), None);
        assert_eq!(served(&log, &[(1, 1)], 1 << 20), Some((vec![(2, 1), (1, 2), (2, 2)], false)));
        assert_eq!(log.low().to_string(), format!("{}:1", ReplicaId::new(1)));
    }
}
