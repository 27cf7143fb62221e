//! The restarts of this node's agent from its recorded inputs, and its shutdown.
//!
//! A node that is killed again and again still takes over the running programs, reports about them and can stop them. It
//! begins nothing new, because a new deployment or change may be what kills it.

use comms::logic::human::span;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// How many kills within [`WITHIN`] a node may have. After one more, it begins nothing new.
const KILLS_MAX: usize = 5;
/// The period over which kills are counted. It is also how long the node begins nothing new after too many kills.
const WITHIN: Duration = Duration::from_secs(60);
/// How long a node that leaves waits for others to acknowledge its last messages.
const LINGER_MAX: Duration = Duration::from_secs(1);

/// The life of this node.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Run {
    pub(super) started: Time,
    /// The calendar clock at [`Time::ZERO`], as time since 1970.
    pub(super) calendar: Duration,
    /// The last few times at which this agent was made again from its inputs.
    adoptions: VecDeque<Time>,
    pub(super) leaving: bool,
    /// The time until which a node without any work left waits for others to acknowledge its last messages.
    lingers_until: Option<Time>,
}

impl Run {
    /// Returns the life of a node that begins.
    pub(super) const fn new(now: Time) -> Self {
        Self { started: now, calendar: Duration::ZERO, adoptions: VecDeque::new(), leaving: false, lingers_until: None }
    }

    /// Returns a moment on the calendar clock.
    pub(super) fn since_1970(&self, now: Time) -> Duration {
        self.calendar + now.since(Time::ZERO)
    }

    /// Takes note that this agent was made again from its inputs.
    pub(super) fn adopted(&mut self, now: Time) {
        // The user who started this node again wants it to stay.
        (self.leaving, self.lingers_until) = (false, None);
        self.adoptions.push_back(now);
        while self.adoptions.len() > KILLS_MAX + 1 {
            self.adoptions.pop_front();
        }
    }

    /// Returns why this node takes nothing new on, if it is killed again and again.
    pub(super) fn crash_loop(&self, now: Time) -> Option<String> {
        let first = self.adoptions.front().filter(|_| self.adoptions.len() > KILLS_MAX)?;
        let last = self.adoptions.back()?;
        let until = *last + WITHIN;
        let seconds = until.since(now).as_millis().div_ceil(1000);
        (*last - *first < WITHIN && now < until).then(|| {
            format!(
                "its node was killed {} times within {} and takes nothing new on for {seconds} s; what runs goes on, and \
                 can be stopped",
                self.adoptions.len(),
                span(WITHIN),
            )
        })
    }

    /// Returns whether the node does not wait for acknowledgements yet.
    pub(super) const fn is_at_work(&self) -> bool {
        self.lingers_until.is_none()
    }

    /// Waits for acknowledgements from now on. Returns whether it has waited long enough.
    pub(super) fn linger(&mut self, now: Time) -> bool {
        *self.lingers_until.get_or_insert(now + LINGER_MAX) <= now
    }

    /// Returns until when it waits for acknowledgements.
    pub(super) const fn deadline(&self) -> Option<Time> {
        self.lingers_until
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> Time {
        Time::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn a_node_that_is_killed_again_and_again_takes_nothing_new() {
        let mut run = Run::new(at(0));
        for second in 0..5 {
            run.adopted(at(second));
            assert_eq!(run.crash_loop(at(second)), None);
        }
        run.adopted(at(5));
        assert!(run.crash_loop(at(5)).is_some_and(|why| why.contains("6 times")), "{run:?}");
        assert!(run.crash_loop(at(64)).is_some() && run.crash_loop(at(65)).is_none());
        // Only the last few kills count, and only if they were quick.
        run.adopted(at(300));
        assert_eq!(run.crash_loop(at(300)), None);
    }

    #[test]
    fn a_node_that_was_started_again_stays() {
        let mut run = Run::new(at(0));
        run.leaving = true;
        assert!(run.is_at_work() && !run.linger(at(1)) && !run.is_at_work() && run.linger(at(2)));
        assert_eq!(run.deadline(), Some(at(2)));
        run.adopted(at(3));
        assert!(!run.leaving && run.is_at_work() && run.deadline().is_none());
    }
}
