//! Whether a program that has died is started again, and when.
//!
//! The first time at once, since most programs that die are well again when they are new; then after pauses that double.
//! What has died too often is given up, and its supervisor decides: a robot that waits for one of its programs is a robot
//! that does nothing, so the limit is a matter of seconds.

use comms::logic::time::Time;
use language::plan::Restart;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// How often a program is started again,
pub const RESTARTS_MAX: u32 = 5;
/// within this time.
pub const WINDOW: Duration = Duration::from_secs(60);
/// Before the second time; doubled for each after it.
const PAUSE: Duration = Duration::from_millis(100);

/// How often one program was started again, of late.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Restarts {
    rule: Restart,
    recent: VecDeque<Time>,
}

impl Restarts {
    /// Returns the restarts of a program that has not died yet.
    pub(super) fn new(rule: Restart) -> Self {
        Self { rule, recent: VecDeque::new() }
    }

    /// Returns whether it is started again at all.
    pub(super) fn are_allowed(&self) -> bool {
        self.rule != Restart::Temporary
    }

    /// Returns whether it is started again even though it has done its work, as exit code 0 of a plain program says.
    pub(super) fn are_permanent(&self) -> bool {
        self.rule == Restart::Permanent
    }

    /// Takes note that it has died. Returns when it is to be started again; none when it is given up.
    pub(super) fn next(&mut self, now: Time) -> Option<Time> {
        if !self.are_allowed() {
            return None;
        }
        while self.recent.front().is_some_and(|at| now.since(*at) >= WINDOW) {
            self.recent.pop_front();
        }
        let count = self.count();
        if count >= RESTARTS_MAX {
            return None;
        }
        let pause = count.checked_sub(1).map_or(Duration::ZERO, |doublings| PAUSE * (1 << doublings));
        self.recent.push_back(now + pause);
        Some(now + pause)
    }

    /// Returns how often it was started again, of late.
    pub(super) fn count(&self) -> u32 {
        u32::try_from(self.recent.len()).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn pauses_double_until_it_is_given_up() {
        let mut restarts = Restarts::new(Restart::Transient);
        let (mut now, mut pauses) = (at(0), Vec::new());
        while let Some(next) = restarts.next(now) {
            pauses.push((next - now).as_millis());
            now = next;
        }
        assert_eq!(pauses, [0, 100, 200, 400, 800]);
        assert_eq!(restarts.count(), RESTARTS_MAX);
        assert_eq!(restarts.next(at(59_999)), None, "the first one was at 0");
        assert_eq!(restarts.next(at(60_000)), Some(at(60_800)));
        assert_eq!(restarts.next(at(200_000)), Some(at(200_000)), "all of that is long ago");
    }

    #[test]
    fn a_program_that_dies_now_and_then_is_always_started_again() {
        let mut restarts = Restarts::new(Restart::Permanent);
        for death in 0..100 {
            assert!(restarts.next(at(death * 13_000)).is_some(), "death {death}");
        }
    }

    #[test]
    fn without_the_policy_nothing_is() {
        assert_eq!(Restarts::new(Restart::Temporary).next(at(0)), None);
    }
}
