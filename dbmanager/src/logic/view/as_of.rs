//! Past states, and the difference between two states.
//!
//! A moment is a version vector. It can be shown if there is a *base*, a known state for which the log still has every later
//! transaction. The base is the empty state if nothing was ever dropped. Transactions are applied by the same rule as in the
//! replica. So the state at the present version vector equals the present state, including its digest.
//!
//! A replica that has joined a team, or has dropped a part of its log, has no earlier state. So each replica keeps its own
//! [`Checkpoints`] from its start on, before it drops the first part of the log. States share their common parts, so a few of
//! them cost little.
//!
//! A date also selects a version vector: all transactions that were committed by then according to a trustworthy clock, and all
//! transactions that these had seen. For a write without such a clock, two bounds are known: it was not earlier than any date
//! that its writer had seen, and not later than the date of any transaction that has seen the write. A date between the two is
//! refused, because the answer is unknown. A base can be used if it is within the selected version vector. So a single date in
//! 2099 blocks no base, once others have seen it.

use super::past::{Past, When};
use super::value::Datum;
use crate::logic::key::Key;
use crate::logic::log::Head;
use crate::logic::state::{CausalContext, State, Version};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use thiserror::Error;

/// The most states that are kept, from which other states are computed.
const CHECKPOINTS_MAX: usize = 16;
/// The smallest number of transactions between two kept states.
const CHECKPOINT_PERIOD: usize = 1024;
/// A state is kept at least once per this part of the log, so dropping the oldest part of the log loses no more than that.
const CHECKPOINT_SHARE: usize = 8;

/// A state from which later states can be computed.
#[derive(Clone, Debug, Default)]
pub struct Base {
    /// The last transaction of each origin in the state.
    pub heads: BTreeMap<ReplicaId, Head>,
    /// The state after these transactions.
    pub state: State,
}

/// Some earlier states, the oldest first. The log still has every transaction after the first of them.
#[derive(Clone, Debug, Default)]
pub struct Checkpoints(VecDeque<Base>);

/// Why a moment cannot be shown.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum AsOfError {
    /// The required transactions were dropped.
    #[error(
        "earlier states are no longer kept; the oldest moment that can be shown is {}",
        super::token::token(oldest)
    )]
    Compacted {
        /// The oldest moment that can be shown.
        oldest: VersionVector,
    },
    /// Some of the transactions have not arrived here.
    #[error(
        "this robot lacks some transactions that were seen at that moment ({}); ask again when they have arrived",
        super::token::token(missing)
    )]
    Ahead {
        /// The transactions that the log would need.
        missing: VersionVector,
    },
    /// This robot does not know a robot of this name.
    #[error("the team has no robot `{robot}`; `dca db status` lists its robots")]
    NoMember {
        /// The name.
        robot: String,
    },
    /// Some changes were made while no clock was set, and by the requested date no dated transaction had seen them.
    #[error(
        "the state at that date is not known: {count} of the requested changes have no date, since their robot's clock \
         was not set (the first is {first}, by `{by}`); ask for a later date, or for a version as `dca db version` prints it"
    )]
    Undated {
        /// The first of these changes.
        first: Dot,
        /// The robot of that change.
        by: String,
        /// The number of these changes.
        count: usize,
    },
}

/// A key that two states show differently.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Difference {
    /// The key.
    pub key: Key,
    /// The value before.
    pub before: Option<Datum>,
    /// The value after.
    pub after: Option<Datum>,
    /// The number of concurrent writes after the change; 1 without a conflict.
    pub siblings: usize,
}

impl Base {
    /// Returns the base of a log: the empty state if the log is complete, or `older` if the log continues from it.
    fn of(past: &Past<'_>, older: Option<&Self>) -> Result<Self, AsOfError> {
        let low = past.log.low();
        match older.filter(|base| base.vector().dominates(&low)) {
            _ if low.is_empty() => Ok(Self::default()),
            Some(base) => Ok(base.clone()),
            None => Err(AsOfError::Compacted { oldest: past.log.vector().clone() }),
        }
    }

