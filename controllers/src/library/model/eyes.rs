//! The sight of the laser during an opening: the leaf against the wall, the hinge, and the room that the robot has.

use super::super::distance;
use super::track::Track;
use crate::control::angle::wrapped;
use crate::control::caster::Pose;
use crate::control::clearance::{Memory, clearance};
use crate::control::door::Opening;
use crate::control::landmark::Landmark;
use crate::control::leaf::{Leaf, Wall};
use crate::control::line::horizontal;
use comms::logic::time::Time;
use nalgebra::{Isometry3, Rotation2, UnitQuaternion, Vector2, Vector3};

/// A remembered wall is taken to be this much nearer (m): wheels are wrong by a few per cent.
const REMEMBERED: f64 = 0.03;
/// From this angle (rad) on, the fingers hold the part of the leaf behind them, of this depth and width to each side
/// (m).
const HELD: f64 = 0.3;
const HELD_DEPTH: f64 = 0.16;
const HELD_BESIDE: f64 = 0.3;

/// The sight of the laser.
#[derive(Debug, Default)]
pub(super) struct Eyes {
    wall: Wall,
    landmark: Landmark,
    memory: Memory,
    /// The pose of the base at the last sweep, in the odometry frame.
    swept_from: Option<Pose>,
    /// As seen last.
    leaf: Option<Leaf>,
    /// The last observed distance from the robot to the nearest obstacle (m).
    room: Option<f64>,
}

impl Eyes {
    /// Returns the leaf as it was seen last.
    pub(super) const fn leaf(&self) -> Option<Leaf> {
        self.leaf
    }

    /// Returns the last observed distance from the robot to the nearest obstacle (m).
    pub(super) const fn room(&self) -> Option<f64> {
        self.room
    }

    /// Returns the wall that the leaf is seen against.
    pub(super) const fn wall(&self) -> &Wall {
        &self.wall
    }

    /// Returns how far the base has turned, as the hinge shows it and not the wheels (rad).
    pub(super) fn turned(&self) -> f64 {
        self.landmark.turned()
    }

    /// Searches a sweep (m) for the leaf of an opening. Angles are positive in the direction in which the door opens.
    pub(super) fn look(&mut self, ranges: &[f64], measured: Time, track: &Track, opening: &Opening) -> Option<Leaf> {
        let (sense, askew) = (opening.sense(), opening.askew());
        let place = track.at(measured)?;
        let (at, base_from_tool) = (place.odometry_from_base, place.base_from_tool);
        let at = Pose::new(at.translation.x, at.translation.y, at.rotation.euler_angles().2);
        let from = self.swept_from.replace(at).unwrap_or(at);
        let turned = wrapped(at.z - from.z);
        let by = Rotation2::new(-from.z) * (at.xy() - from.xy());
        let points = distance::points(ranges, std::f64::consts::PI);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), askew) * base_from_tool.rotation;
        let facing = Isometry3::from_parts(base_from_tool.translation, turn);
        // A wrist that turns about the handle comes near the leaf that it holds; how near, the law limits.
        let others: Vec<_> =
            points.iter().filter(|point| askew.abs() < HELD || !is_held(point, &facing)).copied().collect();
        let remembered = clearance(&self.memory.around(&at), &place.joints).map(|room| room - REMEMBERED);
        self.room = clearance(&others, &place.joints).into_iter().chain(remembered).reduce(f64::min);
        let leaf = self.wall.update(&points, &Vector3::new(by.x, by.y, turned), &facing)?;
        let distance = leaf.away + leaf.normal.dot(&base_from_tool.translation.vector.xy());
        self.memory.remember(&points, &leaf.normal, distance, &at);
        self.mark(&leaf, &base_from_tool, &at, opening.left());
        let leaf = Leaf { angle: sense * leaf.angle, hand: sense * leaf.hand, ..leaf };
        self.leaf = Some(leaf);
        self.leaf
    }

    /// Takes where the hinge is by a leaf that the hand holds, for a base at `at` and a hinge to the `left` of the hand.
    fn mark(&mut self, leaf: &Leaf, base_from_tool: &Isometry3<f64>, at: &Pose, left: f64) {
        let Some(radius) = self.wall.radius() else { return };
        let leftward = Vector2::new(-leaf.normal.y, leaf.normal.x);
        let from_base = base_from_tool.translation.vector.xy() + leftward * (left * radius);
        let hinge = at.xy() + Rotation2::new(at.z) * from_base;
        self.landmark.update(&hinge, &at.xy(), self.wall.turned().is_none());
    }
}

/// Returns whether a point (m, base axes) is on the leaf right before the fingers, as they face it.
fn is_held(point: &Vector2<f64>, base_from_facing: &Isometry3<f64>) -> bool {
    let normal = horizontal(&(base_from_facing.rotation * Vector3::z()));
    let from = point - base_from_facing.translation.vector.xy();
    (0.0..HELD_DEPTH).contains(&normal.dot(&from)) && normal.perp(&from).abs() < HELD_BESIDE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_leaf_right_before_the_fingers_is_held() {
        let ahead = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::x()).unwrap();
        let facing = Isometry3::from_parts(Vector3::new(0.5, 0.0, 1.0).into(), ahead);
        for (x, y, held) in
            [(0.55, 0.0, true), (0.55, 0.25, true), (0.55, 0.35, false), (0.7, 0.0, false), (0.4, 0.0, false)]
        {
            assert_eq!(is_held(&Vector2::new(x, y), &facing), held, "{x} {y}");
        }
    }
}
