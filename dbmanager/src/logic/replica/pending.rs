//! Buffers transactions that cannot be applied yet: transactions of a newer format, and all transactions that depend on these.
//!
//! *Rule.* Every format begins with the same [`Header`]. So even if this program cannot read a transaction, it keeps the transaction and
//! passes it on. The conditions: it is the next transaction of its origin, and all transactions that it has seen are here, applied or
//! buffered. The same holds for its successors. None of these transactions is applied. The own version vector, by which other replicas
//! determine stability, does not include them. Transactions that are committed here have not seen them. A newer program finds them on the
//! disk and applies them in the order in which they came, which is causal.
//!
//! So a robot with an older program can carry updates from one newer robot to another, and never shows a part of them.
//!
//! *Retirement.* Retirements of a replica with buffered transactions are buffered as well. If a
//! member confirms a retirement, it is treated as if it had applied all transactions of the retired
//! replica that any member has.
//!
//! New formats are written only once [`Replica::team_format`](super::Replica::team_format) shows that every member reads them.
//! So a buffered transaction means that a member has joined since, or that an operator did not wait for all members.

use crate::logic::log::Log;
use crate::logic::record::Batch;
use crate::logic::txn::{ChainHash, EncodedTxn, Header};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use std::collections::BTreeMap;

/// How many bytes of transactions are buffered. Further transactions are pulled again later.
const PENDING_SIZE_MAX: usize = 16 << 20;

/// The buffered transactions, in the order in which they came.
#[derive(Debug, Default)]
pub(super) struct PendingTxns {
    txns: BTreeMap<u64, (Dot, EncodedTxn)>,
    heads: BTreeMap<ReplicaId, (u64, ChainHash)>,
    size: usize,
}

impl PendingTxns {
    pub(super) fn new(txns: impl IntoIterator<Item = (u64, (Dot, EncodedTxn))>) -> Self {
        let mut pending = Self::default();
        for (index, (dot, encoded)) in txns {
            pending.insert(index, dot, encoded);
        }
        pending
    }

    /// Returns the buffered transactions beyond `vector`, about `size_max` bytes of them, and whether there are more.
    pub(super) fn beyond(&self, vector: &VersionVector, size_max: usize) -> (Vec<EncodedTxn>, bool) {
        let (mut txns, mut size) = (Vec::new(), 0);
        for (_, encoded) in self.txns.values().filter(|(dot, _)| !vector.contains(*dot)) {
            size += encoded.size();
            if size > size_max && !txns.is_empty() {
                return (txns, true);
            }
            txns.push(encoded.clone());
        }
        (txns, false)
    }

    /// Returns whether a transaction of this origin is buffered.
    pub(super) fn has(&self, origin: ReplicaId) -> bool {
        self.heads.contains_key(&origin)
    }

    pub(super) fn vector(&self) -> VersionVector {
        self.heads.iter().map(|(origin, (seq, _))| (*origin, *seq)).collect()
    }

    /// Returns the version vector of all transactions, applied to `log` or buffered.
    pub(super) fn with(&self, log: &Log) -> VersionVector {
        let mut vector = log.vector().clone();
        vector.join(&self.vector());
        vector
    }

    /// Buffers a transaction that cannot be applied to `log`. Returns whether it is buffered now, possibly from before.
    pub(super) fn buffer(&mut self, encoded: &EncodedTxn, log: &Log, batch: &mut Batch) -> bool {
        let Ok((Header { stamp, seq, prev, context, .. }, _)) = encoded.split() else { return false };
        let (dot, have) = (Dot { origin: stamp.origin, seq }, self.with(log));
        if have.contains(dot) {
            return true;
        }
        let (last, hash) = self.heads.get(&dot.origin).copied().unwrap_or_else(|| log.tip(dot.origin));
        let fits = self.size + encoded.size() <= PENDING_SIZE_MAX;
        if seq != last + 1 || prev != hash || !have.dominates(&context) || !fits {
            return false;
        }
        let index = self.txns.last_key_value().map_or(0, |(index, _)| index + 1);
        self.insert(index, dot, encoded.clone());
        batch.pending(index, Some((dot, encoded)));
        true
    }

    /// Takes out all buffered transactions, to try them. The transactions are treated as buffered until
    /// [`PendingTxns::keep`] gets the rest.
    pub(super) fn take(&mut self) -> BTreeMap<u64, (Dot, EncodedTxn)> {
        std::mem::take(&mut self.txns)
    }

    /// Keeps the transactions that still cannot be applied.
    pub(super) fn keep(&mut self, left: BTreeMap<u64, (Dot, EncodedTxn)>) {
        *self = Self::new(left);
    }

    fn insert(&mut self, index: u64, dot: Dot, encoded: EncodedTxn) {
        self.size += encoded.size();
        self.heads.insert(dot.origin, (dot.seq, encoded.hash()));
        self.txns.insert(index, (dot, encoded));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::{Timestamp, Wall};

    const A: ReplicaId = ReplicaId::new(1);

    /// Returns a transaction in a format that no program here can read.
    fn newer(seq: u64, prev: ChainHash, context: &[(u64, u64)]) -> EncodedTxn {
        let context = context.iter().map(|(origin, seq)| (ReplicaId::new(*origin), *seq)).collect();
        let stamp = Timestamp { epoch: 0, hlc: seq, origin: A };
        EncodedTxn::join(9, &Header { stamp, seq, prev, wall: Wall::default(), context }, &[7; 20])
    }

    #[test]
    fn what_follows_is_buffered_and_what_lacks_a_cause_is_not() {
        let (mut pending, log, mut batch) = (PendingTxns::default(), Log::default(), Batch::default());
        let first = newer(1, ChainHash::default(), &[]);
        let second = newer(2, first.hash(), &[]);
        assert!(!pending.buffer(&second, &log, &mut batch), "the one before it is missing");
        assert!(!pending.buffer(&newer(1, ChainHash::default(), &[(2, 1)]), &log, &mut batch), "a cause is missing");
        assert!(batch.is_empty());
        assert!(pending.buffer(&first, &log, &mut batch) && pending.buffer(&second, &log, &mut batch));
        assert!(pending.buffer(&first, &log, &mut batch), "it is buffered already");
        assert!(!pending.buffer(&newer(3, first.hash(), &[]), &log, &mut batch), "it follows another one");
        assert_eq!((batch.0.len(), pending.with(&log).get(A), pending.has(A)), (2, 2, true));
        assert_eq!(pending.beyond(&VersionVector::default(), 1), (vec![first.clone()], true));
        let left = pending.take().into_iter().take(1).collect();
        assert!(pending.has(A), "until it is known what is left");
        pending.keep(left);
        assert_eq!((pending.vector().get(A), pending.beyond(&VersionVector::default(), 1 << 20).0), (1, vec![first]));
    }

    #[test]
    fn no_more_is_buffered_than_fits() {
        let (mut pending, log, mut batch) = (PendingTxns::default(), Log::default(), Batch::default());
        let first = newer(1, ChainHash::default(), &[]);
        pending.size = PENDING_SIZE_MAX - first.size() + 1;
        assert!(!pending.buffer(&first, &log, &mut batch));
        pending.size -= 1;
        assert!(pending.buffer(&first, &log, &mut batch));
    }
}