    /// Returns the version vector of the state.
    pub fn vector(&self) -> VersionVector {
        self.heads.iter().map(|(origin, head)| (*origin, head.seq)).collect()
    }
}

impl Checkpoints {
    /// Keeps the present state from time to time. If this is called after every change, all moments since the first call can be
    /// shown, as far as the log reaches back.
    pub fn note(&mut self, past: &Past<'_>) {
        let low = past.log.low();
        while self.0.front().is_some_and(|base| !base.vector().dominates(&low)) {
            self.0.pop_front();
        }
        let count = |vector: &VersionVector| vector.iter().map(|(_, seq)| seq).sum::<u64>();
        let period = CHECKPOINT_PERIOD.max(past.log.len() / CHECKPOINT_SHARE) as u64;
        let due = |base: &Base| count(past.log.vector()) >= count(&base.vector()).saturating_add(period);
        if !self.0.back().is_none_or(due) {
            return;
        }
        self.0.push_back(Base { heads: past.log.heads().clone(), state: past.state.clone() });
        if self.0.len() > CHECKPOINTS_MAX {
            // Every second state is dropped. The oldest is kept, because it limits how far back users can look.
            let mut index = 0_usize;
            self.0.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
    }

    /// Returns the latest state before a version vector, or the oldest.
    pub fn before(&self, vector: &VersionVector) -> Option<&Base> {
        self.0.iter().rev().find(|base| vector.dominates(&base.vector())).or(self.0.front())
    }

    /// Returns the oldest state.
    pub fn oldest(&self) -> Option<&Base> {
        self.0.front()
    }
}

impl Past<'_> {
    /// Returns the state at a version vector. If the vector lacks transactions that its own transactions had seen, this is the
    /// state at the largest complete part of it. `base` is a state before it, if there is one.
    ///
    /// # Errors
    /// If the state is no longer kept, or some of its transactions have not arrived.
    pub fn at(&self, vector: &VersionVector, base: Option<&Base>) -> Result<State, AsOfError> {
        if vector == self.log.vector() {
            return Ok(self.state.clone());
        }
        if !self.log.vector().dominates(vector) {
            return Err(AsOfError::Ahead { missing: vector.beyond(self.log.vector()) });
        }
        let Base { heads, mut state } = Base::of(self, base)?;
        let mut applied: VersionVector = heads.iter().map(|(origin, head)| (*origin, head.seq)).collect();
        if !vector.dominates(&applied) {
            return Err(AsOfError::Compacted { oldest: applied });
        }
        self.walk(&heads, |txn, context| {
            if !vector.contains(txn.dot()) || applied.contains(txn.dot()) || !applied.dominates(context) {
                return;
            }
            let only = txn.rebase.as_ref().map(|rebase| rebase.takes.as_slice());
            let own = txn.dot().origin;
            let seen = if only.is_some() { context.clone().without(own) } else { context.clone() };
            state.apply(txn.dot(), txn.written(), CausalContext { context: &seen, only }, &txn.writes);
            applied.include(txn.dot());
        });
        Ok(state)
    }

