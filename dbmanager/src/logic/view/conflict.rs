//! Unresolved conflicts: concurrent writes, and conditions that no longer held.
//!
//! A *conflict* is a key with different versions. A *race* is a pair of transactions, neither of which had seen the other: one
//! relied on a key, and the other had changed it, earlier in the total order. Both were committed, although on one robot the
//! first would have been refused. If a robot writes below a prefix that was granted to another robot, and neither the write nor
//! the grant has seen the other, this is also a race. No timestamp shows which was first, since the owner with the later
//! timestamp may have decided earlier. A database that accepts writes while it is cut off cannot prevent conflicts and races;
//! this one lists them. They are resolved when a client that has seen both sides writes the key.

mod count;

pub use count::RaceCount;

use super::past::{Past, When, has_seen};
use super::value::Datum;
use crate::logic::clock::Timestamp;
use crate::logic::key::Key;
use crate::logic::owner::{self, prefixes};
use crate::logic::state::Version;
use crate::logic::txn::{Condition, Require, Txn, Write};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A key with writes that did not see each other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Conflict {
    /// The key.
    pub key: Key,
    /// The writes; a read shows the last.
    pub versions: Vec<Sibling>,
}

/// One of several writes to a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sibling {
    /// The transaction of the write.
    pub dot: Dot,
    /// The value; `None` for a deletion.
    pub value: Option<Datum>,
    /// The robot of the writer.
    pub by: String,
    /// When the transaction was committed.
    pub when: When,
    /// The reason; none if the log does not reach back so far.
    pub reason: Option<String>,
}

/// A key with transactions that relied on a value of the key while other transactions had changed it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Race {
    /// The key.
    pub key: Key,
    /// The number of these transactions.
    pub count: u64,
    /// The name of the present writes at the key, for a client that resolves the race.
    pub seen: String,
    /// The last of these transactions.
    pub relied: Party,
    /// The condition. None for a write that only assumed that no prefix of the key was granted to another robot.
    pub condition: Option<Condition>,
    /// The transactions that had changed the key or granted its prefix.
    pub changed: Party,
}

/// A transaction in a race.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Party {
    /// The name of the transaction.
    pub dot: Dot,
    /// The robot that committed the transaction.
    pub by: String,
    /// When the transaction was committed.
    pub when: When,
    /// The writer's reason.
    pub reason: String,
}

/// A transaction that relied on a key, or changed it.
struct Touch {
    dot: Dot,
    from: Option<Dot>,
    stamp: Timestamp,
    condition: Option<Condition>,
    deletes: Option<bool>,
}

/// The transactions that relied on a key. Each comes with the transactions that had changed the key: the first and the last of
/// each origin.
type Unsettled = BTreeMap<Dot, (Option<Condition>, BTreeMap<ReplicaId, [Dot; 2]>)>;

/// Notes that a transaction relied on a key that another transaction had changed.
fn note(unsettled: &mut Unsettled, relied: Dot, condition: Option<Condition>, changed: Dot) {
    let (_, of) = unsettled.entry(relied).or_insert_with(|| (condition, BTreeMap::new()));
    let [first, last] = of.entry(changed.origin).or_insert([changed; 2]);
    (*first, *last) = ((*first).min(changed), (*last).max(changed));
}

/// A transaction that granted a prefix to a robot, or released it.
struct Granted {
    dot: Dot,
    /// The dots of the write, including the dots of its other lives.
    names: BTreeSet<Dot>,
    stamp: Timestamp,
    robot: Option<String>,
    /// The transactions that it had seen; none if only its rebased part from another life is left.
    seen: Option<VersionVector>,
}

/// The grants of each prefix, in the order of their timestamps.
type Grants = BTreeMap<String, BTreeMap<Timestamp, Granted>>;

/// How many hexadecimal digits the name of a set of writes has: enough that different sets practically never have the same name.
const SEEN_DIGITS: usize = 12;

/// Returns a name for these writes at a key, which does not depend on their order. A client that resolves a conflict
/// passes it, to show which writes it has seen.
pub fn seen(writes: impl IntoIterator<Item = Dot>) -> String {
    let mut digest = blake3::Hasher::new();
    for dot in writes.into_iter().collect::<BTreeSet<Dot>>() {
        digest.update(&dot.origin.number().to_le_bytes()).update(&dot.seq.to_le_bytes());
    }
    digest.finalize().to_hex()[..SEEN_DIGITS].to_owned()
}

