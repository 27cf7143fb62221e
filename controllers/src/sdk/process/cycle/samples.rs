//! When the signals of the controller are shown, and the peaks between two samples of them.

use super::tally::Tally;
use crate::sdk::process::peaks::Watch;
use comms::logic::signals::{Peak, Signal};
use comms::logic::time::Time;
use std::time::Duration;

/// How often a controller without signals looks at its counts, which are shown if they have changed.
const COUNTS_EVERY: Duration = Duration::from_secs(1);

/// The samples of the signals.
#[derive(Debug, Default)]
pub(super) struct Samples {
    /// From one sample to the next; none if the controller has no signals of its own.
    every: Option<Duration>,
    due: Time,
    peaks: Watch,
    /// The counts that were shown last, if the controller has no signals of its own.
    counts: Option<Tally>,
}

impl Samples {
    pub(super) fn new(every: Option<Duration>) -> Self {
        Self { every, ..Self::default() }
    }

    /// Returns whether the controller has signals of its own.
    pub(super) const fn has_own(&self) -> bool {
        self.every.is_some()
    }

    /// Returns whether the next sample is due.
    pub(super) fn is_due(&self, time: Time) -> bool {
        time >= self.due
    }

    /// Begins with an activation: a sample is due at once.
    pub(super) fn restart(&mut self, time: Time) {
        (self.due, self.peaks, self.counts) = (time, Watch::default(), None);
    }

    /// Makes a sample due: the last values of an activation count, and the peaks since the last sample.
    pub(super) const fn finish(&mut self) {
        (self.due, self.counts) = (Time::ZERO, None);
    }

    /// Takes the counts of a controller without signals when a sample is due. Returns whether they are to be shown: they
    /// differ from the last sample, or the activation begins or ends.
    pub(super) fn count(&mut self, counts: Tally, time: Time) -> bool {
        self.due = time + COUNTS_EVERY;
        self.counts.replace(counts) != Some(counts)
    }

    /// Looks at the signals of one calculation. Returns the peaks that their sample does not show, if a sample is due.
    pub(super) fn look(&mut self, signals: &[Signal], time: Time) -> Option<Vec<Peak>> {
        let every = self.every?;
        self.peaks.look(signals, time);
        if !self.is_due(time) {
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

    #[test]
    fn counts_are_shown_at_the_begin_and_the_end_of_an_activation_and_when_they_change() {
        let at = |millis: u64| Time::from_nanos(millis * 1_000_000);
        let lost = |lost| Tally { lost, ..Tally::default() };
        let mut samples = Samples::new(None);
        samples.restart(at(1000));
        assert!(samples.is_due(at(1000)) && samples.count(lost(0), at(1000)));
        assert!(!samples.is_due(at(1999)));
        assert!(samples.is_due(at(2000)) && !samples.count(lost(0), at(2000)), "nothing has changed");
        assert!(!samples.is_due(at(2999)));
        assert!(samples.is_due(at(3000)) && samples.count(lost(2), at(3000)));
        samples.finish();
        assert!(samples.is_due(at(3001)) && samples.count(lost(2), at(3001)), "the last sample");
        samples.restart(at(3002));
        assert!(samples.is_due(at(3002)) && samples.count(lost(0), at(3002)));
    }
}
