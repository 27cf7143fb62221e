//! Recent samples, interpolated at a time between them.
//!
//! Devices measure at different times, and their samples arrive after different delays. Values of two devices belong
//! together only at the same stamp. Between two samples, the value is interpolated linearly.

use comms::logic::time::Time;
use std::collections::VecDeque;

/// The number of samples that are kept: half a second at 125 Hz.
const CAPACITY: usize = 64;

/// Samples of N numbers, oldest first.
#[derive(Clone, Debug, PartialEq)]
pub struct History<const N: usize> {
    samples: VecDeque<(Time, [f64; N])>,
}

impl<const N: usize> Default for History<N> {
    fn default() -> Self {
        Self { samples: VecDeque::new() }
    }
}

impl<const N: usize> History<N> {
    /// Adds a sample. A sample that is not newer than the last one is ignored.
    pub fn push(&mut self, stamp: Time, value: [f64; N]) {
        if self.samples.back().is_some_and(|(last, _)| *last >= stamp) {
            return;
        }
        if self.samples.len() == CAPACITY {
            self.samples.pop_front();
        }
        self.samples.push_back((stamp, value));
    }

    /// Returns the value at `time`, interpolated linearly between two samples. Before the oldest sample this is the
    /// oldest value, and after the newest sample the newest value. Returns none without samples.
    pub fn at(&self, time: Time) -> Option<[f64; N]> {
        let after = self.samples.iter().position(|(stamp, _)| *stamp >= time);
        let (Some(after), before) = (after, after.and_then(|after| after.checked_sub(1))) else {
            return self.samples.back().map(|(_, value)| *value);
        };
        let (late, to) = self.samples.get(after)?;
        let Some((early, from)) = before.and_then(|before| self.samples.get(before)) else { return Some(*to) };
        let share = time.since(*early).as_secs_f64() / late.since(*early).as_secs_f64();
        Some(std::array::from_fn(|i| from[i] + share * (to[i] - from[i])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn it_knows_what_was_in_between() {
        let at = |ms| Time::ZERO + Duration::from_millis(ms);
        let mut history = History::default();
        assert_eq!(history.at(at(5)), None);
        for ms in [10, 20, 15, 30] {
            history.push(at(ms), [ms as f64, -1.0]);
        }
        // A late sample is left out, and nothing is extrapolated.
        for (ms, wanted) in [(5, 10.0), (10, 10.0), (12, 12.0), (17, 17.0), (29, 29.0), (40, 30.0)] {
            let value = history.at(at(ms)).map_or(f64::NAN, |[value, _]| value);
            assert!((value - wanted).abs() < 1e-9, "{value} at {ms} ms");
        }
        for ms in 31..1000 {
            history.push(at(ms), [0.0; 2]);
        }
        assert_eq!(history.samples.len(), CAPACITY);
    }
}
