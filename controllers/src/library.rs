//! The process types of the paper, as controllers: Appendix A, CompliantMotion, and the plant they work on.
//!
//! Every hand velocity travels in tool axes, so that no controller needs another's idea of the world, and laws can be
//! added. Nobody holds a last velocity: a command older than [`FRESH`] and a sample older than
//! `SENSED` count as none, and what moves is brought to
//! rest.

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

use crate::sdk::{Registry, Tick};
use comms::logic::time::Time;
use std::time::Duration;

/// The largest age of a command: ten periods of the servo group, so that a busy machine's 30 ms do not stop the arm.
pub const FRESH: Duration = Duration::from_millis(100);
/// The largest age of a sample, counted from its measurement by the device: 50 ms for each of three hops, and one period.
const SENSED: Duration = Duration::from_millis(200);
/// The longest wait of a controller for its sensor.
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
    /// Returns whether nothing was `heard` for [`SILENCE`].
    fn is_silent(&mut self, now: Time, heard: bool) -> bool {
        let since = *self.since.get_or_insert(now);
        if heard {
            self.since = Some(now);
        }
        !heard && now.since(since) > SILENCE
    }
}

/// Returns the step that a ramp may take: a calculation that was held up does not make it a jump.
fn ramp_dt(tick: Tick) -> f64 {
    tick.dt().min(0.03)
}

/// Returns a stamp in seconds, as messages between ports have it: a record knows what that is.
fn seconds(stamp: Time) -> f64 {
    stamp.since(Time::ZERO).as_secs_f64()
}

/// Returns what a process leaves to the next.
fn value<T: serde::Serialize>(value: &T) -> Vec<u8> {
    postcard::to_stdvec(value).expect("numbers are always encoded")
}
