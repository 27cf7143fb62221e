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
    /// Norm of what no rigid motion explains, per caster (rad): wheels slip when it is large.
    pub residual: f64,
}

impl Default for Odometry {
    /// With the wheels that the maker sold.
    fn default() -> Self {
        Self::new(WHEEL_RADIUS)
    }
}

impl Odometry {
    /// Returns dead reckoning from the first step on, with wheels of this radius (m).
    pub fn new(wheel_radius: f64) -> Self {
        Self { wheel_radius, pose: Pose::zeros(), last: None }
    }

    /// Returns the pose in the odometry frame, which is the base frame at the first step.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Takes encoder angles; a lost sample costs nothing, for angles are absolute.
    pub fn update(&mut self, angles: &Casters) -> Moved {
        let last = self.last.replace(*angles).unwrap_or(*angles);
        let change = angles - last;
        // The middle of the step makes the linearisation second order.
        let steering = std::array::from_fn(|i| last[i] + 0.5 * change[i]);
        let matrix = rates_from_body(&steering, self.wheel_radius);
        let normal = matrix.transpose() * matrix;
        let by = normal.cholesky().map_or_else(Vector3::zeros, |factor| factor.solve(&(matrix.transpose() * change)));
        self.pose = advance(&self.pose, &by);
        Moved { by, residual: (change - matrix * by).norm() / 4.0 }
    }
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
        // A full turn in 100 exact steps returns to the start but for rounding.
        let step = Vector3::new(0.01, 0.002, std::f64::consts::TAU / 100.0);
        let pose = (0..100).fold(Pose::zeros(), |pose, _| advance(&pose, &step));
        assert!(pose.xy().norm() < 1e-12);
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
        // Steering turns by up to 0.1 rad in one 8 ms step: the midpoint's error, below a millimetre over half a metre.
        assert!((odometry.pose() - truth).norm() < 2e-3, "{} {truth}", odometry.pose());
        assert!(residual < 0.02, "{residual}");
    }
}
