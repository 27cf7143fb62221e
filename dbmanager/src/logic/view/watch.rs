//! Watching: every transaction that changes a key below a prefix, once, whole, after all that it had seen.
//!
//! *State.* A cut: what was told. *The log is the queue.* A watcher takes as many events as it has room for, and what
//! it leaves stays in the log, so a slow one costs no memory, and nobody waits for it. What was told is a token, too:
//! with it, a watcher goes on after a restart, or at another robot.
//!
//! *Why it is right.* The log hands out what is beyond a cut in the order in which it was applied, which is causal, and
//! each transaction has one name. So each is told once, and nothing before what it had seen. There are two ways to miss
//! some, and both are told: the log has dropped what was not taken yet ([`Told::Lagged`]), and the replica has begun
//! anew with the state of another ([`Told::Replaced`]). Then the watcher reads the state, and goes on from there. A name may
//! change, if a robot was retired while it was away: who was told under the old one is not told again.

use super::moment::MomentError;
use super::past::{Deed, Keys, Past};
use crate::logic::cut::Cut;
use crate::logic::key::Key;
use crate::logic::log::Log;
use serde::{Deserialize, Serialize};

/// About how many bytes of transactions are looked through at a time.
const SCAN_SIZE: usize = 256 << 10;

/// The place of one watcher.
#[derive(Clone, Debug)]
pub struct Watch {
    keys: Keys,
    told: Cut,
    replaced: bool,
}

/// What a watcher is told.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Told {
    /// A transaction has become visible. With its name, the cut up to which was told grows: [`Cut::include`].
    Event(Box<Event>),
    /// What comes next is not kept any more, since the watcher was too slow. It reads the state, and goes on from
    /// `resume`.
    Lagged {
        /// The state at the moment.
        resume: Cut,
    },
    /// The robot's own writes have new names. The watcher reads the state, and goes on from `resume`.
    Replaced {
        /// The state at the moment.
        resume: Cut,
    },
}

/// A transaction that changes a key that is watched.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// Who, when, why, what.
    pub deed: Deed,
    /// Which of these keys have writes beside each other by now.
    pub conflicts: Vec<Key>,
}

/// What there is for a watcher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct News {
    /// In order.
    pub told: Vec<Told>,
    /// Whether there may be more at once.
    pub more: bool,
}

impl Watch {
    /// Begins to watch what comes after `from`.
    ///
    /// # Errors
    /// If some of that is not kept any more.
    pub fn new(keys: Keys, from: Cut, log: &Log) -> Result<Self, MomentError> {
        if from.dominates(&log.low()) {
            Ok(Self { keys, told: from, replaced: false })
        } else {
            Err(MomentError::Compacted { oldest: log.cut().clone() })
        }
    }

    /// Returns up to where everything was told: the token to go on with.
    pub const fn told(&self) -> &Cut {
        &self.told
    }

    /// The replica has begun anew with the state of another.
    pub const fn replaced(&mut self) {
        self.replaced = true;
    }

    /// Returns what comes next, up to `room` events.
    pub fn next(&mut self, past: &Past<'_>, room: usize) -> News {
        let mut told = Vec::new();
        if self.replaced && room > 0 {
            self.replaced = false;
            self.told = past.log.cut().clone();
            return News { told: vec![Told::Replaced { resume: self.told.clone() }], more: false };
        }
        if room == 0 || self.told.dominates(past.log.cut()) {
            return News { told, more: false };
        }
        let Some((frames, more)) = past.log.beyond(&self.told, SCAN_SIZE) else {
            self.told = past.log.cut().clone();
            return News { told: vec![Told::Lagged { resume: self.told.clone() }], more: false };
        };
        for frame in frames {
            if told.len() >= room {
                return News { told, more: true };
            }
            let Ok(txn) = frame.open() else { continue };
            self.told.include(txn.dot());
            // If the old name is here too, it names another transaction: its origin has used a number twice.
            let before = txn.rebase.as_ref().and_then(|rebase| rebase.from);
            if before.is_some_and(|from| self.told.contains(from) && !past.log.cut().contains(from)) {
                continue;
            }
            let Some(deed) = past.deed(&txn, &self.keys) else { continue };
            let keys = deed.changes.iter().map(|(key, _)| key);
            let conflicts = keys.filter(|key| past.state.is_conflict(key)).cloned().collect();
            told.push(Told::Event(Box::new(Event { deed, conflicts })));
        }
        News { told, more }
    }
}

#[cfg(test)]
mod tests;
