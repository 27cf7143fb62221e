//! Where base and arm were, on the time of their measurements, in one frame even if the odometry restarts.

use crate::control::history::History;
use crate::control::puma560::{self, Joints};
use comms::logic::time::Time;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// No base moves as far as this between two calculations (m).
const JUMP: f64 = 0.03;

/// Where base and arm were.
#[derive(Debug, Default)]
pub(super) struct Track {
    anchor: Anchor,
    poses: History<3>,
    joints: History<6>,
}

/// Poses of base and hand, and the posture of the arm, at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) odometry_from_base: Isometry3<f64>,
    pub(super) base_from_tool: Isometry3<f64>,
    /// The angles of the arm (rad).
    pub(super) joints: Joints,
}

impl Track {
    /// Takes a pose of the base from the odometry, measured at `time`; `dt` (s) is the time since the last one was taken.
    pub(super) fn push_pose(&mut self, time: Time, pose: &[f64; 3], dt: f64) {
        let ours = self.anchor.ours(&planar(pose), dt);
        let turned = ours.rotation.euler_angles().2;
        self.poses.push(time, [ours.translation.x, ours.translation.y, turned]);
    }

    /// Takes the angles of the arm (rad), measured at `time`.
    pub(super) fn push_joints(&mut self, time: Time, angles: [f64; 6]) {
        self.joints.push(time, angles);
    }

    /// Returns where base and hand were at `time`.
    pub(super) fn at(&self, time: Time) -> Option<Place> {
        let (pose, angles) = (self.poses.at(time)?, self.joints.at(time)?);
        let joints: Joints = angles.into();
        let base_from_tool = puma560::forward(&joints).base_from_tool;
        Some(Place { odometry_from_base: planar(&pose), base_from_tool, joints })
    }

    /// Returns how often the odometry has restarted.
    pub(super) const fn jumps(&self) -> u32 {
        self.anchor.jumps
    }
}

/// Keeps poses of the odometry consistent when the odometry restarts.
#[derive(Clone, Copy, Debug, Default)]
struct Anchor {
    ours_from_odometry: Option<Isometry3<f64>>,
    last: Option<Isometry3<f64>>,
    jumps: u32,
}

impl Anchor {
    fn ours(&mut self, odometry_from_base: &Isometry3<f64>, dt: f64) -> Isometry3<f64> {
        let mut ours = self.ours_from_odometry.unwrap_or_default() * odometry_from_base;
        if let Some(last) = self.last {
            let step = last.inv_mul(&ours);
            let most = JUMP + dt;
            if step.translation.vector.norm() > most || step.rotation.angle() > most {
                // The odometry was started again: the base has not moved, but the frame of the odometry has changed.
                self.ours_from_odometry = Some(last * odometry_from_base.inverse());
                self.jumps += 1;
                ours = last;
            }
        }
        self.last = Some(ours);
        ours
    }
}

/// A pose on the floor: x, y (m), yaw (rad).
fn planar([x, y, yaw]: &[f64; 3]) -> Isometry3<f64> {
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *yaw);
    Isometry3::from_parts(Vector3::new(*x, *y, 0.0).into(), yaw)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The base continues from where it was when the odometry begins again at zero.
    #[test]
    fn a_restart_of_the_odometry_does_not_move_the_base() {
        let (mut track, mut at) = (Track::default(), Time::ZERO);
        let mut drive = |track: &mut Track, from: f64| {
            for step in 0..100 {
                at = at + std::time::Duration::from_millis(20);
                track.push_pose(at, &[from + 1e-3 * f64::from(step), 0.0, 0.0], 0.02);
                track.push_joints(at, puma560::door_posture().into());
            }
            track.at(at).map(|place| place.odometry_from_base.translation.x).unwrap_or_default()
        };
        let before = drive(&mut track, 2.0);
        assert!((before - 2.099).abs() < 1e-9 && track.jumps() == 0, "{before}");
        // The step of the restart itself is lost.
        let after = drive(&mut track, 0.0);
        assert!((after - before - 0.099).abs() < 1e-9 && track.jumps() == 1, "{after}");
    }
}
