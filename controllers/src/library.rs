//! The process types of the paper, as controllers: Appendix A, CompliantMotion, and the plant they work on.
//!
//! Every hand velocity travels in tool axes. So no controller needs the world frame of another controller, and the
//! velocities of several laws can be added. No controller repeats an old velocity: a command older than [`FRESH`] and a
//! sample older than `SENSED` are ignored, and the device is brought to rest.

mod arm;
mod base;
mod compliant;
mod distance;
mod force;
mod fusion;
mod grant;
mod gripper;
mod look;
mod model;
mod motion;
mod press;
mod rate;
mod redundancy;
mod servoing;
mod through;
mod world;

use crate::message::FtState;
use crate::robot::laser::RANGE_MAX;
use crate::sdk::{Registry, Tick};
use comms::logic::time::Time;
use std::time::Duration;

/// The largest age of a command: ten periods of the servo group, so that a delay of 30 ms on a busy machine does not
/// stop the arm.
pub const FRESH: Duration = Duration::from_millis(100);
/// The largest age of a sample, counted from the time at which the device measured it: 50 ms for each of three hops,
/// and one period.
const SENSED: Duration = Duration::from_millis(200);
/// The longest time for which a controller waits for its sensor.
const SILENCE: Duration = Duration::from_secs(1);

/// Returns every type of this library.
pub(crate) fn registry() -> Registry {
    let mut registry = Registry::default();
    registry
        .add::<arm::Puma560Ctrl>()
        .add::<arm::Puma560Joints>()
        .add::<arm::Puma560>()
        .add::<base::Xr4000Ctrl>()
        .add::<base::Xr4000Odometry>()
        .add::<compliant::CompliantCtrl>()
        .add::<distance::LaserSensor>()
        .add::<distance::DistanceThreshold>()
        .add::<force::ForceTorque>()
        .add::<force::ForceSensor>()
        .add::<force::ForceThreshold>()
        .add::<force::HitDetector>()
        .add::<fusion::AddVelocity>()
        .add::<fusion::ConfigCtrl>()
        .add::<gripper::GripperControl>()
        .add::<look::LookAround>()
        .add::<model::ModelBasedCtrl>()
        .add::<motion::LinearTrajectory>()
        .add::<press::PressHandle>()
        .add::<rate::RateMonitor>()
        .add::<rate::RateSource>()
        .add::<redundancy::RedundancyResolution>()
        .add::<servoing::VisualServoing>()
        .add::<through::DriveThrough>()
        .add::<world::DoorWorld>();
    registry
}

/// Notices that a sensor is silent.
#[derive(Clone, Copy, Debug, Default)]
struct Watch {
    since: Option<Time>,
}

impl Watch {
    /// Returns whether nothing has been `heard` for [`SILENCE`].
    fn is_silent(&mut self, now: Time, heard: bool) -> bool {
        let since = *self.since.get_or_insert(now);
        if heard {
            self.since = Some(now);
        }
        !heard && now.since(since) > SILENCE
    }
}

/// Measures how long a device has had orders to rest. The time before the first command of zero does not count, even
/// if that calculation was delayed: a command is only certain from one calculation to the next.
#[derive(Clone, Copy, Debug, Default)]
struct Still {
    since: Option<Time>,
}

impl Still {
    /// Takes whether the device gets an order to rest in this calculation.
    fn update(&mut self, now: Time, rests: bool) {
        self.since = if rests { self.since.or(Some(now)) } else { None };
    }

    /// Returns how long the device has had orders to rest.
    fn lasts(self, now: Time) -> Duration {
        self.since.map_or(Duration::ZERO, |since| now.since(since))
    }
}

/// A sensor hangs if this many further samples are equal to the first one: noise makes each true sample different.
const EQUAL_MAX: u32 = 5;

/// Notices that a noisy sensor repeats the same value, even with new stamps.
#[derive(Clone, Debug)]
struct Stuck<T> {
    last: Option<T>,
    equal: u32,
}

impl<T> Default for Stuck<T> {
    fn default() -> Self {
        Self { last: None, equal: 0 }
    }
}

impl<T: PartialEq + Clone> Stuck<T> {
    /// Takes a new sample. Returns whether so many samples were equal that the sensor hangs.
    fn is_stuck(&mut self, sample: &T) -> bool {
        if self.last.as_ref() == Some(sample) {
            self.equal = self.equal.saturating_add(1);
        } else {
            (self.last, self.equal) = (Some(sample.clone()), 0);
        }
        self.equal >= EQUAL_MAX
    }
}

/// Notices that the wrist sensor repeats the same value.
#[derive(Clone, Debug, Default)]
struct StuckForce(Stuck<[f64; 6]>);

impl StuckForce {
    /// Takes a new sample; returns why the sensor cannot be trusted.
    fn problem(&mut self, state: &FtState) -> Option<String> {
        let ([x, y, z], [a, b, c]) = (state.force, state.torque);
        let is_stuck = self.0.is_stuck(&[x, y, z, a, b, c]);
        is_stuck.then(|| format!("the force sensor hangs: {EQUAL_MAX} samples after one are equal to it"))
    }
}

/// Notices that the laser repeats the same sweep. Sweeps without an echo are ignored, because they are all equal.
#[derive(Clone, Debug, Default)]
struct StuckLaser(Stuck<Vec<f64>>);

impl StuckLaser {
    /// Takes a new sweep; returns why the laser cannot be trusted.
    fn problem(&mut self, ranges: &Vec<f64>) -> Option<String> {
        let has_echo = ranges.iter().any(|range| (0.0..RANGE_MAX).contains(range));
        let is_stuck = self.0.is_stuck(ranges) && has_echo;
        is_stuck.then(|| format!("the laser hangs: {EQUAL_MAX} sweeps after one are equal to it"))
    }
}

/// A larger force on the hand ends the motion (N).
pub(crate) const FORCE_MAX: f64 = 80.0;

/// Returns the time step that a ramp may use (s): a calculation that was delayed does not cause a jump.
fn ramp_dt(tick: Tick) -> f64 {
    tick.dt().min(0.03)
}

/// Returns a stamp in seconds. Messages use this form of time, and records understand it.
fn seconds(stamp: Time) -> f64 {
    stamp.since(Time::ZERO).as_secs_f64()
}
