//! Pressing a lever handle that the hand already holds.
//!
//! The hand follows the arc of a nominal lever and rolls with it, giving way to every force but the vertical one.
//!
//! Source: ours; constants found with the door model.

use nalgebra::{Isometry3, Vector3, Vector6};

/// Speed of the hand (m/s).
pub const SPEED: f64 = 0.035;
/// From the lever's axis to where it is held (m), nominally.
pub const LEVER: f64 = 0.09;
/// How far down is pressed (m).
pub const DEPTH: f64 = 0.050;
const STOP_DEPTH: f64 = 0.030;
const STOP_FORCE: f64 = 40.0;
const LINEAR_GAIN: f64 = 1.0 / 900.0;
const ANGULAR_GAIN: f64 = 0.05;
/// The fingers slip a little on the lever, so the hand rolls less than the lever turns.
const ROLL: f64 = 0.9;

/// The state of one pressing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Press {
    height: f64,
    lever: Vector3<f64>,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Down {
    /// Velocity of the hand (m/s, rad/s, tool axes).
    pub twist_in_tool: Vector6<f64>,
    /// How far the hand has gone down (m).
    pub depth: f64,
    /// Whether the lever is down: deep enough, or against its stop.
    pub finished: bool,
}

impl Press {
    /// Begins with the hand at `base_from_tool`, its x axis along the lever from the lever's axis outwards.
    pub fn new(base_from_tool: &Isometry3<f64>) -> Self {
        let along = base_from_tool.rotation * Vector3::x();
        let lever = Vector3::new(along.x, along.y, 0.0).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        Self { height: base_from_tool.translation.z, lever }
    }

    /// Takes the pose of the hand and the wrench on it (N, Nm, tool axes).
    pub fn update(&self, base_from_tool: &Isometry3<f64>, wrench_in_tool: &Vector6<f64>) -> Down {
        let rotation = base_from_tool.rotation;
        let depth = self.height - base_from_tool.translation.z;
        let (s, c) = (depth / LEVER).clamp(0.0, 0.95).asin().sin_cos();
        let force: Vector3<f64> = rotation * wrench_in_tool.fixed_rows::<3>(0);
        let torque: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(3).into();
        let give = Vector3::new(force.x, force.y, 0.0) * LINEAR_GAIN;
        let linear = rotation.inverse() * (-Vector3::z() * (SPEED * c) - self.lever * (SPEED * s) + give);
        let axis = self.lever.cross(&-Vector3::z());
        let angular = rotation.inverse() * (axis * (ROLL * SPEED / LEVER)) + torque * ANGULAR_GAIN;
        Down {
            twist_in_tool: Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z),
            depth,
            finished: depth > DEPTH || (force.z.abs() > STOP_FORCE && depth > STOP_DEPTH),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn follows_the_lever() {
        // Without forces the grasp point stays on a circle of the nominal radius about the lever's axis.
        let mut pose = Isometry3::translation(0.3, 0.0, 1.0);
        let (press, axis) = (Press::new(&pose), Vector3::new(0.3 - LEVER, 0.0, 1.0));
        let (mut turned, mut finished, dt) = (0.0, false, 1e-3);
        for _ in 0..3000 {
            let down = press.update(&pose, &Vector6::zeros());
            finished = down.finished;
            if finished {
                break;
            }
            let v: Vector3<f64> = pose.rotation * down.twist_in_tool.fixed_rows::<3>(0);
            let w: Vector3<f64> = pose.rotation * down.twist_in_tool.fixed_rows::<3>(3) * dt;
            pose.translation.vector += v * dt;
            pose.rotation = UnitQuaternion::from_scaled_axis(w) * pose.rotation;
            turned += w.norm();
        }
        assert!(finished);
        // Euler steps of 1 ms leave the circle by at most the arc times half a step's angle: 0.02 mm.
        assert!(((pose.translation.vector - axis).norm() - LEVER).abs() < 2e-5);
        assert!((turned - ROLL * (DEPTH / LEVER).asin()).abs() < 0.01, "{turned}");
    }
}
