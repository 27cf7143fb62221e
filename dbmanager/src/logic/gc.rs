//! Garbage collection: removes data that every member has. Only membership decides, never age.
//!
//! *State.* For each member, the last durable version vector that it has reported and that the replica's own version vector dominates.
//!
//! *Rule.* The *stable version vector* is the minimum of these vectors over all members, the replica's own one included, and over
//! retired origins before their barrier. A key that has only deletions is dropped when these are stable. Transactions are dropped when
//! they are stable and the log is longer than its limit.
//!
//! *T5, nothing comes back.* Let a deletion `T` be stable here. Consider a transaction that has not seen `T`. A member committed it
//! before it had `T`, so the transaction is within the version vector by which that member reported `T`. That version vector is used only
//! because the replica's own version vector dominates it. So the transaction is already applied here, and `T` was compared with it. Every
//! later transaction has `T` in its context. So dropping `T` changes nothing for later transactions. Newcomers begin with a state that has
//! `T` (see [`member`](crate::logic::member)). A transaction that is rebased under a new origin removes every deletion in its context: if a
//! deletion was dropped before the newcomer was known, the sponsor had agreed. So the deletion is in the state with which the newcomer
//! begins.
//!
//! Counting the *reported* vectors alone is not enough. A member may report that it has `T` while one of its concurrent writes is still
//! in transit. Then one replica drops `T` and shows the write, and another replica orders the two. An absent member keeps the stable
//! version vector from growing; that costs some bytes, and [`Stable::pinned_by`] names the member.

use crate::logic::member::Members;
use crate::logic::version_vector::{ReplicaId, VersionVector};
use std::collections::BTreeMap;

/// The stable version vector, and the members that keep it from growing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stable {
    /// The version vector that every member has. All later writes include it.
    pub vector: VersionVector,
    /// The members whose version vector is missing, or less than the replica's own.
    pub pinned_by: Vec<ReplicaId>,
}

/// The version vectors that other members have acknowledged.
#[derive(Clone, Debug, Default)]
pub struct Acks {
    acked: BTreeMap<ReplicaId, VersionVector>,
    counted: BTreeMap<ReplicaId, VersionVector>,
    /// Up to where deletions were dropped.
    dropped: VersionVector,
}

impl Acks {
    /// Notes the durable version vector that `origin` reports.
    pub fn note(&mut self, origin: ReplicaId, vector: &VersionVector) {
        self.acked.entry(origin).or_default().join(vector);
    }

    /// Counts the reported version vectors that the own version vector now dominates.
    pub fn settle(&mut self, own: &VersionVector) {
        for (origin, vector) in &self.acked {
            if own.dominates(vector) {
                self.counted.insert(*origin, vector.clone());
            }
        }
    }

    /// Notes the stable version vector. Returns whether it has changed, so that deletions can be dropped.
    pub fn drops(&mut self, stable: &VersionVector) -> bool {
        let changed = self.dropped != *stable;
        if changed {
            self.dropped = stable.clone();
        }
        changed
    }

    /// Notes that the state was replaced, so nothing was dropped from it.
    pub fn begin_anew(&mut self) {
        self.dropped = VersionVector::default();
    }

    /// Returns the version vector that `origin` has reported.
    pub fn acked(&self, origin: ReplicaId) -> Option<&VersionVector> {
        self.acked.get(&origin)
    }

    /// Returns the stable version vector as `me` knows it; `own` is its own version vector.
    pub fn stable(&self, me: ReplicaId, own: &VersionVector, members: &Members) -> Stable {
        let has = |origin: ReplicaId| if origin == me { Some(own) } else { self.counted.get(&origin) };
        let active = members.active().map(|(origin, _)| origin);
        let retired = members.before_barrier(has);
        let mut stable = Stable { vector: own.clone(), pinned_by: Vec::new() };
        for origin in active.chain(retired) {
            let vector = has(origin).cloned().unwrap_or_default();
            if !vector.dominates(own) {
                stable.pinned_by.push(origin);
            }
            stable.vector.meet(&vector);
        }
        stable
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Timestamp;
    use crate::logic::member;
    use crate::logic::state::{CausalContext, State};
    use crate::logic::version_vector::Dot;

    fn vector(entries: &[(u64, u64)]) -> VersionVector {
        entries.iter().map(|(origin, seq)| (ReplicaId::new(*origin), *seq)).collect()
    }

    /// Returns the team of these origins. If `retire`, origin 1 has retired the last of them by its transaction 9.
    fn team(origins: &[u64], retire: bool) -> Members {
        let mut state = State::default();
        let me = ReplicaId::new(1);
        let mut apply = |seq, write| {
            let context = VersionVector::default();
            let stamp = Timestamp { epoch: 0, hlc: seq, origin: me };
            state.apply(Dot { origin: me, seq }, stamp, CausalContext { context: &context, only: None }, &[write]);
        };
        for origin in origins {
            apply(*origin, member::admission(ReplicaId::new(*origin), "r").unwrap());
        }
        if retire {
            apply(9, member::retirement(ReplicaId::new(origins[origins.len() - 1])).unwrap());
        }
        Members::of(&state)
    }

    #[test]
    fn delete_vs_concurrent_put_gc_race() {
        let members = team(&[1, 2], false);
        let (me, own) = (ReplicaId::new(1), vector(&[(1, 5)]));
        let mut acks = Acks::default();
        acks.note(ReplicaId::new(2), &vector(&[(1, 5), (2, 1)]));
        acks.settle(&own);
        let stable = acks.stable(me, &own, &members);
        assert_eq!(
            (stable.vector, stable.pinned_by),
            (VersionVector::default(), vec![ReplicaId::new(2)]),
            "2:1 may be a concurrent put"
        );
        let own = vector(&[(1, 5), (2, 1)]);
        acks.settle(&own);
        assert_eq!(acks.stable(me, &own, &members), Stable { vector: own, pinned_by: vec![] });
    }

    #[test]
    fn a_retired_origin_counts_until_everybody_knows() {
        let members = team(&[1, 2, 3], true);
        let (me, own) = (ReplicaId::new(1), vector(&[(1, 9)]));
        let mut acks = Acks::default();
        acks.note(ReplicaId::new(2), &vector(&[(1, 8)]));
        acks.settle(&own);
        assert_eq!(acks.stable(me, &own, &members).vector, VersionVector::default());
        acks.note(ReplicaId::new(2), &vector(&[(1, 9)]));
        acks.settle(&own);
        assert_eq!(acks.stable(me, &own, &members).vector, own);
    }

    #[test]
    fn last_member_standing() {
        let own = vector(&[(1, 9)]);
        assert_eq!(Acks::default().stable(ReplicaId::new(1), &own, &team(&[1, 2], true)).vector, own);
    }
}
