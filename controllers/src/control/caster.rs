//! The XR4000's four powered casters: body velocity to wheel rates, and back by least squares.
//!
//! Caster i sits at distance h and bearing beta from the centre; its wheel of radius r trails the steering axis by b.
//! With steering angle phi and body velocity (vx, vy, w) in the base frame:
//! `r rho' = vx cos phi + vy sin phi + w h sin(phi - beta)` and `b (phi' + w) = -vx sin phi + vy cos phi + w h cos(beta - phi)`.
//!
//! Source: derived from the no-slip conditions; same form as Holmberg and Khatib, "Development and control of a holonomic
//! mobile robot for mobile manipulation tasks", IJRR 19(11), 2000. The dimensions are assumptions of ours.

use nalgebra::{SMatrix, SVector, Vector3};
use std::f64::consts::FRAC_PI_4;

/// Wheel radius r (m).
pub const WHEEL_RADIUS: f64 = 0.055;
/// Caster offset b (m).
pub const OFFSET: f64 = 0.020;
/// Distance h of the steering axes from the centre (m).
pub const ARM: f64 = 0.24;

/// Steering angles phi (4) (rad), then rolling angles rho (4) (rad); or their rates.
pub type Casters = SVector<f64, 8>;

/// Returns C (8×3) with `rates = C · (vx, vy, w)` for the steering angles (rad); `wheel_radius` in metres.
pub fn rates_from_body(steering: &[f64; 4], wheel_radius: f64) -> SMatrix<f64, 8, 3> {
    let mut matrix = SMatrix::<f64, 8, 3>::zeros();
    for (i, phi) in steering.iter().enumerate() {
        let beta = FRAC_PI_4 + std::f64::consts::FRAC_PI_2 * i as f64;
        let (s, c) = phi.sin_cos();
        matrix.set_row(i, &nalgebra::RowVector3::new(-s / OFFSET, c / OFFSET, ARM * (beta - phi).cos() / OFFSET - 1.0));
        let turn = ARM * (phi - beta).sin();
        matrix.set_row(i + 4, &nalgebra::RowVector3::new(c / wheel_radius, s / wheel_radius, turn / wheel_radius));
    }
    matrix
}

/// If a steering angle has changed by more than this since the last sample (rad), one linear step is not accurate
/// enough.
const BENT: f64 = 0.15;
/// The length of one step along a curved path (rad), and the largest number of steps.
const BENT_STEP: f64 = 0.05;
const STEPS_MAX: f64 = 64.0;
const ITERATIONS: u32 = 8;
/// The step of a numeric derivative (m, rad).
const NUDGE: f64 = 1e-5;

/// A planar pose: x, y (m), yaw (rad).
pub type Pose = Vector3<f64>;

/// Dead reckoning from the casters' encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    wheel_radius: f64,
    pose: Pose,
    last: Option<Casters>,
}

/// The result of one step of dead reckoning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Motion in base axes since the last step: x, y (m), yaw (rad).
    pub by: Vector3<f64>,
    /// The largest part of an angle's change that no motion of a rigid base explains (rad). If it is large, a wheel
    /// slips or an encoder is wrong.
    pub residual: f64,
}

impl Default for Odometry {
    /// Returns dead reckoning with the wheels that the maker sold.
    fn default() -> Self {
        Self::new(WHEEL_RADIUS)
    }
}

impl Odometry {
    /// Returns dead reckoning that starts at the first update, with wheels of this radius (m).
    pub fn new(wheel_radius: f64) -> Self {
        Self { wheel_radius, pose: Pose::zeros(), last: None }
    }

    /// Returns the pose in the odometry frame, which is the base frame at the first step.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Takes the encoder angles (rad) and returns the motion since the last call. A lost sample does not lose motion,
    /// because the angles are absolute.
    pub fn update(&mut self, angles: &Casters) -> Moved {
        let last = self.last.replace(*angles).unwrap_or(*angles);
        let change = angles - last;
        let steering: [f64; 4] = std::array::from_fn(|i| last[i]);
        // The steering angles in the middle of the step make the linearisation second order.
        let middle = std::array::from_fn(|i| last[i] + 0.5 * change[i]);
        let matrix = rates_from_body(&middle, self.wheel_radius);
        let mut by = least_squares(&matrix, &change);
        let mut left = change - matrix * by;
        let turned = change.fixed_rows::<4>(0).amax();
        if turned > BENT {
            (by, left) = self.bent(&steering, &change, &by);
        }
        self.pose = advance(&self.pose, &by);
        Moved { by, residual: left.amax() }
    }

    /// Finds the motion that explains this change of the angles, if its three parts keep a constant ratio. Casters
    /// swing round within centimetres, so after a gap of 60 ms one linear step does not tell how the base has moved.
    /// Also returns the part of the change that the motion does not explain.
    fn bent(&self, steering: &[f64; 4], change: &Casters, first: &Vector3<f64>) -> (Vector3<f64>, Casters) {
        let left = |by: &Vector3<f64>| change - rolled(steering, by, self.wheel_radius);
        let (mut by, mut best) = (*first, left(first));
        for _ in 0..ITERATIONS {
            let slopes: Vec<Casters> = (0..3)
                .map(|axis| {
                    let mut nudged = by;
                    nudged[axis] += NUDGE;
                    (best - left(&nudged)) / NUDGE
                })
                .collect();
            let step = least_squares(&SMatrix::<f64, 8, 3>::from_columns(&slopes), &best);
            let tries = [1.0, 0.5, 0.25, 0.1].map(|share| by + step * share);
            let better = tries.iter().map(|by| (by, left(by))).find(|(_, left)| left.norm() < best.norm());
            let Some((next, next_left)) = better else { break };
            let gained = best.norm() - next_left.norm();
            (by, best) = (*next, next_left);
            if gained < 1e-6 {
                break;
            }
        }
        (by, best)
    }
}

