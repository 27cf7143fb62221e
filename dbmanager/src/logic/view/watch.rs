//! Watching: every transaction that changes a key below a prefix is reported once, as a whole, and after everything that it had
//! seen.
//!
//! *State.* A version vector: the transactions reported so far. *The log is the queue.* A watcher takes as many events as it
//! can store, and the others stay in the log. So a slow watcher costs no memory and delays no other. The version vector is also a
//! token: with it, a watcher continues after a restart, or at another robot.
//!
//! *Why it is right.* The log returns the transactions beyond a version vector in the order of application, which is causal, and
//! each transaction has one name. So each is reported once, and after all transactions that it had seen. There are two ways to
//! miss changes, and both are reported. The log may have dropped transactions that were not taken yet ([`Notification::Lagged`]).
//! Or the replica may have started again with the state of another ([`Notification::Replaced`]). In both cases the watcher reads
//! the state, and continues from there. A name changes if a robot was retired while it was away. A transaction that was reported
//! under the old name is not reported again.

use super::as_of::AsOfError;
use super::past::{HistoryEntry, Keys, Past};
use crate::logic::key::Key;
use crate::logic::log::Log;
use crate::logic::version_vector::VersionVector;
use serde::{Deserialize, Serialize};

/// The approximate number of bytes of transactions that are searched at a time.
const SCAN_SIZE: usize = 256 << 10;

/// The position of one watcher.
#[derive(Clone, Debug)]
pub struct Watch {
    keys: Keys,
    position: VersionVector,
    replaced: bool,
}

/// A notification for a watcher.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Notification {
    /// A transaction has become visible. The watcher adds its name to the version vector of reported transactions:
    /// [`VersionVector::include`].
    Event(Box<Event>),
    /// The next transactions were dropped, since the watcher was too slow. It reads the state, and continues from `resume`.
    Lagged {
        /// The state at the moment.
        resume: VersionVector,
    },
    /// The robot's own writes have new names. The watcher reads the state, and continues from `resume`.
    Replaced {
        /// The state at the moment.
        resume: VersionVector,
    },
}

/// A transaction that changes a watched key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// The transaction: its author, time, reason and writes.
    pub entry: HistoryEntry,
    /// The keys that now have concurrent writes.
    pub conflicts: Vec<Key>,
}

/// The next notifications for a watcher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notifications {
    /// In order.
    pub list: Vec<Notification>,
    /// Whether there may be more at once.
    pub more: bool,
}

impl Watch {
    /// Begins to watch the transactions after `from`.
    ///
    /// # Errors
    /// If some of these transactions were dropped.
    pub fn new(keys: Keys, from: VersionVector, log: &Log) -> Result<Self, AsOfError> {
        if from.dominates(&log.low()) {
            Ok(Self { keys, position: from, replaced: false })
        } else {
            Err(AsOfError::Compacted { oldest: log.vector().clone() })
        }
    }

    /// Returns the version vector of everything that was reported: the token from which to resume.
    pub const fn position(&self) -> &VersionVector {
        &self.position
    }

    /// Notes that the replica has started again with the state of another.
    pub const fn replaced(&mut self) {
        self.replaced = true;
    }

    /// Returns the next notifications, with up to `room` events.
    pub fn next(&mut self, past: &Past<'_>, room: usize) -> Notifications {
        let mut list = Vec::new();
        if self.replaced && room > 0 {
            self.replaced = false;
            self.position = past.log.vector().clone();
            return Notifications { list: vec![Notification::Replaced { resume: self.position.clone() }], more: false };
        }
        if room == 0 || self.position.dominates(past.log.vector()) {
            return Notifications { list, more: false };
        }
        let Some((txns, more)) = past.log.beyond(&self.position, SCAN_SIZE) else {
            self.position = past.log.vector().clone();
            return Notifications { list: vec![Notification::Lagged { resume: self.position.clone() }], more: false };
        };
        for encoded in txns {
            if list.len() >= room {
                return Notifications { list, more: true };
            }
            let Ok(txn) = encoded.open() else { continue };
            self.position.include(txn.dot());
            // If the old name is here too, it belongs to another transaction: its origin has used a number twice.
            let before = txn.rebase.as_ref().and_then(|rebase| rebase.from);
            if before.is_some_and(|from| self.position.contains(from) && !past.log.vector().contains(from)) {
                continue;
            }
            let Some(entry) = past.entry(&txn, &self.keys) else { continue };
            let keys = entry.changes.iter().map(|(key, _)| key);
            let conflicts = keys.filter(|key| past.state.is_conflict(key)).cloned().collect();
            list.push(Notification::Event(Box::new(Event { entry, conflicts })));
        }
        Notifications { list, more }
    }
}

#[cfg(test)]
mod tests;
