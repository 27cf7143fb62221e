//! Localisation: an extended Kalman filter that fuses the odometry with the tags and the walls.
//!
//! The state is the pose on the floor of the museum: x, y (m) and yaw (rad). A step of the odometry moves the state, and
//! makes it less certain. Each measured distance or bearing is a scalar that corrects the state. A measurement that differs
//! from its expectation by more than three standard deviations is ignored: the sonar has then seen something else.
//! Source: Thrun, Burgard and Fox, Probabilistic Robotics (2005), tables 3.3 and 7.2.

use super::base::Sightings;
use super::museum::{Point, SONAR_MAX, SONARS, TAGS, range, wrapped};
use super::sonar::Walls;
use super::{FRESH, FloorPose, PERIOD};
use controllers::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Signal, Tick,
};
use std::time::Duration;

/// The standard deviation of a step: of its length as a part of the length, and of its turn (rad) for each metre and radian.
const STEP_NOISE: f64 = 0.1;
const TURN_NOISE: f64 = 0.1;
/// The smallest standard deviation of a step (m, rad). Without it, a robot that stands would become so certain that it ignores
/// its sensors later.
const STEP_MIN: f64 = 0.005;
/// The standard deviations of the measurements, a little larger than those of the sensors, since successive measurements
/// of one wall are not independent.
const TAG_DISTANCE_NOISE: f64 = 0.05;
const TAG_BEARING_NOISE: f64 = 0.04;
const WALL_NOISE: f64 = 0.1;
/// How far the robot may turn in a step for its sensors to count (rad). In a quick turn, a measurement that comes a period late
/// would be of another direction.
const TURN_MAX: f64 = 0.03;
/// The square of three standard deviations.
const GATE: f64 = 9.0;
/// The steepest expected distance that counts (m per m or rad).
const SLOPE_MAX: f64 = 2.5;
/// The step of numerical derivatives.
const STEP: f64 = 1e-4;

/// The estimate of a pose.
#[derive(Clone, Debug)]
pub(super) struct Estimate {
    pub(super) pose: FloorPose,
    /// The covariance of x, y and yaw.
    covariance: [[f64; 3]; 3],
}

/// A measured scalar.
struct Measurement {
    /// The difference of the measured value from the expected value.
    difference: f64,
    /// The derivative of the expected value by x, y and yaw.
    slope: [f64; 3],
    /// The variance of the measured value.
    variance: f64,
}

impl Estimate {
    /// Returns the estimate of a robot that stands at a known place.
    pub(super) fn at(pose: FloorPose) -> Self {
        let variance = 0.05 * 0.05;
        let covariance = [[variance, 0.0, 0.0], [0.0, variance, 0.0], [0.0, 0.0, variance]];
        Self { pose, covariance }
    }

    /// Moves by the difference of two poses of the odometry.
    pub(super) fn step(&mut self, from: FloorPose, to: FloorPose) {
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        // The step in the frame of the robot, which both frames of the floor have in common.
        let (ahead, left) = (from.yaw.cos() * dx + from.yaw.sin() * dy, from.yaw.cos() * dy - from.yaw.sin() * dx);
        let turn = wrapped(to.yaw - from.yaw);
        let (sine, cosine) = self.pose.yaw.sin_cos();
        let (x, y) = (cosine * ahead - sine * left, sine * ahead + cosine * left);
        // The derivative of the new pose by the old pose is the identity, except in its last column.
        let jacobian = [[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]];
        let moved = product(&product(&jacobian, &self.covariance), &transposed(&jacobian));
        let way = dx.hypot(dy);
        let variance = |deviation: f64| deviation.powi(2) + STEP_MIN.powi(2);
        let (step_variance, turn_variance) = (variance(STEP_NOISE * way), variance(TURN_NOISE * (way + turn.abs())));
        self.covariance = moved;
        self.covariance[0][0] += step_variance;
        self.covariance[1][1] += step_variance;
        self.covariance[2][2] += turn_variance;
        let FloorPose { x: old_x, y: old_y, yaw } = self.pose;
        self.pose = FloorPose { x: old_x + x, y: old_y + y, yaw: wrapped(yaw + turn) };
    }

