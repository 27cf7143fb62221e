//! When the loop calculates next: on absolute deadlines, or when a trigger sample arrives.

use crate::sdk::controller::Schedule;
use comms::logic::time::Time;
use std::time::Duration;

/// The deadlines of the loop.
#[derive(Debug)]
pub(super) struct Deadlines {
    schedule: Schedule,
    due: Time,
}

impl Deadlines {
    /// Returns deadlines of which the first one is over.
    pub(super) const fn new(schedule: Schedule) -> Self {
        Self { schedule, due: Time::ZERO }
    }

    /// Returns the time from one calculation to the next.
    pub(super) const fn period(&self) -> Duration {
        self.schedule.period
    }

    /// Returns the next deadline.
    pub(super) const fn due(&self) -> Time {
        self.due
    }

    /// Makes the next calculation due at `time`.
    pub(super) const fn restart(&mut self, time: Time) {
        self.due = time;
    }

    /// Returns whether a calculation on the grid comes within a time, without a trigger.
    pub(super) fn is_soon(&self, now: Time, within: Duration) -> bool {
        self.schedule.trigger.is_none() && self.due.since(now) < within
    }

    /// Sets the next deadline. If the schedule has a trigger, the deadline is one period after `time`. Otherwise the deadline is the
    /// next point of a fixed grid of periods, also after a trigger inside a group. Returns how many deadlines were missed.
    pub(super) fn arm(&mut self, time: Time) -> u64 {
        let period = self.schedule.period;
        if self.schedule.trigger.is_some() {
            self.due = time + period;
        }
        if time < self.due {
            return 0;
        }
        self.due = self.due + period;
        if self.due > time {
            return 0;
        }
        let missed = (time - self.due).as_nanos() / period.as_nanos().max(1) + 1;
        let skip = u32::try_from(missed).unwrap_or(u32::MAX);
        self.due = self.due + period * skip;
        u64::try_from(missed).unwrap_or(u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn deadlines_stay_on_the_grid_and_missed_ones_are_counted() {
        let mut deadlines = Deadlines::new(Schedule { period: Duration::from_millis(10), trigger: None });
        deadlines.restart(at(100));
        assert_eq!((deadlines.arm(at(100)), deadlines.due()), (0, at(110)));
        assert_eq!((deadlines.arm(at(105)), deadlines.due()), (0, at(110)), "a trigger inside a group");
        assert_eq!((deadlines.arm(at(113)), deadlines.due()), (0, at(120)), "late, and not too late");
        assert_eq!((deadlines.arm(at(130)), deadlines.due()), (1, at(140)));
        assert_eq!((deadlines.arm(at(175)), deadlines.due()), (3, at(180)));
        assert!(deadlines.is_soon(at(175), Duration::from_millis(6)));
        assert!(!deadlines.is_soon(at(175), Duration::from_millis(5)));
    }

    #[test]
    fn a_trigger_begins_a_period() {
        let mut deadlines = Deadlines::new(Schedule { period: Duration::from_millis(10), trigger: Some("In") });
        deadlines.restart(at(100));
        assert_eq!((deadlines.arm(at(163)), deadlines.due()), (0, at(173)));
        assert!(!deadlines.is_soon(at(172), Duration::from_millis(5)));
    }
}
