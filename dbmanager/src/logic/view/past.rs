//! The history of a key, and the audit of all keys.
//!
//! Both are read from the log, so they reach back to its beginning. Of two kept transactions, the transaction that was
//! applied first cannot have seen the other. The later one's context shows whether it has seen the earlier one.
//! Transactions carry their contexts as differences, so the sum lacks the parts of transactions that were dropped. Such a
//! part never contains a kept transaction. The reason: transactions are dropped in the order of application, and the
//! transactions that a dropped one had seen were applied before it.
//!
//! A transaction that was rebased from another life of its replica has lost its context. For such a transaction, only the
//! versions that it took away or required are known. Other transactions that it had seen may be shown as concurrent.

use super::value::Datum;
use crate::logic::clock::{Quality, Timestamp, Wall};
use crate::logic::key::Key;
use crate::logic::log::{Head, Log};
use crate::logic::member::Members;
use crate::logic::state::State;
use crate::logic::txn::{Condition, Require, Txn, Write};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::ops::Range;

/// The most transactions that are listed as concurrent with one transaction.
const CONCURRENT_MAX: usize = 16;

/// The plausible dates of a clock that is not synchronised, in milliseconds since 1970: from 2024, because this program's
/// data cannot be older, to 2100.
const PLAUSIBLE: Range<u64> = 1_704_067_200_000..4_102_444_800_000;

/// The time of a transaction, with a note whether its clock can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct When {
    /// Milliseconds since 1970; in JSON `at`, in seconds.
    #[serde(rename = "at", with = "comms::logic::human::millis")]
    pub millis: u64,
    /// Whether the clock was synchronised. If not, the time is the clock's reading if that is plausible, or else the latest
    /// date that the robot had seen.
    pub trusted: bool,
}

/// One transaction, in the form for people.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HistoryEntry {
    /// The name of the transaction.
    pub dot: Dot,
    /// The robot, or the origin if the robot is not known.
    pub by: String,
    /// The time of the commit, by the clock of its robot.
    pub when: When,
    /// The writer's reason.
    pub reason: String,
    /// The changes of the requested keys; a deletion has no value.
    pub changes: Vec<(Key, Option<Datum>)>,
    /// How many other keys the transaction changed.
    pub others: usize,
    /// Transactions that changed one of these keys, while neither had seen the other; only the first few.
    pub concurrent: Vec<Dot>,
    /// The name of the transaction before its robot had to begin under a new origin.
    pub before: Option<Dot>,
}

impl fmt::Display for Condition {
    /// Writes the condition as text.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("have no value"),
            Self::Exists => f.write_str("have a value"),
            Self::Is(dot) => write!(f, "be as {dot} has written it"),
        }
    }
}

/// Returns the writers of a key as text, for an error message about them.
pub(in crate::logic) fn written_by(dots: &[Dot]) -> String {
    let dots: Vec<String> = dots.iter().map(Dot::to_string).collect();
    if dots.is_empty() { "it has no value".to_owned() } else { format!("it is written by {}", dots.join(" and ")) }
}

/// The requested keys.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Keys {
    /// One key.
    Only(Key),
    /// All keys that begin with this prefix.
    Below(String),
}

/// The requested keys, writers and times.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Filter {
    /// The keys.
    pub keys: Keys,
    /// Only the transactions of this robot.
    pub by: Option<String>,
    /// Only changes at or after this time, in milliseconds since 1970. A change without a date is included if it may have
    /// been made then.
    pub from: Option<u64>,
    /// Only changes before this time, with the same rule.
    pub until: Option<u64>,
    /// Only the last changes, up to this number.
    pub limit: usize,
}

/// The log, and the state that results from it.
#[derive(Clone, Copy, Debug)]
pub struct Past<'a> {
    /// The transactions.
    pub log: &'a Log,
    /// The state after the transactions of the log.
    pub state: &'a State,
}

impl Keys {
    /// Returns whether a key is requested.
    pub fn contains(&self, key: &Key) -> bool {
        match self {
            Self::Only(only) => key == only,
            Self::Below(prefix) => key.as_str().starts_with(prefix),
        }
    }
}

impl Filter {
    /// Returns a filter for the last `limit` transactions that changed these keys.
    pub const fn new(keys: Keys, limit: usize) -> Self {
        Self { keys, by: None, from: None, until: None, limit }
    }

    fn admits(&self, entry: &HistoryEntry, txn: &Txn) -> bool {
        let dated = match txn.rebase {
            Some(_) => entry.when.is_known(),
            None => When::dated(txn.wall, txn.stamp).is_some(),
        };
        self.from.is_none_or(|from| entry.when.millis >= from || !dated)
            && self.until.is_none_or(|until| entry.when.millis < until)
            && self.by.as_ref().is_none_or(|robot| *robot == entry.by)
    }
}

impl When {
    /// Returns the time of a commit.
    pub fn of(wall: Wall, stamp: Timestamp) -> Self {
        let trusted = wall.quality >= Quality::Network;
        // A timestamp is above every date that its writer had seen. If no clock was synchronised, it may be the better
        // estimate.
        Self { millis: Self::dated(wall, stamp).unwrap_or(stamp.millis()), trusted }
    }