    /// Corrects the estimate by the distance and the bearing of a tag.
    pub(super) fn see(&mut self, tag: Point, distance: f64, bearing: f64) {
        let (dx, dy) = (tag.x - self.pose.x, tag.y - self.pose.y);
        let expected = dx.hypot(dy).max(1e-3);
        let (difference, slope) = (distance - expected, [-dx / expected, -dy / expected, 0.0]);
        self.correct(&Measurement { difference, slope, variance: TAG_DISTANCE_NOISE.powi(2) });
        let (dx, dy) = (tag.x - self.pose.x, tag.y - self.pose.y);
        let square = (dx * dx + dy * dy).max(1e-6);
        let difference = wrapped(bearing - (dy.atan2(dx) - self.pose.yaw));
        let slope = [dy / square, -dx / square, -1.0];
        self.correct(&Measurement { difference, slope, variance: TAG_BEARING_NOISE.powi(2) });
    }

    /// Corrects the estimate by the distance of the wall in the direction of a sonar.
    pub(super) fn hear(&mut self, sonar: f64, distance: f64) {
        let expect = |pose: FloorPose| range(Point::new(pose.x, pose.y), pose.yaw + sonar, SONAR_MAX);
        let (pose, expected) = (self.pose, expect(self.pose));
        // Without an echo, or where none is expected, the distance says little.
        if expected >= SONAR_MAX || distance >= SONAR_MAX {
            return;
        }
        let slope = [
            (expect(FloorPose { x: pose.x + STEP, ..pose }) - expected) / STEP,
            (expect(FloorPose { y: pose.y + STEP, ..pose }) - expected) / STEP,
            (expect(FloorPose { yaw: pose.yaw + STEP, ..pose }) - expected) / STEP,
        ];
        // At an edge of a wall, the expected distance jumps. Along a wall, a small error of the direction changes it a lot.
        if slope.iter().all(|part| part.abs() < SLOPE_MAX) {
            self.correct(&Measurement { difference: distance - expected, slope, variance: WALL_NOISE.powi(2) });
        }
    }

    /// Returns the standard deviation of the place.
    pub(super) fn deviation(&self) -> f64 {
        (self.covariance[0][0] + self.covariance[1][1]).max(0.0).sqrt()
    }

    fn correct(&mut self, measurement: &Measurement) {
        let Measurement { difference, slope, variance } = measurement;
        let spread = self.covariance.map(|row| row.iter().zip(slope).map(|(a, b)| a * b).sum::<f64>());
        let expected: f64 = spread.iter().zip(slope).map(|(a, b)| a * b).sum::<f64>() + variance;
        if difference * difference > GATE * expected {
            return;
        }
        let gain = spread.map(|part| part / expected);
        self.pose.x += gain[0] * difference;
        self.pose.y += gain[1] * difference;
        self.pose.yaw = wrapped(self.pose.yaw + gain[2] * difference);
        // The spread is P Hᵀ, and P is symmetric, so (I - K H) P = P - K (P Hᵀ)ᵀ, which stays symmetric.
        for (row, gain) in self.covariance.iter_mut().zip(gain) {
            for (cell, spread) in row.iter_mut().zip(spread) {
                *cell -= gain * spread;
            }
        }
    }
}

fn product(left: &[[f64; 3]; 3], right: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let columns = transposed(right);
    left.map(|row| columns.map(|column| row.iter().zip(column).map(|(a, b)| a * b).sum()))
}

fn transposed(matrix: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let [a, b, c] = *matrix;
    [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]]
}

#[derive(Inputs)]
pub(super) struct LocalisationInputs {
    /// The pose of the odometry.
    #[port("Odometry")]
    odometry: In<FloorPose>,
    /// The walls around the robot.
    #[port("Walls")]
    walls: In<Walls>,
    /// The tags in view.
    #[port("Sightings")]
    sightings: In<Sightings>,
}

#[derive(Outputs)]
pub(super) struct LocalisationOutputs {
    /// Where the robot is in the museum.
    #[port("Pose")]
    pose: Out<FloorPose>,
}

/// Finds out where the robot is. It begins at the dock.
pub(super) struct Localisation {
    estimate: Estimate,
    last: Option<FloorPose>,
    is_turning: bool,
}

