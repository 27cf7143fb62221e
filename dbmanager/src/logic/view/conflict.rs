//! What nobody has settled: writes beside each other, and conditions that no longer held.
//!
//! A *conflict* is a key with versions that differ. A *race* is a transaction that relied on a key, and another that
//! had changed it before, in the one order of all, while neither had seen the other: both were committed, although the
//! second would have been refused on one robot. No database that takes writes while it is cut off can prevent either;
//! this one lists them. Both are over when somebody writes the key having seen both.

use super::past::{Past, When, has_seen};
use super::value::Datum;
use crate::logic::clock::Stamp;
use crate::logic::cut::{Dot, Origin};
use crate::logic::key::Key;
use crate::logic::state::Version;
use crate::logic::txn::{Condition, Txn, Write};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The most races that are listed.
const RACES_MAX: usize = 1024;

/// A key with writes that did not see each other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Conflict {
    /// Which key.
    pub key: Key,
    /// The writes; the last is what a read shows.
    pub versions: Vec<Sibling>,
}

/// One of several writes to a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sibling {
    /// Which transaction.
    pub dot: Dot,
    /// What; nothing for a deletion.
    pub value: Option<Datum>,
    /// The robot.
    pub by: String,
    /// When.
    pub when: When,
    /// Why; nothing if the log does not reach back so far.
    pub reason: Option<String>,
}

/// A transaction that relied on what another had changed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Race {
    /// Which key.
    pub key: Key,
    /// Who relied on it.
    pub relied: Party,
    /// On what.
    pub condition: Condition,
    /// Who had changed it.
    pub changed: Party,
}

/// A transaction in a race.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Party {
    /// Which transaction.
    pub dot: Dot,
    /// The robot.
    pub by: String,
    /// When.
    pub when: When,
    /// Why.
    pub reason: String,
}

/// A transaction that relied on a key, or changed it.
struct Touch {
    dot: Dot,
    stamp: Stamp,
    condition: Option<Condition>,
    deletes: Option<bool>,
}

impl Past<'_> {
    /// Returns the keys below `prefix` with writes that did not see each other.
    pub fn conflicts(&self, prefix: &str) -> Vec<Conflict> {
        let conflict = |(key, versions): (&Key, &[Version])| Conflict {
            key: key.clone(),
            versions: versions.iter().map(|version| self.sibling(version)).collect(),
        };
        self.state.conflicts(prefix).map(conflict).collect()
    }

    fn sibling(&self, version: &Version) -> Sibling {
        let txn = self.log.frame(version.dot).and_then(|frame| frame.open().ok());
        let unknown = When { millis: version.stamp.millis(), trusted: false };
        Sibling {
            dot: version.dot,
            value: version.value.as_ref().map(Datum::of),
            by: self.robot(version.stamp.origin),
            when: txn.as_ref().map_or(unknown, |txn| When::of(txn.wall, version.stamp)),
            reason: txn.map(|txn| txn.reason),
        }
    }

    /// Returns the races at keys below `prefix`, as far back as the log reaches.
    pub fn races(&self, prefix: &str) -> Vec<Race> {
        let mut relied_on: BTreeSet<Key> = BTreeSet::new();
        self.walk(&BTreeMap::new(), |txn, _| {
            let keys = txn.requires.iter().map(|require| &require.key);
            relied_on.extend(keys.filter(|key| key.as_str().starts_with(prefix)).cloned());
        });
        let mut touches: BTreeMap<Key, BTreeMap<Origin, Vec<Touch>>> = BTreeMap::new();
        let mut races: Vec<(Key, Dot, Condition, Dot)> = Vec::new();
        self.walk(&BTreeMap::new(), |txn, seen| {
            for (key, touch) in touched(txn).into_iter().filter(|(key, _)| relied_on.contains(*key)) {
                let earlier = touches.entry(key.clone()).or_default();
                // Of each origin, what was not seen is the end of its chain.
                let beside = earlier
                    .values()
                    .flat_map(|chain| chain.iter().rev().take_while(|other| !has_seen(txn, seen, other.dot)));
                let beside = beside.take(RACES_MAX.saturating_sub(races.len()));
                let found = beside.filter_map(|other| race(&touch, other).or_else(|| race(other, &touch)));
                let found: Vec<_> = found.map(|(relied, on, changed)| (key.clone(), relied, on, changed)).collect();
                if touch.deletes.is_some() {
                    let over = |dot| has_seen(txn, seen, dot);
                    races.retain(|(at, relied, _, changed)| at != key || !over(*relied) || !over(*changed));
                }
                races.extend(found);
                earlier.entry(touch.dot.origin).or_default().push(touch);
            }
        });
        let race = |(key, relied, condition, changed): (Key, Dot, Condition, Dot)| {
            Some(Race { key, relied: self.party(relied)?, condition, changed: self.party(changed)? })
        };
        races.into_iter().filter_map(race).collect()
    }

    fn party(&self, dot: Dot) -> Option<Party> {
        let txn = self.log.frame(dot)?.open().ok()?;
        let (by, when) = (self.robot(txn.written().origin), When::of(txn.wall, txn.written()));
        Some(Party { dot, by, when, reason: txn.reason })
    }
}

/// Returns what a transaction has to do with each key.
fn touched(txn: &Txn) -> BTreeMap<&Key, Touch> {
    let (dot, stamp) = (txn.dot(), txn.written());
    let mut touched: BTreeMap<&Key, Touch> = BTreeMap::new();
    let touch = || Touch { dot, stamp, condition: None, deletes: None };
    for require in &txn.requires {
        touched.entry(&require.key).or_insert_with(touch).condition = Some(require.condition);
    }
    for Write { key, value } in &txn.writes {
        touched.entry(key).or_insert_with(touch).deletes = Some(value.is_none());
    }
    touched
}

/// Returns who relied on what, and who had changed it, if that is so.
fn race(relied: &Touch, changed: &Touch) -> Option<(Dot, Condition, Dot)> {
    let (condition, deletes) = (relied.condition?, changed.deletes?);
    let broken = match condition {
        Condition::Absent => !deletes,
        Condition::Exists => deletes,
        Condition::Is(_) => true,
    };
    (broken && changed.stamp < relied.stamp).then_some((relied.dot, condition, changed.dot))
}

#[cfg(test)]
mod tests;
