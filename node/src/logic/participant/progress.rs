//! How far a change has come on this host.
//!
//! The home waits for one reply after the other: `Applied` (or `Joined`, with the addresses of the programs that are added),
//! `Linked`, `Healthy`. A reply is due when the programs that it is about have reported:
//!
//! | reply | programs that have to report |
//! |---|---|
//! | `Applied`, `Joined` | new ones that are not up yet: `starting` |
//! | `Linked` | those whose links are not made yet: `linking` |
//! | `Healthy` | new ones on probation, `probing`; and no group hands connections over |
//!
//! A program that is added is in `adding` until the end of the change. A replaced program is never in `adding`.

use crate::logic::protocol::{ChangeReply, LeafFacts};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// How far a change has come on this host.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Progress {
    number: u32,
    /// New programs that are not up yet.
    starting: BTreeSet<u32>,
    /// Programs whose links are not made yet.
    linking: BTreeSet<u32>,
    /// New programs that are on probation.
    probing: BTreeSet<u32>,
    /// The wires that come or go.
    rewired: BTreeSet<u32>,
    /// The next reply that the home waits for, if any.
    next: Next,
    /// Programs that are added.
    adding: BTreeSet<u32>,
    /// The locations of the added programs.
    facts: Vec<LeafFacts>,
    /// How long a new program has to stay healthy.
    probation: Duration,
    /// Whether it takes another change back.
    is_undoing: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Next {
    #[default]
    Applied,
    Linked,
    Healthy,
    Nothing,
}

impl Progress {
    /// Returns the begin of a change.
    pub(super) fn new(number: u32, rewired: BTreeSet<u32>, probation: Duration, is_undoing: bool) -> Self {
        Self { number, rewired, probation, is_undoing, ..Self::default() }
    }

    /// Returns the number of the change.
    pub(super) const fn number(&self) -> u32 {
        self.number
    }

    /// Returns how long a new program has to stay healthy.
    pub(super) const fn probation(&self) -> Duration {
        self.probation
    }

    /// Returns whether it takes another change back.
    pub(super) const fn is_undoing(&self) -> bool {
        self.is_undoing
    }

    /// Returns the wires that come or go.
    pub(super) const fn rewired(&self) -> &BTreeSet<u32> {
        &self.rewired
    }

    /// Returns the programs that are added.
    pub(super) const fn adding(&self) -> &BTreeSet<u32> {
        &self.adding
    }

    /// Takes note that a program takes the place of another one.
    pub(super) fn replaces(&mut self, leaf: u32) {
        self.starting.insert(leaf);
        self.probing.insert(leaf);
    }

    /// Takes note that a program is started that the previous plan did not have.
    pub(super) fn adds(&mut self, leaf: u32) {
        self.replaces(leaf);
        self.adding.insert(leaf);
    }

    /// Takes note that a program that is added is up.
    pub(super) fn added(&mut self, facts: LeafFacts) {
        self.starting.remove(&facts.leaf);
        self.facts.push(facts);
    }

    /// Takes note that a program that was to be added cannot take part. The change fails.
    pub(super) fn not_added(&mut self, leaf: u32) {
        self.adding.remove(&leaf);
        self.probing.remove(&leaf);
    }

    /// Takes note that a program that replaces another one is up.
    pub(super) fn replaced(&mut self, leaf: u32) {
        self.starting.remove(&leaf);
    }

    /// Goes on: programs make their links.
    pub(super) const fn link(&mut self) {
        self.next = Next::Linked;
    }

    /// Takes note that a program that is added makes its links.
    pub(super) fn links(&mut self, leaf: u32) {
        self.linking.insert(leaf);
    }

    /// Takes note that a program that stays makes other links. The change waits for these links only before `Linked`: it
    /// drops links at its end, and nothing waits for that.
    pub(super) fn links_again(&mut self, leaf: u32) {
        if self.next == Next::Linked {
            self.linking.insert(leaf);
        }
    }

    /// Takes note that a program has its links, or never will; returns whether it was waited for.
    pub(super) fn linked(&mut self, leaf: u32) -> bool {
        self.linking.remove(&leaf)
    }

    /// Goes on: supervisors use the next connection sets.
    pub(super) const fn adopt(&mut self) {
        self.next = Next::Healthy;
    }

    /// Takes note that a program has passed its probation.
    pub(super) fn healthy(&mut self, leaf: u32) {
        self.probing.remove(&leaf);
    }

    /// Takes note that a program was not healthy; returns whether it was on probation, so that the change fails.
    pub(super) fn unhealthy(&mut self, leaf: u32) -> bool {
        self.probing.remove(&leaf)
    }

    /// Returns the reply that is due, once. `hands_over` tells whether a group hands connections over.
    pub(super) fn reply(&mut self, hands_over: bool) -> Option<ChangeReply> {
        let number = self.number;
        let (is_due, reply) = match self.next {
            Next::Applied if self.facts.is_empty() => (self.starting.is_empty(), ChangeReply::Applied { number }),
            Next::Applied => {
                let facts = self.facts.clone();
                (self.starting.is_empty(), ChangeReply::Joined { number, facts })
            }
            Next::Linked => (self.linking.is_empty(), ChangeReply::Linked { number }),
            Next::Healthy => (self.probing.is_empty() && !hands_over, ChangeReply::Healthy { number }),
            Next::Nothing => return None,
        };
        if is_due {
            self.next = Next::Nothing;
        }
        is_due.then_some(reply)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress() -> Progress {
        Progress::new(7, BTreeSet::from([4]), Duration::from_secs(1), false)
    }

    /// Each reply is given once, when the last program that it is about has reported.
    #[test]
    fn each_reply_waits_for_its_programs() {
        let mut progress = progress();
        progress.replaces(1);
        progress.replaces(2);
        assert_eq!(progress.reply(false), None);
        progress.replaced(1);
        assert_eq!(progress.reply(false), None);
        progress.replaced(2);
        assert_eq!(progress.reply(false), Some(ChangeReply::Applied { number: 7 }));
        assert_eq!(progress.reply(false), None);
        progress.link();
        progress.links_again(3);
        assert_eq!(progress.reply(false), None);
        assert!(progress.linked(3) && !progress.linked(3));
        assert_eq!(progress.reply(false), Some(ChangeReply::Linked { number: 7 }));
        // The links that are dropped at the end are not waited for.
        progress.links_again(3);
        assert!(!progress.linked(3));
        progress.adopt();
        progress.healthy(1);
        assert_eq!(progress.reply(false), None);
        assert!(progress.unhealthy(2) && !progress.unhealthy(2));
        assert_eq!(progress.reply(true), None, "a group hands its connections over");
        assert_eq!(progress.reply(false), Some(ChangeReply::Healthy { number: 7 }));
        assert_eq!(progress.reply(false), None);
    }

    /// The first reply names where added programs are. A program that cannot take part is not waited for afterwards.
    #[test]
    fn added_programs_are_named() {
        let mut progress = progress();
        progress.adds(1);
        progress.adds(2);
        progress.added(LeafFacts::plain(1));
        assert_eq!(progress.reply(false), None);
        progress.not_added(2);
        assert_eq!(progress.adding(), &BTreeSet::from([1]));
        assert_eq!(progress.reply(false), None, "the change has failed: its home takes it back");
        assert!(!progress.unhealthy(2));
        progress.added(LeafFacts::plain(2));
        let facts = vec![LeafFacts::plain(1), LeafFacts::plain(2)];
        assert_eq!(progress.reply(false), Some(ChangeReply::Joined { number: 7, facts }));
    }
}
