//! A request that is repeated if it has no answer, after a pause that grows.

use comms::logic::time::Time;
use std::time::Duration;

/// The pause before a request is repeated for the first time. Each further pause is twice as long.
const PAUSE_MIN: Duration = Duration::from_millis(200);
/// The longest pause.
const PAUSE_MAX: Duration = Duration::from_secs(5);
/// The largest number of doublings.
const DOUBLINGS_MAX: u32 = 5;
/// If a request has waited this long, a server had accepted it. So its failure begins a new count.
const KEPT_AFTER: Duration = Duration::from_secs(10);

/// The state of a request.
#[derive(Debug, Default)]
pub(crate) struct Retry {
    asked: Option<Time>,
    due: Option<Time>,
    failures: u32,
}

impl Retry {
    /// Records that the request was sent.
    pub(crate) fn asked(&mut self, now: Time) {
        (self.asked, self.due) = (Some(now), None);
    }

    /// Records that the request has no answer; returns how often this has happened in a row.
    pub(crate) fn failed(&mut self, now: Time) -> u32 {
        let is_kept = self.asked.is_some_and(|asked| now >= asked + KEPT_AFTER);
        self.failures = if is_kept { 1 } else { self.failures.saturating_add(1) };
        let pause = PAUSE_MIN * 2_u32.pow((self.failures - 1).min(DOUBLINGS_MAX));
        self.due = Some(now + pause.min(PAUSE_MAX));
        self.failures
    }

    /// Returns whether the request has to be repeated now.
    pub(crate) fn is_due(&self, now: Time) -> bool {
        self.due.is_some_and(|due| now >= due)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn pauses_grow_up_to_a_limit() {
        let (mut retry, mut now) = (Retry::default(), 0);
        for (failures, pause) in (1..).zip([200, 400, 800, 1600, 3200, 5000, 5000]) {
            retry.asked(at(now));
            assert!(!retry.is_due(at(now + 60_000)), "it waits for an answer");
            assert_eq!(retry.failed(at(now)), failures);
            assert!(!retry.is_due(at(now + pause - 1)) && retry.is_due(at(now + pause)), "{failures}");
            now += pause;
        }
        retry.asked(at(now));
        assert_eq!(retry.failed(at(now + 10_000)), 1, "a server has kept it");
    }
}
