//! A device that reports wrong values for a while: it is silent, repeats a sample, or stamps old values as new.

use crate::message::{ArmState, BaseState, CameraState, FtState, GripperState, LaserState};
use crate::sdk::Arguments;
use comms::logic::time::Time;

/// The devices, in the order in which the world measures them.
const DEVICES: [&str; 6] = ["arm", "base", "force", "gripper", "laser", "camera"];

/// How a device behaves while it fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum How {
    /// The device sends nothing.
    Silent,
    /// The device repeats its last sample, with the old stamp.
    Repeats,
    /// The device sends its last values as if they were measured now.
    Restamps,
}

/// A device that fails, once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Failing {
    /// The index of the device in [`DEVICES`]; if it is none, no device fails.
    device: Option<usize>,
    how: How,
    /// The start of the failure: a time after the start (s) or an angle of the door (rad), whichever comes first. A
    /// negative value never starts a failure.
    at: (f64, f64),
    /// The duration (s).
    span: f64,
}

impl Failing {
    /// Returns the failure that the arguments of a world describe.
    pub(super) fn new(arguments: &Arguments) -> Self {
        let device = DEVICES.iter().position(|device| *device == arguments.text("fails"));
        let how = match arguments.text("fails_how") {
            "repeats" => How::Repeats,
            "restamps" => How::Restamps,
            _ => How::Silent,
        };
        let at = (arguments.number("fails_at"), arguments.number("fails_door"));
        Self { device, how, at, span: arguments.number("fails_for") }
    }
}

/// A sample with the stamp of its device.
pub(super) trait Stamped: Clone {
    /// Returns when it was measured.
    fn stamp(&self) -> Time;
    /// Returns the same values with another stamp.
    fn stamped(self, stamp: Time) -> Self;
}

macro_rules! stamped {
    ($($name:ident),+) => {$(
        impl Stamped for $name {
            fn stamp(&self) -> Time {
                self.stamp
            }

            fn stamped(self, stamp: Time) -> Self {
                Self { stamp, ..self }
            }
        }
    )+};
}

stamped!(ArmState, BaseState, FtState, GripperState, LaserState, CameraState);

/// The state of the device that fails: its last sample, and the time at which it began to fail.
#[derive(Clone, Debug)]
pub(super) struct Failure {
    failing: Failing,
    since: Option<f64>,
    now: f64,
}

impl Failure {
    /// Returns the state of a world in which nothing has failed yet.
    pub(super) fn new(failing: Failing) -> Self {
        Self { failing, since: None, now: 0.0 }
    }

    /// Takes the time since the start (s) and the angle of the door (rad).
    pub(super) fn update(&mut self, time: f64, door: f64) {
        let (at, angle) = self.failing.at;
        self.now = time;
        if self.since.is_none() && (at >= 0.0 && time >= at || angle >= 0.0 && door >= angle) {
            self.since = Some(time);
        }
    }

    /// Returns the sample that the device with index `device` sends instead of the measured one; `last` is its last
    /// sample.
    pub(super) fn of<T: Stamped>(&self, device: usize, measured: T, last: &mut Option<T>) -> Option<T> {
        let fails =
            self.failing.device == Some(device) && self.since.is_some_and(|since| self.now - since < self.failing.span);
        if !fails {
            *last = Some(measured.clone());
            return Some(measured);
        }
        match self.failing.how {
            How::Silent => None,
            How::Repeats => last.clone(),
            How::Restamps => last.clone().map(|last| last.stamped(measured.stamp())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::PARAMETERS;
    use super::*;
    use std::time::Duration;

    fn sample(ms: u64) -> GripperState {
        GripperState { stamp: Time::ZERO + Duration::from_millis(ms), width: ms as f64, force: 0.0 }
    }

    /// The samples of a gripper that fails from 0.2 s to 0.4 s at 100, 200, 300, 400 and 500 ms: value and stamp (ms).
    fn sent(how: &str) -> Vec<Option<(f64, u128)>> {
        let given = ["fails=gripper", how, "fails_at=0.2", "fails_for=0.2"];
        let arguments = Arguments::parse(PARAMETERS, &given).unwrap();
        let (mut failure, mut last) = (Failure::new(Failing::new(&arguments)), None);
        let send = |ms: u64| {
            failure.update(ms as f64 / 1e3, 0.0);
            let sent = failure.of(3, sample(ms), &mut last)?;
            Some((sent.width, sent.stamp.since(Time::ZERO).as_millis()))
        };
        [100, 200, 300, 400, 500].map(send).to_vec()
    }

    #[test]
    fn a_device_is_silent_repeats_itself_or_stamps_old_values_as_new() {
        let (before, after) = (Some((100.0, 100)), [Some((400.0, 400)), Some((500.0, 500))]);
        for (how, failing) in [
            ("fails_how=silent", [None, None]),
            ("fails_how=repeats", [Some((100.0, 100)), Some((100.0, 100))]),
            ("fails_how=restamps", [Some((100.0, 200)), Some((100.0, 300))]),
        ] {
            assert_eq!(sent(how), [[before].as_slice(), &failing, &after].concat(), "{how}");
        }
    }

    #[test]
    fn no_device_fails_unless_told_to() {
        let arguments = Arguments::parse::<&str>(PARAMETERS, &[]).unwrap();
        let mut failure = Failure::new(Failing::new(&arguments));
        failure.update(1e6, 3.0);
        for device in 0..6 {
            assert_eq!(failure.of(device, sample(70), &mut None), Some(sample(70)), "{device}");
        }
    }
}
