//! When the signals of the controller are shown, and the peaks between two samples of them.

use crate::sdk::process::peaks::Watch;
use comms::logic::signals::{Peak, Signal};
use comms::logic::time::Time;
use std::time::Duration;

/// The samples of the signals.
#[derive(Debug, Default)]
pub(super) struct Samples {
    /// From one sample to the next; none if the controller shows no signals.
    every: Option<Duration>,
    due: Time,
    peaks: Watch,
}

impl Samples {
    pub(super) fn new(every: Option<Duration>) -> Self {
        Self { every, ..Self::default() }
    }

    /// Returns whether the controller shows signals.
    pub(super) const fn are_shown(&self) -> bool {
        self.every.is_some()
    }

    /// Begins with an activation: a sample is due at once.
    pub(super) fn restart(&mut self, time: Time) {
        (self.due, self.peaks) = (time, Watch::default());
    }

    /// Makes a sample due: the last values of an activation count, and the peaks since the last sample.
    pub(super) const fn finish(&mut self) {
        self.due = Time::ZERO;
    }

    /// Looks at the signals of one calculation. Returns the peaks that their sample does not show, if a sample is due.
    pub(super) fn look(&mut self, signals: &[Signal], time: Time) -> Option<Vec<Peak>> {
        let every = self.every?;
        self.peaks.look(signals, time);
        if time < self.due {
            return None;
        }
        self.due = time + every;
        Some(self.peaks.sampled(signals, time))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_due_at_the_begin_and_the_end_of_an_activation() {
        let at = |millis: u64| Time::from_nanos(millis * 1_000_000);
        let force = |value| [Signal { name: "force".into(), unit: "N".into(), value, headline: true }];
        let mut samples = Samples::new(Some(Duration::from_millis(100)));
        samples.restart(at(1000));
        assert_eq!(samples.look(&force(1.0), at(1000)), Some(Vec::new()));
        assert_eq!(samples.look(&force(9.0), at(1050)), None);
        let peak = Peak { signal: force(9.0)[0].clone(), age: Duration::from_millis(50) };
        assert_eq!(samples.look(&force(2.0), at(1100)), Some(vec![peak]));
        assert_eq!(samples.look(&force(2.0), at(1150)), None);
        samples.finish();
        assert!(samples.look(&force(2.0), at(1160)).is_some());
        assert_eq!(Samples::new(None).look(&force(1.0), at(1000)), None);
    }
}
