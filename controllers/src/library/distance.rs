//! The laser, and the detector for the distance from hand to door.

use super::servoing::{CALIBRATION, calibration};
use super::{SENSED, StuckLaser, Watch};
use crate::control::clearance::{ROOM_MIN, clearance, going_on};
use crate::control::filter::Debounce;
use crate::control::servoing::{self, Calibration, Mark, Way};
use crate::control::{line, puma560};
use crate::message::{ArmState, CameraState, LaserScan, LaserState};
use crate::robot::laser;
use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Random, Tick,
};
use comms::logic::signals::Signal;
use nalgebra::{SVector, Vector2};
use std::time::Duration;

const IN_A_ROW: u32 = 3;
/// The sector that may show the door (deg).
const SECTOR_DEG: f64 = 40.0;
/// Points this close to the line belong to the wall [m]: four deviations of the laser.
const TOLERANCE: f64 = 0.02;
/// If a hand still approaches by more than this from one half of [`SETTLE`] sweeps to the other (m), it has not
/// arrived.
const SETTLED: f64 = 0.002;
const SETTLE: usize = 20;
/// If a mark is further than this from its goal on average (px), the hand has not arrived.
const ARRIVED: f64 = 5.0;
/// The weight of the newest image in that average: a mean over some 20 images.
const IMAGE_SHARE: f64 = 0.05;

/// The least room beside a wall that is assumed to continue where the laser does not see it (m). A base that stands
/// before the handle of a door in a corner has 36 mm, and a sweep is off by up to 10 mm there.
const ROOM_BESIDE: f64 = 0.015;

/// The inputs of [`LaserSensor`].
#[derive(Debug, Inputs)]
pub(super) struct SensorInputs {
    /// The laser.
    #[device("laser/state")]
    state: In<LaserState>,
}

/// The outputs of [`LaserSensor`].
#[derive(Debug, Outputs)]
pub(super) struct SensorOutputs {
    /// The sweep.
    #[port("Out")]
    scan: Out<LaserScan>,
}

/// Publishes the sweeps of the laser.
#[derive(Debug, Default)]
pub(super) struct LaserSensor {
    stuck: StuckLaser,
    watch: Watch,
}

impl Controller for LaserSensor {
    type Inputs = SensorInputs;
    type Outputs = SensorOutputs;
    const TYPE: &'static str = "LaserSensor";

    fn about() -> About {
        About::service("Sends the sweeps of the laser.").every(Duration::from_millis(100)).triggered_by("laser/state")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &SensorInputs, outputs: &mut SensorOutputs) -> Progress {
        let fresh = inputs.state.fresh();
        if let Some(why) = fresh.and_then(|state| self.stuck.problem(&state.ranges)) {
            return Progress::Aborted(why);
        }
        if let Some(state) = fresh {
            outputs.scan.send(LaserScan { ranges: state.ranges.clone() });
        }
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no word from the laser for 1 s".to_owned());
        }
        Progress::Continue
    }
}

/// Returns the points of a sweep within `sector` (rad) to each side of straight ahead, in base axes (m).
pub(super) fn points(ranges: &[f64], sector: f64) -> Vec<Vector2<f64>> {
    ranges
        .iter()
        .zip(0..)
        .map(|(range, ray)| (*range, laser::bearing(ray)))
        .filter(|(range, bearing)| *range < laser::RANGE_MAX && bearing.abs() < sector)
        .map(|(range, bearing)| Vector2::new(laser::AHEAD + range * bearing.cos(), range * bearing.sin()))
        .collect()
}

/// The inputs of [`DistanceThreshold`].
#[derive(Debug, Inputs)]
pub(super) struct ThresholdInputs {
    /// The laser's sweep.
    #[port("In")]
    scan: In<LaserScan>,
    /// The arm's encoders, for where the hand is before the base.
    #[device("arm/state")]
    state: In<ArmState>,
    /// The camera on the hand: a hand that has not arrived in the image has not arrived.
    #[device("camera/state")]
    camera: In<CameraState>,
}

/// Ends when the hand is near the wall in front of the base and no longer approaches it.
#[derive(Debug)]
pub(super) struct DistanceThreshold {
    threshold: f64,
    calibration: Calibration,
    debounce: Debounce,
    recent: Vec<f64>,
    /// The recent error of the marks, column and row (px); none before the first image.
    image: Option<SVector<f64, 8>>,
    random: Random,
    watch: Watch,
}

