//! A source with a fixed rate, and a monitor for it. They show how a connection changes a rhythm, on any network, at
//! any load.

use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Quantity, Tick,
};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The time from one beat to the next.
const PERIOD: Duration = Duration::from_millis(10);
/// The period of the monitor's signals, and the length of a window in which the largest gap is measured.
const WINDOW: Duration = Duration::from_millis(100);

/// The message of a source, one per period.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Beat {
    /// The number of the beat; each beat has the next number.
    number: u64,
    /// Bytes without meaning, for messages of a certain size.
    ballast: Vec<u8>,
}

impl Message for Beat {
    const TYPE: &'static str = "Beat";
}

/// The outputs of [`RateSource`].
#[derive(Debug, Outputs)]
pub(super) struct SourceOutputs {
    /// Every period.
    #[port("Out")]
    beat: Out<Beat>,
}

/// Sends a numbered beat every 10 ms.
#[derive(Debug)]
pub(super) struct RateSource {
    ballast: usize,
    number: u64,
}

impl Controller for RateSource {
    type Inputs = ();
    type Outputs = SourceOutputs;
    const TYPE: &'static str = "RateSource";

    fn about() -> About {
        const BALLAST: &[Parameter] = &[Parameter::new("ballast", Kind::Quantity(Quantity::Size, 0.0, 1e6)).or("0")];
        About::service("Sends a numbered beat every 10 ms, with this number of extra bytes.")
            .every(PERIOD)
            .with(BALLAST)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "its bounds were checked")]
        let ballast = arguments.number("ballast") as usize;
        Ok(Self { ballast, number: 0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.number = 0;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut SourceOutputs) -> Progress {
        self.number += 1;
        outputs.beat.send(Beat { number: self.number, ballast: vec![0; self.ballast] });
        Progress::Continue
    }
}

/// The inputs of [`RateMonitor`].
#[derive(Debug, Inputs)]
pub(super) struct MonitorInputs {
    /// From a source.
    #[port("In")]
    beat: In<Beat>,
}

/// Reports how steadily beats arrive: how many have arrived, how many were lost on the way, and the largest gap between
/// two.
#[derive(Debug, Default)]
pub(super) struct RateMonitor {
    last: Option<(u64, Time)>,
    received: u64,
    lost: u64,
    /// The end of the present window, and the largest gaps in this window and in the previous one. With both, no
    /// recorder misses a gap.
    window_end: Time,
    gaps: [Duration; 2],
}

impl RateMonitor {
    fn update(&mut self, now: Time, beat: Option<(u64, Time)>) {
        if now >= self.window_end {
            self.window_end = now + WINDOW;
            self.gaps = [self.gaps[1], Duration::ZERO];
        }
        // A gap is counted while it lasts, not only when it is over.
        let until = beat.map_or(now, |(_, arrived)| arrived);
        if let Some((_, arrived)) = self.last {
            self.gaps[1] = self.gaps[1].max(until.since(arrived));
        }
        if let Some((number, arrived)) = beat {
            let before = self.last.map_or(number, |(before, _)| before + 1);
            self.lost += number.saturating_sub(before);
            self.received += 1;
            self.last = Some((number, arrived));
        }
    }
}

impl Controller for RateMonitor {
    type Inputs = MonitorInputs;
    type Outputs = ();
    const TYPE: &'static str = "RateMonitor";

    fn about() -> About {
        About::service("Reports how steadily beats arrive: the number of beats, the number of lost beats, and the largest gap between two \
                        beats.")
            .every(PERIOD)
            .triggered_by("In")
            .signals_every(WINDOW)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &MonitorInputs, (): &mut ()) -> Progress {
        let beat = inputs.beat.fresh().zip(inputs.beat.arrived());
        self.update(tick.now, beat.map(|(beat, arrived)| (beat.number, arrived)));
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        #[expect(clippy::cast_precision_loss, reason = "counts for people")]
        let (received, lost) = (self.received as f64, self.lost as f64);
        let gap = 1e3 * self.gaps[0].max(self.gaps[1]).as_secs_f64();
        let signal = |(name, unit, value, headline): (&str, &str, f64, bool)| Signal {
            name: name.to_owned(),
            unit: unit.to_owned(),
            value,
            headline,
        };
        [("largest gap", "ms", gap, true), ("received", "", received, false), ("lost", "", lost, false)]
            .map(signal)
            .into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::ZERO + Duration::from_millis(millis)
    }

    #[test]
    fn gaps_are_seen_while_they_last_and_forgotten_after_two_windows() {
        let mut monitor = RateMonitor::default();
        let gap = |monitor: &RateMonitor| monitor.gaps[0].max(monitor.gaps[1]).as_millis();
        for number in 0..10 {
            monitor.update(at(10 * number), Some((number, at(10 * number))));
        }
        assert_eq!((gap(&monitor), monitor.received, monitor.lost), (10, 10, 0));
        monitor.update(at(140), None);
        assert_eq!(gap(&monitor), 50);
        monitor.update(at(150), Some((12, at(148))));
        assert_eq!((gap(&monitor), monitor.received, monitor.lost), (58, 11, 2));
        for number in 13..40 {
            monitor.update(at(20 + 10 * number), Some((number, at(20 + 10 * number))));
        }
        assert_eq!((gap(&monitor), monitor.lost), (10, 2));
    }
}
