//! Commits the transactions of a rejoining replica again, under its new origin.
//!
//! *Rule.* A transaction is rebased if the old state and log have it, the new state and log lack it, and no member rebases
//! it. These are the replica's own transactions, and the transactions of origins that are not members. [`merge`] finds them, and
//! explains why nothing is lost or hidden. This module turns them into changes, which the replica commits under the admitted
//! origin.
//!
//! The last of these transactions record up to which number the old origins were rebased. So a replica that returns later with
//! the same transactions does not rebase them again. And an old name leads to a new one
//! ([`Replica::name_of`](super::Replica::name_of)): the name of the transaction with which the last remaining part has arrived.
//! Two replicas may return at the same time, with sponsors that have no contact with each other. Then both rebase the transaction; the
//! copies have the same timestamp, and count as one among conflicts.
//!
//! *Deletions.* Some replicas may have dropped deletions that the returning replica had not seen, because it no longer counted.
//! Each deletion that was dropped anywhere before the admission was known was dropped with the sponsor's consent. So it is within
//! the sponsor's version vector. That vector is in the context of all rebased transactions, so they take these deletions away.
//!
//! *Not rebased:* the records of the old team (`sys/members` and the like), because its retirements do not matter here. Also
//! values that were overwritten before any replica here saw them: their transactions are rebased without writes, if the log has
//! their author, time and reason.

use super::commit::Change;
use super::contents::Contents;
use super::identity::Identity;
use crate::logic::log::{Head, Log};
use crate::logic::member;
use crate::logic::merge::{self, Forked, Side};
use crate::logic::record::Past;
use crate::logic::txn::{Rebase, Require, Write};
use crate::logic::version_vector::{Dot, ReplicaId};
use std::collections::BTreeSet;

/// The transactions that are rebased.
#[derive(Debug)]
pub(super) struct Arrivals {
    /// The remaining part of each transaction, with its former dot; none for a deletion that was dropped.
    pub(super) rests: Vec<(Option<Dot>, Rest)>,
    /// The writes that record up to which number the old origins were rebased.
    pub(super) records: Vec<Write>,
}

/// The part of a rebased transaction that is not committed yet.
#[derive(Debug)]
pub(super) struct Rest {
    rebase: Rebase,
    reason: String,
    requires: Vec<Require>,
    writes: Vec<(Write, BTreeSet<Dot>)>,
}

/// Returns the part of `old` that has to be committed on `new` as `joining`, which is not admitted yet. `None` if `new` already
/// has everything.
pub(super) fn arrivals(old: &Contents, new: &Contents, joining: ReplicaId, me: &Identity) -> Option<Arrivals> {
    let forked = forked(old.log(), new.log(), me);
    let (old_side, new_side) = (side(old), side(new));
    let pieces = merge::rebase(old_side, new_side, &forked, joining);
    let arrival = merge::arrival(old_side, new_side, &forked);
    if arrival.is_empty() && pieces.is_empty() {
        return None;
    }
    let rest = |((stamp, from), writes): (merge::Source, merge::Piece)| {
        let known = from.and_then(|dot| old.log().encoded(dot)?.open().ok());
        let (reason, requires) = known.map(|txn| (txn.reason, txn.requires)).unwrap_or_default();
        let rebase = Rebase { from, stamp, takes: Vec::new() };
        (from, Rest { rebase, reason, requires, writes })
    };
    let records = member::arrival(joining, &arrival);
    Some(Arrivals { rests: pieces.into_iter().map(rest).collect(), records })
}

fn side(contents: &Contents) -> Side<'_> {
    Side { state: contents.state(), log: contents.log(), members: contents.members() }
}