impl Controller for Localisation {
    type Inputs = LocalisationInputs;
    type Outputs = LocalisationOutputs;
    const TYPE: &'static str = "Localisation";

    fn about() -> About {
        const DOCK: &[Parameter] = &[
            Parameter::new("x", Kind::Quantity(Quantity::Length, 0.0, 10.0)),
            Parameter::new("y", Kind::Quantity(Quantity::Length, 0.0, 6.0)),
        ];
        About::service("Finds out where in the museum the robot is, by odometry, tags and walls.")
            .remembers()
            .every(PERIOD)
            .triggered_by("Odometry")
            .with(DOCK)
            .signals_every(Duration::from_millis(200))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (x, y) = (arguments.number("x"), arguments.number("y"));
        let estimate = Estimate::at(FloorPose { x, y, yaw: std::f64::consts::FRAC_PI_2 });
        Ok(Self { estimate, last: None, is_turning: false })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &LocalisationInputs, outputs: &mut LocalisationOutputs) -> Progress {
        if let Some(odometry) = inputs.odometry.fresh()
            && let Some(last) = self.last.replace(*odometry)
        {
            self.estimate.step(last, *odometry);
            self.is_turning = wrapped(odometry.yaw - last.yaw).abs() > TURN_MAX;
        }
        if let Some(seen) = inputs.sightings.fresh().filter(|_| !self.is_turning) {
            for ((tag, distance), bearing) in seen.tags.iter().zip(&seen.distances).zip(&seen.bearings) {
                let known = TAGS.iter().zip(0_u32..).find(|(_, number)| (f64::from(*number) - tag).abs() < 0.5);
                known.into_iter().for_each(|(tag, _)| self.estimate.see(*tag, *distance, *bearing));
            }
        }
        if let Some(walls) = inputs.walls.fresh().filter(|_| !self.is_turning) {
            SONARS.iter().zip(&walls.distances).for_each(|(sonar, distance)| self.estimate.hear(*sonar, *distance));
        }
        // Without odometry, the robot may be anywhere: its readers notice the missing pose.
        if inputs.odometry.fresh_within(tick.now, FRESH).is_some() {
            outputs.pose.send(self.estimate.pose);
        }
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        let signal = |name: &str, value| Signal { name: name.to_owned(), unit: "m".into(), value, headline: false };
        let FloorPose { x, y, .. } = self.estimate.pose;
        vec![signal("x", x), signal("y", y), signal("deviation", self.estimate.deviation())]
    }
}

#[cfg(test)]
mod tests {
    use super::super::odometry::moved;
    use super::*;
    use controllers::sdk::Random;

    /// A robot drives in circles, and its wheels slip. The estimate stays within 0.2 m; the odometry alone does not.
    #[test]
    fn the_estimate_stays_near_the_robot() {
        let mut odometry_worst = 0.0_f64;
        for seed in 0..20 {
            let mut random = Random::new(seed);
            let start = FloorPose { x: 1.8, y: 1.5, yaw: 0.3 };
            let (mut truth, mut counted, mut estimate) = (start, start, Estimate::at(start));
            for _ in 0..800 {
                let (left, right) = (0.04, 0.05);
                truth = moved(truth, left * (1.02 + random.normal(0.1)), right * (1.0 + random.normal(0.1)));
                let before = counted;
                counted = moved(counted, left, right);
                estimate.step(before, counted);
                let from = Point::new(truth.x, truth.y);
                for tag in &TAGS[..3] {
                    let bearing = (tag.y - from.y).atan2(tag.x - from.x) - truth.yaw;
                    estimate.see(*tag, from.distance(*tag) + random.normal(0.02), bearing + random.normal(0.02));
                }
                for sonar in SONARS {
                    estimate.hear(sonar, range(from, truth.yaw + sonar, SONAR_MAX) + random.normal(0.02));
                }
                let error = from.distance(Point::new(estimate.pose.x, estimate.pose.y));
                assert!(error < 0.2, "seed {seed}: {error}");
                odometry_worst = odometry_worst.max(from.distance(Point::new(counted.x, counted.y)));
            }
        }
        assert!(odometry_worst > 0.5, "{odometry_worst}: the slip is not seen, so the test shows nothing");
    }
}