impl DistanceThreshold {
    fn look(&mut self, image: Option<&CameraState>) {
        let Some([Some(a), Some(b), Some(c), Some(d)]) = image.map(|image| image.marks) else { return };
        let seen = [a, b, c, d].map(|[u, v, depth]| Mark { pixel: [u, v], depth });
        let errors = servoing::errors(&seen, Way::nearer(&seen), &self.calibration);
        // The mean begins at the first image, not at zero. It is a mean of columns and rows, because the noise of an
        // image is not a distance.
        let lately = self.image.get_or_insert(errors);
        *lately += (errors - *lately) * IMAGE_SHARE;
    }

    /// Returns the distance from the hand to the line that the laser sees ahead (m).
    fn distance(&mut self, ranges: &[f64], angles: &[f64; 6]) -> Option<f64> {
        let sector = SECTOR_DEG.to_radians();
        let points = points(ranges, sector);
        let wall = line::fit(&points, TOLERANCE, &mut self.random)?;
        let hand = puma560::forward(&(*angles).into()).base_from_tool.translation.vector;
        Some(wall.distance - wall.normal.dot(&hand.xy()))
    }
}

impl Controller for DistanceThreshold {
    type Inputs = ThresholdInputs;
    type Outputs = ();
    const TYPE: &'static str = "DistanceThreshold";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("threshold", Kind::Quantity(Quantity::Length, 0.05, 2.0)).or("0.45"),
            CALIBRATION[0],
            CALIBRATION[1],
        ];
        About::task(
            "Ends when the hand is at rest near the wall ahead [m], and leaves the distance. The hand must also be at rest in the image \
             of a camera with a focal length [px] at a stand-off [m].",
        )
            .every(Duration::from_millis(100))
            .triggered_by("In")
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            threshold: arguments.number("threshold"),
            calibration: calibration(arguments),
            debounce: Debounce::new(IN_A_ROW),
            recent: Vec::new(),
            image: None,
            random: Random::new(1),
            watch: Watch::default(),
        })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.debounce = Debounce::new(IN_A_ROW);
        self.recent.clear();
        self.image = None;
        self.random = Random::new(1);
        self.watch = Watch::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &ThresholdInputs, (): &mut ()) -> Progress {
        self.look(inputs.camera.fresh());
        let fresh = inputs.scan.fresh();
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no sweep of the laser for 1 s".to_owned());
        }
        let (Some(scan), Some(state)) = (fresh, inputs.state.fresh_within(tick.now, SENSED)) else {
            return Progress::Continue;
        };
        let (around, q) = (points(&scan.ranges, std::f64::consts::PI), state.angles.into());
        if clearance(&around, &q).is_some_and(|room| room < ROOM_MIN) {
            return Progress::Aborted("no room: something is less than 30 mm from the robot".to_owned());
        }
        // A base that moves sideways may meet a wall that its laser does not see.
        if clearance(&going_on(&around), &q).is_some_and(|room| room < ROOM_BESIDE) {
            return Progress::Aborted(
                "no room: a wall that continues at the side of the robot is less than 15 mm away".to_owned(),
            );
        }
        let Some(distance) = self.distance(&scan.ranges, &state.angles) else { return Progress::Continue };
        if self.recent.len() == SETTLE {
            self.recent.remove(0);
        }
        self.recent.push(distance);
        let (before, after) = self.recent.split_at(self.recent.len() / 2);
        let mean = |distances: &[f64]| distances.iter().sum::<f64>() / distances.len().max(1) as f64;
        // Means of ten sweeps are less noisy than a single sweep, for any laser.
        let settled = self.recent.len() == SETTLE && (mean(before) - mean(after)).abs() < SETTLED;
        let arrived = self.image.is_some_and(|errors| errors.amax() < ARRIVED);
        if self.debounce.update(distance < self.threshold && settled && arrived) {
            return Progress::done(&distance);
        }
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        let value = self.recent.last().copied().unwrap_or(f64::NAN);
        vec![Signal { name: "hand to door".into(), unit: "m".into(), value, headline: false }]
    }
}
