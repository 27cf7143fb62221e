//! The contents of a replica: its transactions, and the state, the members and the owners that result from them.
//!
//! *Rule.* All four change together, when a transaction is added or the state of another replica is taken over. The
//! changes go to the disk in the same batch.

use crate::logic::key::Key;
use crate::logic::log::Log;
use crate::logic::member::Members;
use crate::logic::message::{Chunk, Message};
use crate::logic::owner::Owners;
use crate::logic::record::{Batch, SHARED};
use crate::logic::state::{CausalContext, State};
use crate::logic::txn::{ChainHash, EncodedTxn, Txn};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};

/// How many hashes are sent at a time.
const KNOWN_MAX: usize = 1024;
/// How often the name of a transaction may have changed.
const LIVES_MAX: u32 = 32;

/// Log and state, with the records in the state that the replica itself uses.
#[derive(Debug)]
pub(super) struct Contents {
    log: Log,
    state: State,
    members: Members,
    owners: Owners,
}

impl Contents {
    pub(super) fn new(log: Log, state: State) -> Self {
        Self { log, members: Members::of(&state), owners: Owners::of(&state), state }
    }

    pub(super) fn log(&self) -> &Log {
        &self.log
    }

    pub(super) fn state(&self) -> &State {
        &self.state
    }

    pub(super) fn members(&self) -> &Members {
        &self.members
    }

    pub(super) fn owners(&self) -> &Owners {
        &self.owners
    }

    /// Adds the next transaction of an origin.
    pub(super) fn enter(&mut self, txn: &Txn, encoded: &EncodedTxn, batch: &mut Batch) {
        let (dot, context) = (txn.dot(), self.log.context(txn));
        let only = txn.rebase.as_ref().map(|rebase| rebase.takes.as_slice());
        // Rebased transactions are concurrent with each other.
        let seen = if only.is_some() { context.without(dot.origin) } else { context };
        self.state.apply(dot, txn.written(), CausalContext { context: &seen, only }, &txn.writes);
        let index = self.log.append(txn, encoded.clone());
        batch.txn(dot, Some((index, encoded)));
        batch.head(dot.origin, self.log.head(dot.origin));
        for write in &txn.writes {
            batch.versions(SHARED, &write.key, self.state.versions(&write.key));
        }
        if txn.writes.iter().any(|write| is_system(&write.key)) {
            (self.members, self.owners) = (Members::of(&self.state), Owners::of(&self.state));
        }
    }

    /// Takes over the state of another replica; returns the previous contents.
    pub(super) fn replace(&mut self, log: Log, state: State, batch: &mut Batch) -> Self {
        self.erase(batch);
        let old = std::mem::replace(self, Self::new(log, state));
        for (origin, head) in self.log.heads() {
            batch.head(*origin, Some(head));
        }
        for (key, versions) in self.state.scan("") {
            batch.versions(SHARED, key, versions);
        }
        old
    }

    fn erase(&self, batch: &mut Batch) {
        for (dot, _) in self.log.in_order() {
            batch.txn(dot, None);
        }
        for origin in self.log.heads().keys() {
            batch.head(*origin, None);
        }
        for (key, _) in self.state.scan("") {
            batch.versions(SHARED, key, &[]);
        }
    }

    /// Drops the keys that have only deletions within `stable`.
    pub(super) fn drop_deleted(&mut self, stable: &VersionVector, batch: &mut Batch) {
        for key in self.state.drop_deleted(stable) {
            batch.versions(SHARED, &key, &[]);
        }
    }

    /// Drops the oldest transactions within `stable`, until no more than `size_max` bytes are left.
    pub(super) fn truncate(&mut self, stable: &VersionVector, size_max: usize, batch: &mut Batch) {
        for dot in self.log.truncate(stable, size_max) {
            batch.txn(dot, None);
        }
    }

    /// Returns the present name of a transaction: see [`Replica::name_of`](super::Replica::name_of).
    pub(super) fn name_of(&self, mut dot: Dot) -> Dot {
        for _ in 0..LIVES_MAX {
            let rebased = self.members.rebased(dot.origin).filter(|rebased| dot.seq <= rebased.last.seq);
            let Some(rebased) = rebased.filter(|_| !self.log.vector().contains(dot)) else { break };
            dot = rebased.by;
        }
        dot
    }

    /// Returns the message that tells a peer the last transaction that this replica has of an origin.
    pub(super) fn tip_of(&self, origin: ReplicaId) -> Message {
        let (seq, hash) = self.log.tip(origin);
        Message::Chunk(Chunk::Fork { seq, hash })
    }

    /// Returns the message that tells a peer the hashes that these transactions have here, because
    /// the peer knows different hashes.
    pub(super) fn links_of(&self, of: impl IntoIterator<Item = (ReplicaId, u64)>) -> Message {
        let known = of.into_iter().filter_map(|(origin, seq)| {
            let dot = Dot { origin, seq };
            Some((dot, self.log.hash(dot)?))
        });
        Message::Chunk(Chunk::Known(known.take(KNOWN_MAX).collect()))
    }

    /// Returns the first of these transactions whose hash differs here.
    pub(super) fn other_than(&self, known: &[(Dot, ChainHash)]) -> Option<(Dot, ChainHash)> {
        let other = |(dot, hash): &&(Dot, ChainHash)| self.log.hash(*dot).is_some_and(|here| here != *hash);
        known.iter().find(other).copied()
    }
}

fn is_system(key: &Key) -> bool {
    key.as_str().starts_with("sys/")
}
