//! Merges two states when a replica comes back under a new id.
//!
//! The replica has an *old* side (its earlier state) and takes over a *new* side (its sponsor's state). Its log may be cut, so
//! some of its transactions may exist only as versions. The changes to be rebased follow from the two states and from the
//! transactions that each side has seen. This is the merge of optimised or-sets (Bieniusa et al., 2012):
//!
//! > result = (in both) + (in the old one, not seen by the new one) + (in the new one, not seen by the old one)
//!
//! *A write has the same name in all its lives: its timestamp.* A rebased transaction gets a new dot, since numbers have no gaps,
//! but its writes keep their timestamps. The timestamps of one origin grow with its numbers. So a side has seen a write in one of
//! these cases. It has the write's dot. Or it has a transaction of the timestamp's origin with that timestamp or a later one
//! (unless the log shows that the one with this timestamp is missing because the origin was set back, see [`Log::may_have`]). Or a
//! replica has rebased that origin's transactions up to that timestamp (`sys/brought/`, see [`crate::logic::member`]). Because of
//! the last case, several replicas of one retired side can return one after the other: the next one already has the transactions
//! that the first has rebased.
//!
//! *The rebased changes.* There is one [`Piece`] for each old transaction, with its remaining part, so its writes stay together.
//! (For transactions without a remaining part, the log may have the writer, the time and the reason.) A piece *takes* versions
//! away by name, not by a version vector: pieces of one chain may be concurrent, and a version vector cannot express "the third,
//! but not the second". A piece takes a version of the new side that the old side has seen and no longer holds. Versions of
//! *active* origins are left to these origins, which rebase them themselves.
//!
//! *Nothing is hidden, nothing comes back.* Let `d` be a version in the new state at a key, which the old side has seen but does
//! not hold. Then a write took `d` away there. Consider the chain of writes in which each write
//! removed the previous write. The chain ends at a version `q` that the old side holds, or at a
//! deletion that the old side has dropped.
//! - `q` is not in the new side: it would have taken `d` away there. So `q` is rebased. It has seen `d`, hence nothing that is
//!   left at a key of `q` is from `d`'s transaction, and its timestamp is larger. A piece takes `d` exactly under these two
//!   conditions. So the piece of `q` takes it; if another piece takes it as well, `d` had to go anyway. No timestamp has to be
//!   raised, so each key shows the same winner as with complete logs.
//! - A deletion is dropped only from a key that has nothing else, and every later writer of the key has seen it (T5). So the key
//!   is not in the old state. A deletion is committed for it, with a timestamp just above the versions that it takes.
//!
//! A version that remains on either side was either seen by the other side, which also holds it, or was not seen by the other
//! side. So no piece takes it. Deletions differ, because some replicas have already dropped them. This makes no difference: a
//! piece takes every deletion in its context at its keys (see [`state`](crate::logic::state)).
//!
//! *Numbers used twice.* The transactions of an origin in `forked` are common to both sides only up
//! to a number. All later versions are unknown to the other side, whatever their names. The result
//! may have too many versions then, never too few.

use crate::logic::clock::Timestamp;
use crate::logic::key::Key;
use crate::logic::log::Log;
use crate::logic::member::{self, Members};
use crate::logic::state::{State, Version};
use crate::logic::txn::Write;
use crate::logic::version_vector::{Dot, ReplicaId};
use std::collections::{BTreeMap, BTreeSet};

/// One side of a merge.
#[derive(Clone, Copy, Debug)]
pub struct Side<'a> {
    /// The versions that remain.
    pub state: &'a State,
    /// The transactions seen.
    pub log: &'a Log,
    /// The members in that state.
    pub members: &'a Members,
}

/// Origins that have used a number twice, each with the last number before that.
pub type Forked = BTreeMap<ReplicaId, u64>;

/// The remaining part of a transaction: its writes that were not overwritten, each with the versions that it takes away.
pub type Piece = Vec<(Write, BTreeSet<Dot>)>;

/// The origin of a piece: its timestamp, and its former dot; none for a deletion that was dropped.
pub type Source = (Timestamp, Option<Dot>);