/// Returns the motion (x, y (m), yaw (rad)) that explains a change of the angles best.
fn least_squares(matrix: &SMatrix<f64, 8, 3>, change: &Casters) -> Vector3<f64> {
    let normal = matrix.transpose() * matrix;
    normal.cholesky().map_or_else(Vector3::zeros, |factor| factor.solve(&(matrix.transpose() * change)))
}

/// Returns by how much the angles change (rad) while the base moves by `by` (x, y (m), yaw (rad)) and its three rates
/// keep a constant ratio.
fn rolled(steering: &[f64; 4], by: &Vector3<f64>, wheel_radius: f64) -> Casters {
    let reach = (by.xy().norm() + by.z.abs() * (ARM + OFFSET)) / OFFSET;
    let steps = (reach / BENT_STEP).ceil().clamp(1.0, STEPS_MAX);
    let (part, mut change) = (by / steps, Casters::zeros());
    let mut step = 0.0;
    while step < steps {
        let at: [f64; 4] = std::array::from_fn(|i| steering[i] + change[i]);
        let half = rates_from_body(&at, wheel_radius) * part * 0.5;
        let middle = std::array::from_fn(|i| at[i] + half[i]);
        change += rates_from_body(&middle, wheel_radius) * part;
        step += 1.0;
    }
    change
}

/// Returns `pose` after a constant twist whose integral is `by` (base axes): the exponential of SE(2).
///
/// Source: Murray, Li, Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994, section 2.3.
pub fn advance(pose: &Pose, by: &Vector3<f64>) -> Pose {
    let turn = by.z;
    let (a, b) = if turn.abs() < 1e-6 {
        (1.0 - turn * turn / 6.0, turn / 2.0)
    } else {
        (turn.sin() / turn, (1.0 - turn.cos()) / turn)
    };
    let (x, y) = (a * by.x - b * by.y, b * by.x + a * by.y);
    let (s, c) = pose.z.sin_cos();
    Pose::new(pose.x + c * x - s * y, pose.y + s * x + c * y, pose.z + turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_closes() {
        // A full turn in 100 exact steps returns to the start, except for rounding.
        let step = Vector3::new(0.01, 0.002, std::f64::consts::TAU / 100.0);
        let pose = (0..100).fold(Pose::zeros(), |pose, _| advance(&pose, &step));
        assert!(pose.xy().norm() < 1e-12);
    }

    /// Four of five samples are lost, or a machine is held up for 60 ms: the casters swing round between two samples.
    #[test]
    fn wheels_tell_the_way_across_gaps() {
        for (gap, most) in [(8, 1e-3), (24, 2e-3), (64, 4e-3)] {
            let (mut truth, mut casters) = (Pose::zeros(), Casters::from_fn(|i, _| 1.5 * i as f64));
            let (mut odometry, mut residual) = (Odometry::default(), 0.0f64);
            odometry.update(&casters);
            for i in 0..4096 {
                let t = f64::from(i) * 1e-3;
                // The base moves to and fro from rest, which turns each caster round.
                let body = Vector3::new(0.12 * (1.6 * t).sin(), 0.05 * t.sin(), 0.1 * (0.7 * t).sin());
                casters += rates_from_body(&std::array::from_fn(|i| casters[i]), WHEEL_RADIUS) * body * 1e-3;
                truth = advance(&truth, &(body * 1e-3));
                if i % gap == gap - 1 {
                    residual = residual.max(odometry.update(&casters).residual);
                }
            }
            let off = odometry.pose() - truth;
            assert!(off.norm() < most && residual < 0.05, "{gap} ms: {off} {residual}");
        }
    }

    #[test]
    fn an_encoder_that_jumps_is_no_motion() {
        let mut odometry = Odometry::default();
        let mut casters = Casters::zeros();
        odometry.update(&casters);
        for jump in [0.3, -0.5, 1.6] {
            casters[0] += jump;
            let moved = odometry.update(&casters);
            assert!(moved.residual > 0.12, "{jump}: {moved:?}");
        }
    }

    #[test]
    fn wheels_tell_the_way() {
        let (mut truth, mut casters) = (Pose::zeros(), Casters::zeros());
        let mut odometry = Odometry::default();
        odometry.update(&casters);
        let mut residual: f64 = 0.0;
        for i in 0..4000 {
            let t = f64::from(i) * 1e-3;
            let body = Vector3::new(0.2 * t.sin(), 0.1, 0.3 * (0.7 * t).cos());
            let rates = rates_from_body(&std::array::from_fn(|i| casters[i]), WHEEL_RADIUS) * body;
            casters += rates * 1e-3;
            truth = advance(&truth, &(body * 1e-3));
            if i % 8 == 7 {
                residual = residual.max(odometry.update(&casters).residual);
            }
        }
        // The steering turns by up to 0.1 rad in one step of 8 ms. The midpoint's error is then below a millimetre over
        // half a metre.
        assert!((odometry.pose() - truth).norm() < 2e-3, "{} {truth}", odometry.pose());
        assert!(residual < 0.02, "{residual}");
    }
}
