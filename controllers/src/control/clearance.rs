//! The room around the robot, by what its laser sees.
//!
//! Seen from above: the base is a disc, upper arm, forearm and wrist are capsules. Everything that a ray has met may be as high
//! as the robot. The fingers are left out, for they are there to touch.
//!
//! Source: ours; radii after drawings of the Puma 560.

use super::puma560::{self, Joints};
use nalgebra::Vector2;

/// Of the base (m).
pub const BASE_RADIUS: f64 = 0.31;
/// Of upper arm, forearm and wrist (m).
const RADII: [f64; 3] = [0.09, 0.07, 0.05];
/// The number of points that may be nearer: a ray or two may be wrong.
const STRAYS: usize = 2;

/// Returns the distance from the robot with its joints at `q` (rad) to the `points` (m, base axes) that are nearest; none if
/// there are too few of them.
pub fn clearance(points: &[Vector2<f64>], q: &Joints) -> Option<f64> {
    let [shoulder, elbow, wrist, fingers] = puma560::outline(q).map(|point| point.xy());
    let parts = [(shoulder, elbow, RADII[0]), (elbow, wrist, RADII[1]), (wrist, fingers, RADII[2])];
    let room = |point: &Vector2<f64>| {
        let from_arm = parts.iter().map(|(from, to, radius)| beside(point, from, to) - radius);
        from_arm.fold(point.norm() - BASE_RADIUS, f64::min)
    };
    let mut rooms: Vec<f64> = points.iter().map(room).collect();
    rooms.sort_by(f64::total_cmp);
    rooms.get(STRAYS).copied()
}

/// From a point to a stretch (m).
pub(super) fn beside(point: &Vector2<f64>, from: &Vector2<f64>, to: &Vector2<f64>) -> f64 {
    let along = to - from;
    let share = ((point - from).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (point - from - along * share).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_is_as_far_as_it_is() {
        let q = puma560::door_posture();
        let hand = puma560::forward(&q).base_from_tool.translation.vector;
        // A wall ahead: the wrist ends 10 cm before the grasp point, and is 5 cm thick.
        let wall: Vec<_> = (-100..100).map(|i| Vector2::new(hand.x + 0.15, 0.005 * f64::from(i))).collect();
        let room = clearance(&wall, &q).unwrap();
        assert!((room - (0.15 + 0.10 - 0.05)).abs() < 1e-3, "{room}");
        // One to the right of the base, and two stray points in the middle of it.
        let mut wall: Vec<_> = (0..100).map(|i| Vector2::new(0.3 + 0.005 * f64::from(i), -0.55)).collect();
        let room = clearance(&wall, &q).unwrap();
        assert!((room - (0.3f64.hypot(0.55) - BASE_RADIUS)).abs() < 6e-3, "{room}");
        wall.extend([Vector2::zeros(), Vector2::new(0.1, 0.0)]);
        assert!((clearance(&wall, &q).unwrap() - room).abs() < 6e-3);
        assert_eq!(clearance(&wall[..2], &q), None);
    }
}