    /// Returns the version vector at a date, in milliseconds since 1970, for the keys below `prefix`.
    ///
    /// # Errors
    /// If that moment is no longer kept, or its content is unknown.
    pub fn vector_at(&self, millis: u64, prefix: &str, base: Option<&Base>) -> Result<VersionVector, AsOfError> {
        let base = Base::of(self, base)?;
        let (mut vector, oldest) = (VersionVector::default(), base.vector());
        for (origin, head) in &base.heads {
            let dot = Dot { origin: *origin, seq: head.seq };
            let kept = self.log.encoded(dot).and_then(|encoded| encoded.open().ok());
            // Of what is gone the timestamp is left; one from before any date had been seen says nothing.
            let stamp = When { millis: head.stamp.millis(), trusted: false };
            let stamped = || stamp.is_known().then_some(stamp.millis);
            if kept.map_or_else(stamped, |txn| When::dated(txn.wall, txn.stamp)).is_some_and(|date| date <= millis) {
                vector.join(&head.context);
                vector.include(dot);
            }
        }
        let (mut later, mut undated): (Vec<Dot>, Vec<(Dot, VersionVector)>) = (Vec::new(), Vec::new());
        self.walk(&base.heads, |txn, context| match When::dated(txn.wall, txn.stamp) {
            _ if oldest.contains(txn.dot()) => {}
            Some(date) if date <= millis => {
                vector.join(context);
                vector.include(txn.dot());
            }
            Some(_) => later.push(txn.dot()),
            None if txn.stamp.millis() > millis => {}
            None if txn.writes.iter().any(|write| write.key.as_str().starts_with(prefix)) => {
                undated.push((txn.dot(), context.clone()));
            }
            None => {}
        });
        if !vector.dominates(&oldest) {
            return Err(AsOfError::Compacted { oldest });
        }
        later.retain(|dot| !vector.contains(*dot));
        undated.retain(|(dot, seen)| !vector.contains(*dot) && !later.iter().any(|later| seen.contains(*later)));
        match undated.first() {
            Some((first, _)) => {
                Err(AsOfError::Undated { first: *first, by: self.robot(first.origin), count: undated.len() })
            }
            None => Ok(vector),
        }
    }
}

/// Returns the state with these versions, so that a client which has received them can use the functions for states.
pub fn state_of(entries: impl IntoIterator<Item = (Key, Vec<Version>)>) -> State {
    let mut state = State::default();
    for (key, versions) in entries {
        state.restore(key, versions);
    }
    state
}

/// Returns the keys below `prefix` that two states show differently, in order.
pub fn diff(earlier: &State, later: &State, prefix: &str) -> Vec<Difference> {
    let keys: BTreeSet<&Key> = earlier.scan(prefix).chain(later.scan(prefix)).map(|(key, _)| key).collect();
    let shown = |versions: &[Version]| versions.last().and_then(|version| version.value.as_ref().map(Datum::of));
    let difference = |key: &Key| {
        let (old, new) = (earlier.versions(key), later.versions(key));
        if old == new {
            return None;
        }
        let dots = |versions: &[Version]| versions.iter().map(|version| version.dot).collect::<Vec<Dot>>();
        let (before, after) = (shown(old), shown(new));
        let (was, is) = (earlier.is_conflict(key), later.is_conflict(key));
        let settled_or_new = (was || is) && dots(old) != dots(new);
        let siblings = if is { new.len() } else { 1 };
        (before != after || settled_or_new).then(|| Difference { key: key.clone(), before, after, siblings })
    };
    keys.into_iter().filter_map(difference).collect()
}

/// Returns the differences between the keys below two prefixes, matched by the rest of the key. Each is listed under its key
/// below `to`.
pub fn compare(state: &State, from: &str, to: &str) -> Vec<Difference> {
    let (old, new) = (below(state, from), below(state, to));
    let shown = |versions: Option<&&[Version]>| versions?.last()?.value.as_ref().map(Datum::of);
    let names: BTreeSet<&str> = old.keys().chain(new.keys()).copied().collect();
    let difference = |name: &str| {
        let (before, after) = (shown(old.get(name)), shown(new.get(name)));
        let key = Key::new(format!("{to}{name}")).or_else(|_too_long| Key::new(format!("{from}{name}"))).ok()?;
        let siblings = if state.is_conflict(&key) { state.versions(&key).len() } else { 1 };
        (before != after).then_some(Difference { key, before, after, siblings })
    };
    names.into_iter().filter_map(difference).collect()
}

/// Returns the keys below a prefix, by the rest of the key.
fn below<'s>(state: &'s State, prefix: &'s str) -> BTreeMap<&'s str, &'s [Version]> {
    state.scan(prefix).filter_map(|(key, all)| Some((key.as_str().strip_prefix(prefix)?, all))).collect()
}

#[cfg(test)]
mod tests;
