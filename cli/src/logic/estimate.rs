//! Estimates how long the rest of some work takes, from the time that the first part took.

use comms::logic::human::span;
use std::time::Duration;

/// After this time, a person wonders whether the command still works.
pub(crate) const PATIENCE: Duration = Duration::from_secs(2);

/// The progress of the work: jobs of one kind after another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Estimate {
    what: &'static str,
    done: usize,
    of: usize,
    /// When the jobs of this kind began.
    begun: Duration,
    /// The states that an exploration within the present job has found.
    states: u32,
}

impl Estimate {
    /// Notes how many jobs of a kind are done.
    pub(crate) fn jobs(&mut self, at: Duration, what: &'static str, done: usize, of: usize) {
        let begun = if self.what == what && self.of == of { self.begun } else { at };
        *self = Self { what, done, of, begun, states: 0 };
    }

    /// Notes how many states an exploration has found.
    pub(crate) fn states(&mut self, count: u32) {
        self.states = count;
    }

    /// Returns the line for a person.
    pub(crate) fn line(&self, elapsed: Duration) -> String {
        let jobs = if self.of > 1 { format!("{} of {} {}", self.done, self.of, self.what) } else { String::new() };
        let states = if self.states >= 100_000 {
            format!("{:.1} million states", f64::from(self.states) / 1e6)
        } else {
            String::new()
        };
        let rest = self.rest(elapsed).map_or(String::new(), |rest| format!("about {} left", span(rest)));
        let time = span(Duration::from_secs(elapsed.as_secs()));
        let parts = [jobs, states, time, rest];
        parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }

    /// Returns how long the remaining jobs of this kind take, in whole seconds; nothing while too few jobs are done.
    fn rest(&self, elapsed: Duration) -> Option<Duration> {
        let (done, left) = (u32::try_from(self.done).ok()?, u32::try_from(self.of.checked_sub(self.done)?).ok()?);
        let each = elapsed.checked_sub(self.begun)?.checked_div(done)?;
        (left > 0).then(|| Duration::from_secs_f64(each.saturating_mul(left).as_secs_f64().round().max(1.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_takes_as_long_as_the_first_part() {
        let at = Duration::from_secs;
        let mut work = Estimate::default();
        assert_eq!(work.line(at(3)), "3 s");
        work.jobs(at(4), "pairs of faults", 0, 90);
        assert_eq!(work.line(at(5)), "0 of 90 pairs of faults, 5 s");
        work.jobs(at(14), "pairs of faults", 30, 90);
        assert_eq!(work.line(at(14)), "30 of 90 pairs of faults, 14 s, about 20 s left");
        work.states(1_250_000);
        assert_eq!(work.line(at(15)), "30 of 90 pairs of faults, 1.2 million states, 15 s, about 22 s left");
        // Jobs of another kind take another time.
        work.jobs(at(40), "sentences", 0, 2);
        assert_eq!(work.line(at(41)), "0 of 2 sentences, 41 s");
    }
}
