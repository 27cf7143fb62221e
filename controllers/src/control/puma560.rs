//! Kinematics of the Puma 560 on its pedestal, as mounted on the base.
//!
//! Frames: `base` is the centre of the mobile base on the floor, x ahead, z up; `tool` is at the grasp point between the
//! fingers, z along the approach, x along the lever when a handle is held.
//!
//! Source: standard Denavit-Hartenberg parameters of Corke and Armstrong-Helouvry, "A search for consensus among model
//! parameters reported for the Puma 560 robot", ICRA 1994, pp. 1608-1613, with the 26.45 in pedestal; joint ranges as
//! published: Lee and Ziegler, "Geometric approach in solving inverse kinematics of PUMA robots", IEEE Trans. Aerospace and
//! Electronic Systems 20(6), 1984. Speed limits are derated service limits of ours, as are mount height and tool length.

use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use std::f64::consts::FRAC_PI_2;

/// Six joint angles (rad) or rates (rad/s).
pub type Joints = Vector6<f64>;

/// Height of the arm's foot above the floor (m).
pub const MOUNT_HEIGHT: f64 = 0.40;
/// Distance from flange to grasp point, along the approach (m).
pub const TOOL_LENGTH: f64 = 0.20;
/// Link offsets d (m).
pub const D: [f64; 6] = [0.67183, 0.0, 0.15005, 0.4318, 0.0, 0.0];
/// Link lengths a (m).
pub const A: [f64; 6] = [0.0, 0.4318, 0.0203, 0.0, 0.0, 0.0];
/// Link twists alpha (rad).
pub const ALPHA: [f64; 6] = [FRAC_PI_2, 0.0, -FRAC_PI_2, FRAC_PI_2, -FRAC_PI_2, 0.0];
/// Lower ends of the joint ranges (deg).
pub const LOWEST_DEG: [f64; 6] = [-160.0, -45.0, -225.0, -110.0, -100.0, -266.0];
/// Upper ends of the joint ranges (deg).
pub const HIGHEST_DEG: [f64; 6] = [160.0, 225.0, 45.0, 170.0, 100.0, 266.0];
/// Largest joint rates (rad/s).
pub const RATES_MAX: [f64; 6] = [1.4, 1.0, 1.8, 3.0, 3.0, 3.0];
/// The posture to work at a door from (deg): hand level, x along the lever, z ahead.
pub const DOOR_POSTURE_DEG: [f64; 6] = [0.0, 45.0, -180.0, 0.0, 45.0, 90.0];

/// The pose of the tool, and its motion with the joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Forward {
    /// Pose of the tool in the base frame (m).
    pub base_from_tool: Isometry3<f64>,
    /// Jacobian (6×6): joint rates to velocity of the grasp point (rows 0-2, m/s) and angular velocity (rows 3-5, rad/s),
    /// both along the axes of the base frame.
    pub jacobian_in_base: Matrix6<f64>,
}

/// Returns the lower ends of the joint ranges (rad).
pub fn lowest() -> Joints {
    Joints::from(LOWEST_DEG.map(f64::to_radians))
}

/// Returns the upper ends of the joint ranges (rad).
pub fn highest() -> Joints {
    Joints::from(HIGHEST_DEG.map(f64::to_radians))
}

/// Returns the posture to work at a door from (rad).
pub fn door_posture() -> Joints {
    Joints::from(DOOR_POSTURE_DEG.map(f64::to_radians))
}

/// Returns pose and Jacobian for joint angles `q` (rad).
pub fn forward(q: &Joints) -> Forward {
    let mut base_from_link = Isometry3::translation(0.0, 0.0, MOUNT_HEIGHT);
    let mut axes = [(Vector3::zeros(), Vector3::zeros()); 6];
    for (i, axis) in axes.iter_mut().enumerate() {
        *axis = (base_from_link.rotation * Vector3::z(), base_from_link.translation.vector);
        base_from_link *= link(i, q[i]);
    }
    let base_from_tool = base_from_link * Translation3::new(0.0, 0.0, TOOL_LENGTH);
    let grasp = base_from_tool.translation.vector;
    let mut jacobian_in_base = Matrix6::zeros();
    for (i, (z, origin)) in axes.iter().enumerate() {
        jacobian_in_base.fixed_view_mut::<3, 1>(0, i).copy_from(&z.cross(&(grasp - origin)));
        jacobian_in_base.fixed_view_mut::<3, 1>(3, i).copy_from(z);
    }
    Forward { base_from_tool, jacobian_in_base }
}