impl Conflict {
    /// Returns the name of the writes of this conflict.
    pub fn seen(&self) -> String {
        seen(self.versions.iter().map(|sibling| sibling.dot))
    }
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
        let txn = self.log.encoded(version.dot).and_then(|encoded| encoded.open().ok());
        let unknown = When { millis: version.stamp.millis(), trusted: false };
        Sibling {
            dot: version.dot,
            value: version.value.as_ref().map(Datum::of),
            by: self.robot(version.stamp.origin),
            when: txn.as_ref().map_or(unknown, When::of_txn),
            reason: txn.map(|txn| txn.reason),
        }
    }

    /// Returns the races at keys below `prefix`, as far back as the log reaches.
    pub fn races(&self, prefix: &str) -> Vec<Race> {
        let (mut relied_on, mut grants) = (BTreeSet::<Key>::new(), Grants::new());
        self.walk(&BTreeMap::new(), |txn, seen| {
            let keys = txn.requires.iter().filter(|require| fence(require).is_none()).map(|require| &require.key);
            relied_on.extend(keys.filter(|key| key.as_str().starts_with(prefix)).cloned());
            for (prefix, robot) in granted(txn) {
                let (dot, stamp, names) = (txn.dot(), txn.written(), BTreeSet::new());
                let lives = grants.entry(prefix.to_owned()).or_default();
                let granted = lives.entry(stamp).or_insert(Granted { dot, names, stamp, robot, seen: None });
                granted.names.extend(names_of(txn));
                granted.seen = granted.seen.take().or_else(|| txn.rebase.is_none().then(|| seen.clone()));
            }
        });
        let mut touches: BTreeMap<Key, BTreeMap<ReplicaId, Vec<Touch>>> = BTreeMap::new();
        let mut races: BTreeMap<Key, Unsettled> = BTreeMap::new();
        self.walk(&BTreeMap::new(), |txn, seen| {
            let fences: BTreeMap<&str, Dot> = txn.requires.iter().filter_map(fence).collect();
            for (key, touch) in touched(txn).into_iter().filter(|(key, _)| key.as_str().starts_with(prefix)) {
                let mut found = Vec::new();
                if relied_on.contains(key) {
                    let earlier = touches.entry(key.clone()).or_default();
                    // Of each origin, the unseen transactions are the end of its chain.
                    let concurrent = earlier
                        .values()
                        .flat_map(|chain| chain.iter().rev().take_while(|other| !has_seen(txn, seen, other.dot)));
                    let races = concurrent.filter_map(|other| race(&touch, other).or_else(|| race(other, &touch)));
                    found.extend(races.map(|(relied, on, changed)| (relied, Some(on), changed)));
                }
                if touch.deletes.is_some() {
                    let over = |dot| has_seen(txn, seen, dot);
                    settle(&mut races, key, &over);
                    let fence = prefixes(key).filter_map(|prefix| Some((prefix, *fences.get(prefix)?))).last();
                    let grant = self.unknown_grant(txn, seen, key, fence, &grants);
                    found.extend(grant.map(|grant| (touch.dot, None, grant.dot)));
                }
                if !found.is_empty() {
                    let unsettled = races.entry(key.clone()).or_default();
                    for (relied, condition, changed) in found {
                        note(unsettled, relied, condition, changed);
                    }
                }
                if relied_on.contains(key) {
                    touches.entry(key.clone()).or_default().entry(touch.dot.origin).or_default().push(touch);
                }
            }
        });
        races.into_iter().filter_map(|(key, unsettled)| self.race(key, &unsettled)).collect()
    }

    /// Returns the race at a key, described by the last transaction that relied on it.
    fn race(&self, key: Key, unsettled: &Unsettled) -> Option<Race> {
        let count = u64::try_from(unsettled.len()).unwrap_or(u64::MAX);
        let (relied, (condition, changed)) = unsettled.last_key_value()?;
        let [_, changed] = changed.values().max_by_key(|[_, last]| *last)?;
        let seen = seen(self.state.versions(&key).iter().map(|version| version.dot));
        Some(Race {
            key,
            count,
            seen,
            relied: self.party(*relied)?,
            condition: *condition,
            changed: self.party(*changed)?,
        })
    }

    /// Returns the first grant of a prefix of `key` to another robot, such that neither the grant nor the write has seen the
    /// other. `fence` is the prefix and the grant on which the writer relied.
    fn unknown_grant<'a>(
        &self,
        txn: &Txn,
        seen: &VersionVector,
        key: &Key,
        fence: Option<(&str, Dot)>,
        grants: &'a Grants,
    ) -> Option<&'a Granted> {
        let of = |prefix: &str| grants.get(prefix).into_iter().flat_map(BTreeMap::values);
        let relied = fence.and_then(|(prefix, dot)| of(prefix).find(|granted| granted.names.contains(&dot)));
        let knows = |granted: &Granted| match &txn.rebase {
            Some(_) => {
                relied.is_some_and(|relied| relied.dot == granted.dot || relied.saw(&granted.names, granted.stamp))
            }
            None => granted.names.iter().any(|dot| seen.contains(*dot)),
        };
        let names = names_of(txn).collect();
        let unknown = |granted: &&Granted| {
            let other = || granted.robot.as_ref().is_some_and(|robot| *robot != self.robot(txn.written().origin));
            !knows(granted) && !granted.saw(&names, txn.written()) && other()
        };
        // The longest prefix counts: shorter ones do not affect a writer that relied on a record.
        let counts = |prefix: &&str| fence.is_none_or(|(fenced, _)| prefix.len() >= fenced.len());
        prefixes(key).filter(counts).flat_map(of).find(unknown)
    }

    fn party(&self, dot: Dot) -> Option<Party> {
        let txn = self.log.encoded(dot)?.open().ok()?;
        let (by, when) = (self.robot(txn.written().origin), When::of_txn(&txn));
        Some(Party { dot, by, when, reason: txn.reason })
    }
}

