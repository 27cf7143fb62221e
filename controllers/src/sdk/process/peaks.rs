//! The peaks of signals between samples, measured at every calculation.

use comms::logic::signals::{Peak, Signal};
use comms::logic::time::Time;

/// Watches the signals of one activation.
#[derive(Debug, Default)]
pub(super) struct Watch {
    /// For each signal, the value of the largest magnitude since the last sample, and its time.
    largest: Vec<(Signal, Time)>,
    /// The magnitudes in the last sample.
    shown: Vec<f64>,
}

impl Watch {
    /// Takes the signals of one calculation.
    pub(super) fn look(&mut self, signals: &[Signal], time: Time) {
        let fresh = || signals.iter().map(|signal| (signal.clone(), time)).collect();
        if self.largest.is_empty() {
            self.largest = fresh();
            return;
        }
        let is_same = self.largest.len() == signals.len()
            && self.largest.iter().zip(signals).all(|((known, _), signal)| known.name == signal.name);
        if !is_same {
            (self.largest, self.shown) = (fresh(), Vec::new());
            return;
        }
        for ((largest, at), signal) in self.largest.iter_mut().zip(signals) {
            let is_larger = !largest.value.is_finite() || signal.value.abs() > largest.value.abs();
            if is_larger && signal.value.is_finite() {
                (largest.value, *at) = (signal.value, time);
            }
        }
    }

    /// Returns the peaks that the sample at `time` does not show, and starts again with this
    /// sample. It is the last sample that was taken.
    pub(super) fn sampled(&mut self, sample: &[Signal], time: Time) -> Vec<Peak> {
        let mut missed = Vec::new();
        for (index, (largest, at)) in self.largest.iter().enumerate() {
            let now = sample.get(index).map_or(0.0, |signal| signal.value.abs());
            let before = self.shown.get(index).copied().unwrap_or(0.0);
            if largest.value.is_finite() && largest.value.abs() > now.max(before) {
                missed.push(Peak { signal: largest.clone(), age: time.since(*at) });
            }
        }
        self.shown = sample.iter().map(|signal| signal.value.abs()).collect();
        self.largest.clear();
        missed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn signals(force: f64, angle: f64) -> Vec<Signal> {
        let signal = |name: &str, value| Signal { name: name.into(), unit: String::new(), value, headline: true };
        vec![signal("force", force), signal("angle", angle)]
    }

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn a_peak_between_two_samples_is_told_with_its_time_and_a_shown_one_is_not() {
        let mut watch = Watch::default();
        let mut look = |millis, force, angle| {
            let signals = signals(force, angle);
            watch.look(&signals, at(millis));
            if millis % 10 > 0 { Vec::new() } else { watch.sampled(&signals, at(millis)) }
        };
        let told = |peaks: &[Peak]| {
            peaks.iter().map(|peak| (peak.signal.name.clone(), peak.signal.value, peak.age)).collect::<Vec<_>>()
        };
        assert_eq!(told(&look(0, 1.0, 0.0)), []);
        for (millis, force, angle) in [(1, 2.0, 1.0), (2, -9.0, 2.0), (3, f64::NAN, 3.0), (4, 8.0, 4.0)] {
            look(millis, force, angle);
        }
        let peaks = look(10, 1.0, 10.0);
        assert_eq!(
            told(&peaks),
            [("force".to_owned(), -9.0, Duration::from_millis(8))],
            "the angle grows and is shown"
        );
        look(11, 0.5, 9.0);
        assert_eq!(told(&look(20, 0.0, 1.0)), [], "both fall from what was shown");
    }
}
