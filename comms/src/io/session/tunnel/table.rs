//! The present tunnels, at most one for each session.

use super::super::patience::Ends;
use super::PublicKey;
use crate::logic::time::Time;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;

/// Within this time, two ends may dial each other because neither has learned of the other's tunnel.
const AT_ONCE: Duration = Duration::from_secs(5);
/// The most tunnels.
const TUNNELS_MAX: usize = 256;

/// A tunnel that exists.
#[derive(Clone, Debug)]
pub(super) struct Standing {
    /// The session that has dialled.
    pub(super) dialler: String,
    pub(super) since: Time,
    pub(super) key: PublicKey,
    pub(super) credential: Vec<u8>,
    pub(super) ends: Ends,
    /// A notification ends the tunnel.
    pub(super) end: Arc<Notify>,
}

/// The tunnels, by the session at the other end.
#[derive(Debug, Default)]
pub(super) struct Table {
    tunnels: BTreeMap<String, (u64, Standing)>,
    made: u64,
}

impl Table {
    /// Adds a tunnel, and ends the tunnel that it replaces. Returns the number of the new tunnel, or why it is refused. If two ends
    /// dial each other at once, both keep the tunnel whose dialling session has the smaller id. Otherwise the newer tunnel replaces
    /// the older one: an end that dials has no other tunnel.
    pub(super) fn enter(&mut self, session: &str, new: Standing) -> Result<u64, &'static str> {
        if let Some((_, old)) = self.tunnels.get(session) {
            if old.key != new.key {
                return Err("its session belongs to another key");
            }
            let is_at_once = old.dialler != new.dialler && new.since - old.since < AT_ONCE;
            if is_at_once && old.dialler < new.dialler {
                return Err("there is a tunnel already");
            }
            old.end.notify_one();
        } else if self.tunnels.len() >= TUNNELS_MAX {
            return Err("there are too many tunnels");
        }
        self.made += 1;
        self.tunnels.insert(session.to_owned(), (self.made, new));
        Ok(self.made)
    }

    /// Removes a tunnel that has ended.
    pub(super) fn leave(&mut self, session: &str, number: u64) {
        if self.tunnels.get(session).is_some_and(|(standing, _)| *standing == number) {
            self.tunnels.remove(session);
        }
    }

    pub(super) fn get(&self, session: &str) -> Option<&Standing> {
        self.tunnels.get(session).map(|(_, standing)| standing)
    }

    pub(super) fn all(&self) -> impl Iterator<Item = (&String, &Standing)> {
        self.tunnels.iter().map(|(session, (_, standing))| (session, standing))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn standing(dialler: &str, seconds: u64, key: u8) -> Standing {
        let at = ([127, 0, 0, 1], 7).into();
        Standing {
            dialler: dialler.to_owned(),
            since: Time::from_nanos(seconds * 1_000_000_000),
            key: [key; 32],
            credential: Vec::new(),
            ends: (at, at),
            end: Arc::default(),
        }
    }

    #[test]
    fn both_ends_keep_the_same_one_of_two() {
        // `a` and `b` dial each other. The two tunnels reach the two ends in any order.
        let both = |first: &str, second: &str, at: &str| {
            let mut table = Table::default();
            table.enter(at, standing(first, 10, 1)).unwrap();
            table.enter(at, standing(second, 11, 1)).unwrap_or_default();
            table.get(at).unwrap().dialler.clone()
        };
        for (first, second) in [("a", "b"), ("b", "a")] {
            assert_eq!((both(first, second, "b"), both(first, second, "a")), ("a".to_owned(), "a".to_owned()));
        }
    }

    #[test]
    fn who_dials_again_has_lost_the_old_one() {
        let mut table = Table::default();
        let old = standing("a", 10, 1);
        let number = table.enter("a", old.clone()).unwrap();
        assert!(table.enter("a", standing("b", 16, 1)).is_ok(), "long after");
        assert!(table.enter("a", standing("b", 17, 1)).is_ok(), "the same dialler");
        table.leave("a", number);
        assert_eq!(table.get("a").unwrap().since, Time::from_nanos(17_000_000_000), "an old one ends late");
        assert_eq!(table.enter("a", standing("b", 30, 2)), Err("its session belongs to another key"));
    }

    #[test]
    fn there_are_not_too_many() {
        let mut table = Table::default();
        for number in 0..TUNNELS_MAX {
            table.enter(&format!("{number}"), standing("a", 1, 1)).unwrap();
        }
        assert!(table.enter("one more", standing("a", 1, 1)).is_err() && table.enter("7", standing("a", 1, 1)).is_ok());
    }
}