impl Granted {
    /// Returns whether, as far as is known, the transaction has seen a transaction with one of these names.
    fn saw(&self, names: &BTreeSet<Dot>, stamp: Timestamp) -> bool {
        self.seen.as_ref().map_or(stamp < self.stamp, |seen| names.iter().any(|dot| seen.contains(*dot)))
    }
}

/// Returns the name of a transaction, and its former name, if it has one.
fn names_of(txn: &Txn) -> impl Iterator<Item = Dot> {
    [txn.dot()].into_iter().chain(txn.rebase.as_ref().and_then(|rebase| rebase.from))
}

/// Returns the prefix and the grant on which a transaction relied, if a condition contains them.
fn fence(require: &Require) -> Option<(&str, Dot)> {
    let Condition::Is(dot) = require.condition else { return None };
    Some((owner::prefix(&require.key)?, dot))
}

/// Returns the prefixes that a transaction granted, each with its new owner.
fn granted(txn: &Txn) -> impl Iterator<Item = (&str, Option<String>)> {
    txn.writes.iter().filter_map(|Write { key, value }| Some((owner::prefix(key)?, owner::read(value.as_ref()?)?.1)))
}

/// Returns how a transaction uses each key.
fn touched(txn: &Txn) -> BTreeMap<&Key, Touch> {
    let (dot, from, stamp) = (txn.dot(), txn.rebase.as_ref().and_then(|rebase| rebase.from), txn.written());
    let mut touched: BTreeMap<&Key, Touch> = BTreeMap::new();
    let touch = || Touch { dot, from, stamp, condition: None, deletes: None };
    for require in txn.requires.iter().filter(|require| fence(require).is_none()) {
        touched.entry(&require.key).or_insert_with(touch).condition = Some(require.condition);
    }
    for Write { key, value } in &txn.writes {
        touched.entry(key).or_insert_with(touch).deletes = Some(value.is_none());
    }
    touched
}

/// Removes the races at a key of which a write has seen both sides.
fn settle(races: &mut BTreeMap<Key, Unsettled>, key: &Key, over: &dyn Fn(Dot) -> bool) {
    let Some(unsettled) = races.get_mut(key) else { return };
    for (_, (_, changed)) in unsettled.iter_mut().filter(|(relied, _)| over(**relied)) {
        changed.retain(|_, [first, last]| !over(*first) || !over(*last));
    }
    unsettled.retain(|_, (_, changed)| !changed.is_empty());
    if unsettled.is_empty() {
        races.remove(key);
    }
}

/// If this is a race, returns the transaction that relied on a key, its condition, and the transaction that had changed the key.
fn race(relied: &Touch, changed: &Touch) -> Option<(Dot, Condition, Dot)> {
    let (condition, deletes) = (relied.condition?, changed.deletes?);
    let broken = match condition {
        Condition::Absent => !deletes,
        Condition::Exists => deletes,
        Condition::Is(dot) => dot != changed.dot && Some(dot) != changed.from,
    };
    (broken && changed.stamp < relied.stamp).then_some((relied.dot, condition, changed.dot))
}

#[cfg(test)]
mod tests;