impl Side<'_> {
    /// Returns whether this side has seen the transaction that wrote with this timestamp.
    pub fn has(&self, dot: Dot, stamp: Timestamp, forked: &Forked) -> bool {
        if let Some(common) = forked.get(&dot.origin) {
            return dot.seq <= self.log.vector().get(dot.origin).min(*common);
        }
        let rebased = || self.members.rebased(stamp.origin).is_some_and(|rebased| stamp <= rebased.stamp);
        let elsewhere = || dot.origin != stamp.origin && self.log.may_have(stamp) || rebased();
        self.log.vector().contains(dot) || !forked.contains_key(&stamp.origin) && elsewhere()
    }
}

/// Returns whether `new` has not seen a transaction, and no member will rebase it because its origin is active in neither team.
fn lacks(old: Side<'_>, new: Side<'_>, dot: Dot, stamp: Timestamp, forked: &Forked) -> bool {
    is_given_up(old, new, dot.origin) && !new.has(dot, stamp, forked)
}

/// Returns whether an origin was retired on the old side. It may have been given up there, which the new side cannot know.
fn is_given_up(old: Side<'_>, new: Side<'_>, origin: ReplicaId) -> bool {
    !new.members.is_active(origin) || old.members.retired(origin).is_some()
}

/// Returns the last transaction of each non-member origin that comes with the old side, with its timestamp.
pub fn arrival(old: Side<'_>, new: Side<'_>, forked: &Forked) -> Vec<(Dot, Timestamp)> {
    let heads = old.log.heads().iter().map(|(origin, head)| (Dot { origin: *origin, seq: head.seq }, head.stamp));
    let heads = heads.filter(|(dot, stamp)| !forked.contains_key(&dot.origin) && lacks(old, new, *dot, *stamp, forked));
    let rebased = old.members.all_rebased().filter(|rebased| is_given_up(old, new, rebased.by.origin));
    heads.chain(rebased.map(|rebased| (rebased.last, rebased.stamp))).collect()
}

/// Returns the pieces to rebase onto `new`, as `origin`. Then `new` has all of `old`, except the transactions that active origins
/// rebase themselves.
pub fn rebase(old: Side<'_>, new: Side<'_>, forked: &Forked, origin: ReplicaId) -> BTreeMap<Source, Piece> {
    let mut pieces: BTreeMap<Source, Piece> = BTreeMap::new();
    for (dot, encoded) in old.log.in_order() {
        let stamp = encoded.open().map(|txn| txn.written()).unwrap_or_default();
        if lacks(old, new, dot, stamp, forked) {
            pieces.entry((stamp, Some(dot))).or_default();
        }
    }
    let mut left: BTreeMap<Source, BTreeSet<Dot>> = BTreeMap::new();
    let keys: BTreeSet<&Key> = old.state.scan("").chain(new.state.scan("")).map(|(key, _)| key).collect();
    for key in keys.into_iter().filter(|key| !member::is_record(key)) {
        let (pending, there) = (old.state.versions(key), new.state.versions(key));
        let gone =
            |v: &&Version| old.has(v.dot, v.stamp, forked) && !pending.iter().any(|other| other.stamp == v.stamp);
        let (gone, stays): (Vec<&Version>, Vec<&Version>) = there.iter().partition(gone);
        for version in pending.iter().filter(|version| lacks(old, new, version.dot, version.stamp, forked)) {
            let source = (version.stamp, Some(version.dot));
            let takes = gone.iter().filter(|d| d.stamp < version.stamp).map(|d| d.dot).collect();
            let write = Write { key: key.clone(), value: version.value.clone() };
            pieces.entry(source).or_default().push((write, takes));
            left.entry(source).or_default().extend(stays.iter().map(|version| version.dot));
        }
        let deleted = pending.is_empty() && gone.iter().any(|d| d.value.is_some());
        if let Some(last) = gone.iter().max_by_key(|d| d.stamp).filter(|_| deleted) {
            let takes = gone.iter().map(|d| d.dot).collect();
            let source = (Timestamp { origin, ..last.stamp.next() }, None);
            pieces.entry(source).or_default().push((Write { key: key.clone(), value: None }, takes));
        }
    }
    for (source, piece) in &mut pieces {
        let left = left.remove(source).unwrap_or_default();
        piece.iter_mut().for_each(|(_, takes)| takes.retain(|dot| !left.contains(dot)));
    }
    pieces
}

#[cfg(test)]
mod tests;
