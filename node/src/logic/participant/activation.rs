//! The activations that wait: for the moment of an aligned start, or for the home.
//!
//! An aligned start: nothing is activated after the first question for the clock, because a
//! supervisor on another host may have received GO before. From GO on, supervisors prepare, so that
//! wires are open and other hosts have their orders when the moment comes. Programs wait for the
//! moment. A process that is stopped before has never begun.
//!
//! A check-in: after its node was away for long, nothing begins until the home has answered, since the home may have given this host up.
//! Running programs continue, and can be stopped. Restarts and activations wait.

use crate::logic::effect::earliest;
use crate::logic::protocol::{FailureCause, Target};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How long a home that can be reached has to answer: longer than the time after which an absent home is lost.
const WITHIN: Duration = Duration::from_secs(30);

/// The start of the processes of this host, and the activations that wait.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Activations {
    /// When the home said GO.
    go_at: Option<Time>,
    /// Whether its host was lost or has left, and its programs are not all up again.
    is_rejoining: bool,
    /// The question to its home, after its node was away.
    check_in: Option<CheckIn>,
    start: Start,
    /// Whether the moment was over when this host looked at its clock last.
    is_over: bool,
    waiting: Vec<Activation>,
}

/// An activation of a process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Activation {
    pub(super) target: Target,
    pub(super) number: u32,
    pub(super) value: Vec<u8>,
    /// When its supervisor decided it, on the clock of this host.
    pub(super) decided: Time,
}

/// When activated programs begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Start {
    /// At once.
    #[default]
    AtOnce,
    /// At a moment that is not known yet.
    Unknown,
    /// Not before a moment.
    At(Time),
}

/// A question to the home.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct CheckIn {
    number: u64,
    until: Time,
}

/// Returns why nothing begins in a part that is at its end, or no longer exists.
pub(in crate::logic) fn gone() -> FailureCause {
    FailureCause::NotAvailable("its node has left the deployment".to_owned())
}

impl Activations {
    /// Takes note of GO. Only the first GO is used.
    pub(super) fn go(&mut self, now: Time) {
        self.go_at.get_or_insert(now);
    }

    /// Returns how long ago GO was.
    pub(super) fn since_go(&self, now: Time) -> Duration {
        self.go_at.map_or(Duration::ZERO, |at| now - at)
    }

    /// Takes note that its host takes part again; GO was `since_go` ago.
    pub(super) fn rejoin(&mut self, now: Time, since_go: Duration) {
        self.is_rejoining = true;
        self.go_at = Some(now.before(since_go));
    }

    /// Takes note that the programs of a host that takes part again are all up.
    pub(super) const fn has_rejoined(&mut self) {
        self.is_rejoining = false;
    }

    /// Returns whether its host takes part again, and its programs are not all up.
    pub(super) const fn is_rejoining(&self) -> bool {
        self.is_rejoining
    }

    /// Waits for a moment from now on, unless GO has come already.
    pub(super) const fn await_moment(&mut self) {
        if self.go_at.is_none() {
            self.start = Start::Unknown;
        }
    }

    /// Takes the time of the start. None if programs begin as soon as they can.
    pub(super) fn start_at(&mut self, start: Option<Time>) {
        self.start = start.map_or(Start::AtOnce, Start::At);
    }

    /// Returns the moment, if one is known.
    pub(super) const fn start(&self) -> Time {
        if let Start::At(start) = self.start { start } else { Time::ZERO }
    }

    /// Returns when the programs of the first step begin, until then.
    pub(super) fn starts_at(&self) -> Option<Time> {
        let Start::At(start) = self.start else { return None };
        (!self.is_over && self.check_in.is_none()).then_some(start)
    }

    /// Takes note that the moment has come; returns how late that is noted. It is noted once.
    pub(super) fn begin(&mut self, now: Time) -> Option<Duration> {
        let start = self.starts_at().filter(|start| *start <= now)?;
        self.is_over = true;
        Some(now.since(start))
    }

    /// Returns whether something is to begin later.
    pub(super) fn is_early(&self, target: Target, now: Time) -> bool {
        if self.check_in.is_some() {
            return true;
        }
        match self.start {
            Start::AtOnce => false,
            Start::Unknown => true,
            Start::At(start) => now < start && matches!(target, Target::Leaf(_)),
        }
    }

    /// Has an activation wait.
    pub(super) fn defer(&mut self, activation: Activation) {
        if !self.waiting.iter().any(|other| other.is(activation.target, activation.number)) {
            self.waiting.push(activation);
        }
    }