    /// Returns the time of the first commit of a transaction. If it was rebased, the wall clock shows the time of the rebase.
    /// It has the timestamp of its first life, which still orders its writes.
    pub fn of_txn(txn: &Txn) -> Self {
        match &txn.rebase {
            Some(rebase) => Self { millis: rebase.stamp.millis(), trusted: false },
            None => Self::of(txn.wall, txn.stamp),
        }
    }

    /// Returns the date of a transaction, in milliseconds since 1970; `None` if its clock showed no plausible date. Then only
    /// a lower bound is known: [`Timestamp::millis`].
    pub(super) fn dated(wall: Wall, stamp: Timestamp) -> Option<u64> {
        match wall.quality {
            Quality::Network | Quality::Satellite => Some(wall.millis),
            Quality::Unset | Quality::Battery if PLAUSIBLE.contains(&wall.millis) => {
                Some(wall.millis.max(stamp.millis()))
            }
            Quality::Unset | Quality::Battery => None,
        }
    }

    /// Returns whether there is any date. There is none if the clock showed none and the robot had seen none.
    pub fn is_known(self) -> bool {
        self.trusted || PLAUSIBLE.contains(&self.millis)
    }
}

impl Past<'_> {
    /// Returns the requested transactions, in the order in which they became visible here.
    pub fn history(&self, filter: &Filter) -> Vec<HistoryEntry> {
        let mut history: VecDeque<HistoryEntry> = VecDeque::new();
        let mut writers: BTreeMap<Key, BTreeMap<ReplicaId, Vec<Dot>>> = BTreeMap::new();
        let mut concurrent: BTreeMap<Dot, Vec<Dot>> = BTreeMap::new();
        self.walk(&BTreeMap::new(), |txn, seen| {
            let Some(entry) = self.entry(txn, &filter.keys) else { return };
            for (key, _) in &entry.changes {
                let earlier = writers.entry(key.clone()).or_default();
                // Of each origin, the unseen transactions are the end of its chain.
                let unseen = earlier.values().flat_map(|chain| {
                    chain.iter().rev().take_while(|other| !has_seen(txn, seen, **other)).take(CONCURRENT_MAX)
                });
                for (one, two) in unseen.flat_map(|other| [(entry.dot, *other), (*other, entry.dot)]) {
                    let names = concurrent.entry(one).or_default();
                    if names.len() < CONCURRENT_MAX && !names.contains(&two) {
                        names.push(two);
                    }
                }
                earlier.entry(entry.dot.origin).or_default().push(entry.dot);
            }
            if filter.admits(&entry, txn) {
                history.push_back(entry);
            }
            if history.len() > filter.limit {
                history.pop_front();
            }
        });
        let mark = |entry: HistoryEntry| HistoryEntry {
            concurrent: concurrent.remove(&entry.dot).unwrap_or_default(),
            ..entry
        };
        history.into_iter().map(mark).collect()
    }

    /// Returns a transaction in the form for people; none if it changed none of the keys.
    pub(super) fn entry(&self, txn: &Txn, keys: &Keys) -> Option<HistoryEntry> {
        let (changes, others): (Vec<_>, Vec<_>) = txn.writes.iter().partition(|write| keys.contains(&write.key));
        if changes.is_empty() {
            return None;
        }
        let change = |write: &Write| (write.key.clone(), write.value.as_ref().map(Datum::of));
        Some(HistoryEntry {
            dot: txn.dot(),
            by: self.robot(txn.written().origin),
            when: When::of_txn(txn),
            reason: txn.reason.clone(),
            changes: changes.into_iter().map(change).collect(),
            others: others.len(),
            concurrent: Vec::new(),
            before: txn.rebase.as_ref().and_then(|rebase| rebase.from),
        })
    }

    /// Returns the robot of an origin, including retired ones. If it is unknown, as for transactions written before joining,
    /// returns the robot that has rebased the transactions, or else the origin itself.
    pub fn robot(&self, origin: ReplicaId) -> String {
        let named = |origin| {
            let key = Key::new(format!("sys/members/{origin}")).ok()?;
            let Datum::Text(name) = Datum::of(self.state.versions(&key).last()?.value.as_ref()?) else { return None };
            Some(name)
        };
        let rebased = || named(Members::of(self.state).rebased(origin)?.by.origin);
        named(origin).or_else(rebased).unwrap_or_else(|| origin.to_string())
    }

    /// Visits each kept transaction in the order of application, with the version vector that it
    /// had seen. `heads` are the last transactions before the kept transactions.
    pub(super) fn walk(&self, heads: &BTreeMap<ReplicaId, Head>, mut visit: impl FnMut(&Txn, &VersionVector)) {
        let mut contexts: BTreeMap<ReplicaId, VersionVector> =
            heads.iter().map(|(origin, head)| (*origin, head.context.clone())).collect();
        for (_, encoded) in self.log.in_order() {
            // An unreadable transaction was not applied.
            let Ok(txn) = encoded.open() else { continue };
            let context = contexts.entry(txn.stamp.origin).or_default();
            context.go_on(txn.dot(), &txn.context);
            visit(&txn, context);
        }
    }
}

/// Returns whether a transaction, which has seen the vector `seen`, has seen another one.
pub(super) fn has_seen(txn: &Txn, seen: &VersionVector, other: Dot) -> bool {
    match &txn.rebase {
        Some(rebase) => {
            let required = |require: &Require| require.condition == Condition::Is(other);
            rebase.takes.contains(&other) || txn.requires.iter().any(required)
        }
        None => seen.contains(other),
    }
}

#[cfg(test)]
mod tests;