/// Returns the joint rates (rad/s) that move the hand with `twist_in_tool` (m/s, rad/s, tool axes), base at rest. If
/// one rate exceeds [`RATES_MAX`], all are reduced by the same factor.
///
/// Damped least squares with a damping of 0.05: exact to a percent away from singular postures, bounded at them.
/// Source: Nakamura and Hanafusa, J. Dynamic Systems 108, 1986.
pub fn rates_for(q: &Joints, twist_in_tool: &Vector6<f64>) -> Joints {
    let forward = forward(q);
    let rotation = forward.base_from_tool.rotation;
    let linear = rotation * twist_in_tool.fixed_rows::<3>(0);
    let angular = rotation * twist_in_tool.fixed_rows::<3>(3);
    let twist = Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z);
    let jacobian = forward.jacobian_in_base;
    let damped = jacobian * jacobian.transpose() + Matrix6::identity() * 0.05f64.powi(2);
    let rates = damped.cholesky().map_or_else(Joints::zeros, |factor| jacobian.transpose() * factor.solve(&twist));
    let scaling = rates.zip_map(&Joints::from(RATES_MAX), |rate, max| rate.abs() / max).max().max(1.0);
    rates / scaling
}

/// The distance from the wrist's centre to where the fingers begin (m).
pub const WRIST_LENGTH: f64 = 0.10;

/// Returns shoulder, elbow, wrist's centre and where the fingers begin, for joint angles `q` (rad), base frame (m).
pub fn outline(q: &Joints) -> [Vector3<f64>; 4] {
    let mut base_from_link = Isometry3::translation(0.0, 0.0, MOUNT_HEIGHT);
    let origins: [Vector3<f64>; 6] = std::array::from_fn(|i| {
        base_from_link *= link(i, q[i]);
        base_from_link.translation.vector
    });
    let fingers = origins[5] + base_from_link.rotation * Vector3::new(0.0, 0.0, WRIST_LENGTH);
    [origins[0], origins[1], origins[3], fingers]
}

/// Returns the transform of joint `i` at the angle `q` (rad): Rz(q) Tz(d) Tx(a) Rx(alpha).
fn link(i: usize, q: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), q);
    let offset = turn * Vector3::new(A[i], 0.0, 0.0) + Vector3::new(0.0, 0.0, D[i]);
    let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), ALPHA[i]);
    Isometry3::from_parts(offset.into(), turn * twist)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flange position above the shoulder pedestal for a posture in degrees, without mount and tool.
    fn flange(q_deg: [f64; 6]) -> Vector3<f64> {
        let pose = forward(&Joints::from(q_deg.map(f64::to_radians))).base_from_tool;
        (pose * Translation3::new(0.0, 0.0, -TOOL_LENGTH)).translation.vector - Vector3::z() * MOUNT_HEIGHT
    }

    #[test]
    fn published_postures() {
        // The toolbox postures qz, qr and qs by hand from the link lengths; 1e-12 is rounding.
        let zero = Vector3::new(0.4318 + 0.0203, -0.15005, 0.67183 + 0.4318);
        assert!((flange([0.0; 6]) - zero).norm() < 1e-12);
        let ready = Vector3::new(0.0203, -0.15005, 0.67183 + 0.4318 + 0.4318);
        assert!((flange([0.0, 90.0, -90.0, 0.0, 0.0, 0.0]) - ready).norm() < 1e-12);
        let stretch = Vector3::new(0.4318 + 0.4318, -0.15005, 0.67183 - 0.0203);
        assert!((flange([0.0, 0.0, -90.0, 0.0, 0.0, 0.0]) - stretch).norm() < 1e-12);
    }

    #[test]
    fn door_posture_is_level_and_faces_ahead() {
        let rotation = forward(&door_posture()).base_from_tool.rotation;
        assert!((rotation * Vector3::z() - Vector3::x()).norm() < 1e-9);
        assert!((rotation * Vector3::x()).z.abs() < 1e-9);
    }

    #[test]
    fn jacobian_is_the_derivative() {
        // Central differences of step h: truncation h² and rounding 1e-16/h balance near h = 1e-5, at about 1e-10.
        let (q, h) = (Joints::new(0.3, 0.7, -2.5, 0.4, 0.6, 1.2), 1e-5);
        let jacobian = forward(&q).jacobian_in_base;
        for i in 0..6 {
            let step = Joints::ith(i, h);
            let (ahead, behind) = (forward(&(q + step)).base_from_tool, forward(&(q - step)).base_from_tool);
            let v = (ahead.translation.vector - behind.translation.vector) / (2.0 * h);
            let w = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * h);
            assert!((v - jacobian.fixed_view::<3, 1>(0, i)).norm() < 1e-8);
            assert!((w - jacobian.fixed_view::<3, 1>(3, i)).norm() < 1e-8);
        }
    }
}