    /// Removes a waiting activation that is stopped; returns whether it waited.
    pub(super) fn cancel(&mut self, target: Target, number: u32) -> bool {
        let count = self.waiting.len();
        self.waiting.retain(|other| !other.is(target, number));
        self.waiting.len() < count
    }

    /// Takes all activations that wait, in the order of their arrival.
    pub(super) fn take(&mut self) -> Vec<Activation> {
        std::mem::take(&mut self.waiting)
    }

    /// Waits for the answer of the home to this question.
    pub(super) fn check_in(&mut self, number: u64, now: Time) {
        self.check_in = Some(CheckIn { number, until: now + WITHIN });
    }

    /// Returns the question that its home has not answered.
    pub(super) fn checks_in(&self) -> Option<u64> {
        self.check_in.map(|check_in| check_in.number)
    }

    /// Stops waiting for the home. Returns whether this part was waiting.
    pub(super) fn checked_in(&mut self) -> bool {
        self.check_in.take().is_some()
    }

    /// Returns whether the home has not answered in time.
    pub(super) fn is_home_silent(&self, now: Time) -> bool {
        self.check_in.is_some_and(|check_in| check_in.until <= now)
    }

    /// Returns when the moment comes, or the wait for the home is over.
    pub(super) fn deadline(&self) -> Option<Time> {
        earliest(self.check_in.map(|check_in| check_in.until), self.starts_at())
    }
}

impl Activation {
    fn is(&self, target: Target, number: u32) -> bool {
        (self.target, self.number) == (target, number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAF: Target = Target::Leaf(1);
    const GROUP: Target = Target::Group(1);

    fn at(seconds: u64) -> Time {
        Time::from_nanos(seconds * 1_000_000_000)
    }

    fn activation(target: Target) -> Activation {
        Activation { target, number: 1, value: Vec::new(), decided: Time::ZERO }
    }

    /// Nothing begins between the question for the clock and GO. From GO on supervisors begin, and programs at the moment.
    #[test]
    fn an_aligned_start_holds_programs_back() {
        let mut activations = Activations::default();
        assert!(!activations.is_early(LEAF, at(1)));
        activations.await_moment();
        assert!(activations.is_early(LEAF, at(1)) && activations.is_early(GROUP, at(1)));
        activations.go(at(2));
        activations.start_at(Some(at(4)));
        assert!(activations.is_early(LEAF, at(3)) && !activations.is_early(GROUP, at(3)));
        assert_eq!((activations.starts_at(), activations.begin(at(3))), (Some(at(4)), None));
        assert_eq!(activations.begin(at(5)), Some(Duration::from_secs(1)));
        assert_eq!((activations.starts_at(), activations.begin(at(6))), (None, None));
        assert!(!activations.is_early(LEAF, at(6)));
        activations.await_moment();
        assert!(!activations.is_early(LEAF, at(6)), "after GO a question for the clock changes nothing");
    }

    /// Everything waits for the answer of the home, even an aligned start, but not for ever.
    #[test]
    fn a_check_in_holds_everything_back() {
        let mut activations = Activations::default();
        activations.start_at(Some(at(4)));
        activations.check_in(7, at(1));
        assert!(activations.is_early(LEAF, at(9)) && activations.is_early(GROUP, at(9)));
        assert_eq!((activations.starts_at(), activations.begin(at(9))), (None, None));
        assert_eq!((activations.checks_in(), activations.deadline()), (Some(7), Some(at(31))));
        assert!(!activations.is_home_silent(at(30)) && activations.is_home_silent(at(31)));
        assert!(activations.checked_in() && !activations.checked_in());
        assert_eq!((activations.deadline(), activations.begin(at(9))), (Some(at(4)), Some(Duration::from_secs(5))));
    }

    /// An order that is repeated waits once. An activation that is stopped in the meantime never begins.
    #[test]
    fn an_activation_waits_once() {
        let mut activations = Activations::default();
        activations.defer(activation(LEAF));
        activations.defer(activation(LEAF));
        activations.defer(activation(GROUP));
        assert!(activations.cancel(LEAF, 1) && !activations.cancel(LEAF, 1) && !activations.cancel(GROUP, 2));
        assert_eq!(activations.take(), [activation(GROUP)]);
        assert!(activations.take().is_empty());
    }

    #[test]
    fn the_first_go_counts() {
        let mut activations = Activations::default();
        assert_eq!(activations.since_go(at(3)), Duration::ZERO);
        activations.go(at(2));
        activations.go(at(3));
        assert_eq!(activations.since_go(at(5)), Duration::from_secs(3));
        activations.rejoin(at(5), Duration::from_secs(9));
        assert_eq!((activations.since_go(at(6)), activations.is_rejoining()), (Duration::from_secs(6), true));
    }
}
