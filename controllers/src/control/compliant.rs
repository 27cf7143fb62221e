//! Compliance: the hand gives way to what it feels.
//!
//! An admittance without inertia. Stable while `stiffness · gain · delay < 0.5`: 6000 N/m · 1/600 m/Ns · 24 ms = 0.24.
//!
//! Source: Whitney, "Force feedback control of manipulator fine motions", J. Dynamic Systems 99, 1977 (damping control);
//! gains found with the door model.

use nalgebra::{Vector3, Vector6};

const ACROSS: f64 = 600.0;
const UP: f64 = 1200.0;
const TURN: f64 = 0.12;
const LINEAR_MAX: f64 = 0.15;
const ANGULAR_MAX: f64 = 0.5;

/// Where another law leads the hand, so that compliance leaves that direction alone. Unit vectors in tool axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guide {
    /// The way the hand is led.
    pub tangent_in_tool: Vector3<f64>,
    /// Up.
    pub up_in_tool: Vector3<f64>,
    /// Whether the hand may give way upwards and downwards.
    pub upward: bool,
}

/// Returns the velocity (m/s, rad/s, tool axes) that gives way to `wrench_in_tool` (N, Nm, on the hand): in every direction,
/// or only across the guide's.
pub fn velocity(wrench_in_tool: &Vector6<f64>, guide: Option<&Guide>) -> Vector6<f64> {
    let force: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(0).into();
    let torque: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(3).into();
    let linear = match guide {
        None => force / ACROSS,
        Some(guide) => {
            let across = guide.up_in_tool.cross(&guide.tangent_in_tool);
            let upward =
                if guide.upward { guide.up_in_tool * guide.up_in_tool.dot(&force) / UP } else { Vector3::zeros() };
            across * across.dot(&force) / ACROSS + upward
        }
    };
    let (linear, angular) = (linear.cap_magnitude(LINEAR_MAX), (torque * TURN).cap_magnitude(ANGULAR_MAX));
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_way_along_the_force() {
        let v = velocity(&Vector6::new(6.0, 0.0, 0.0, 0.0, 1.0, 0.0), None);
        assert!((v - Vector6::new(0.01, 0.0, 0.0, 0.0, 0.12, 0.0)).norm() < 1e-12);
        assert!(
            (velocity(&Vector6::new(0.0, 1e4, 0.0, 0.0, 0.0, 1e4), None).norm() - 0.15f64.hypot(0.5)).abs() < 1e-12
        );
    }

    #[test]
    fn leaves_the_guided_direction_alone() {
        let guide = Guide { tangent_in_tool: -Vector3::z(), up_in_tool: Vector3::y(), upward: false };
        let v = velocity(&Vector6::new(6.0, 6.0, 60.0, 0.0, 0.0, 0.0), Some(&guide));
        assert!((v - Vector6::new(0.01, 0.0, 0.0, 0.0, 0.0, 0.0)).norm() < 1e-12);
    }
}