/// Returns the origins that have used numbers twice according to the logs, and the own origins that were given up for this reason.
/// Each has the number up to which both logs have the same transactions.
fn forked(old: &Log, new: &Log, me: &Identity) -> Forked {
    let other = |(origin, head): (&ReplicaId, &Head)| {
        let hash = old.hash(Dot { origin: *origin, seq: head.seq })?;
        (hash != head.hash).then_some((*origin, 0))
    };
    let mut forked: Forked = new.heads().iter().filter_map(other).collect();
    let past = me.past().iter().filter(|past| past.known_by_peers < u64::MAX);
    for Past { origin, known_by_peers, twice, .. } in past {
        // If a replica knows fewer of its own transactions than other replicas know, its store was set back.
        let behind = old.vector().get(*origin) < new.vector().get(*origin);
        if *twice || behind || forked.contains_key(origin) {
            forked.insert(*origin, *known_by_peers);
        }
    }
    forked
}

impl Rest {
    /// Returns the change to commit.
    pub(super) fn change(&self) -> Change {
        let takes: BTreeSet<Dot> = self.writes.iter().flat_map(|(_, takes)| takes).copied().collect();
        Change {
            reason: self.reason.clone(),
            requires: self.requires.clone(),
            writes: self.writes.iter().map(|(write, _)| write.clone()).collect(),
            wants_ack: false,
            rebase: Some(Rebase { takes: takes.into_iter().collect(), ..self.rebase.clone() }),
        }
    }

    /// Splits the rest into shorter transactions, in reverse order. A single write may take away more versions than a transaction
    /// can name. Some of these versions then remain as conflicts.
    pub(super) fn shorter(mut self) -> Vec<Self> {
        if self.writes.len() > 1 {
            let writes = self.writes.split_off(self.writes.len() / 2);
            let rest = Self { rebase: self.rebase.clone(), reason: self.reason.clone(), requires: Vec::new(), writes };
            return vec![rest, self];
        }
        if self.requires.is_empty() {
            let takes = self.writes.first_mut().map(|(_, takes)| takes).filter(|takes| !takes.is_empty());
            let Some(takes) = takes else { return Vec::new() };
            *takes = takes.iter().copied().skip(takes.len().div_ceil(2)).collect();
        }
        self.requires.clear();
        vec![self]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Timestamp;
    use crate::logic::key::Key;
    use crate::logic::txn::Condition;

    #[test]
    fn what_does_not_fit_is_taken_apart_and_nothing_is_left_out() {
        let dot = |seq| Dot { origin: ReplicaId::new(1), seq };
        let key = |name: u64| Key::new(format!("k{name}")).unwrap();
        let write = |name| (Write { key: key(name), value: None }, BTreeSet::from([dot(name), dot(9)]));
        let rebase = Rebase { from: None, stamp: Timestamp::default(), takes: Vec::new() };
        let requires = vec![Require { key: key(0), condition: Condition::Absent }];
        let rest = Rest { rebase, reason: "r".into(), requires, writes: (1..=3).map(write).collect() };
        let (mut waiting, mut done) = (vec![rest], Vec::new());
        while let Some(rest) = waiting.pop() {
            let change = rest.change();
            if change.writes.len() > 1 || !change.requires.is_empty() {
                waiting.extend(rest.shorter());
            } else {
                let takes = change.rebase.map(|rebase| rebase.takes).unwrap_or_default();
                done.push((change.writes[0].key.clone(), takes));
            }
        }
        assert_eq!(done, [1, 2, 3].map(|name| (key(name), vec![dot(name), dot(9)])));
        let (single, none) = (Rest { writes: vec![write(1)], ..empty() }, empty());
        assert_eq!(single.shorter()[0].change().rebase.unwrap().takes, [dot(9)], "some stay, as conflicts");
        assert!(none.shorter().is_empty(), "in the end it gives up");
    }

    fn empty() -> Rest {
        let rebase = Rebase { from: None, stamp: Timestamp::default(), takes: Vec::new() };
        Rest { rebase, reason: String::new(), requires: Vec::new(), writes: Vec::new() }
    }
}
