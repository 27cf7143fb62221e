//! The free room around the robot, from its laser.
//!
//! Seen from above, the base is a disc, and upper arm, forearm and wrist are capsules. Everything that a ray has met
//! may be as high as the robot. The fingers are left out, because they are there to touch things.
//!
//! Source: ours; radii after drawings of the Puma 560.

use super::caster::Pose;
use super::line;
use super::puma560::{self, Joints};
use crate::sdk::Random;
use nalgebra::{Rotation2, Vector2};

/// The least allowed clearance around the robot (m).
pub const ROOM_MIN: f64 = 0.03;
/// The radius of the base (m).
pub const BASE_RADIUS: f64 = 0.31;
/// The radii of upper arm, forearm and wrist (m).
const RADII: [f64; 3] = [0.09, 0.07, 0.05];
/// The number of nearest points that are ignored, because a ray or two may be wrong.
const STRAYS: usize = 2;
/// A point counts as an obstacle if, of the `BESIDE` points before it and the `BESIDE` points after it, at least
/// `TOGETHER` are nearer to it than `NEIGHBOUR` (m). Single rays may be wrong.
const BESIDE: usize = 3;
const TOGETHER: usize = 2;
const NEIGHBOUR: f64 = 0.10;

/// Returns whether the neighbouring rays of a point have met the same thing.
fn is_met(points: &[Vector2<f64>], index: usize) -> bool {
    let around = points.iter().enumerate().skip(index.saturating_sub(BESIDE)).take(2 * BESIDE + 1);
    let near = around.filter(|(other, point)| *other != index && (*point - points[index]).norm() < NEIGHBOUR);
    near.count() >= TOGETHER
}

/// Returns the clearance (m) between the robot, with its joints at `q` (rad), and the nearest `points` (m, base axes,
/// in the order of their rays). The nearest few points are ignored as stray. Returns none if there are too few points.
pub fn clearance(points: &[Vector2<f64>], q: &Joints) -> Option<f64> {
    let [shoulder, elbow, wrist, fingers] = puma560::outline(q).map(|point| point.xy());
    let parts = [(shoulder, elbow, RADII[0]), (elbow, wrist, RADII[1]), (wrist, fingers, RADII[2])];
    let room = |point: &Vector2<f64>| {
        let from_arm = parts.iter().map(|(from, to, radius)| beside(point, from, to) - radius);
        from_arm.fold(point.norm() - BASE_RADIUS, f64::min)
    };
    let met = points.iter().enumerate().filter(|(index, _)| is_met(points, *index));
    let mut rooms: Vec<f64> = met.map(|(_, point)| room(point)).collect();
    rooms.sort_by(f64::total_cmp);
    rooms.get(STRAYS).copied()
}

/// Points this near the plane of the shut door (m) belong to its leaf and its wall, which every later sweep shows
/// again.
const DOOR: f64 = 0.10;

/// The greatest distance of a wall's points from its line (m), and the number of walls to search for.
const TOLERANCE: f64 = 0.02;
const WALLS: u32 = 4;
/// The distance from the middle of the base to its laser, straight ahead (m). A point lies beside the laser if its
/// distance sideways is more than `BESIDE_LASER` times its distance ahead of the laser.
const LASER: f64 = 0.30;
const BESIDE_LASER: f64 = 4.0;
/// A wall leads backwards if the x component of its direction (a unit vector, base axes) is larger than this.
const GOES_BACK: f64 = 0.5;
/// A wall that continues out of sight is extended by `GOES_ON` steps of the length `STEP` (m).
const GOES_ON: u32 = 60;
const STEP: f64 = 0.03;

/// The walls around the robot, as a sweep showed them before the door moved. A base that backs away does not see the
/// walls behind it and to its sides.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Memory {
    /// The remembered points (m, odometry frame).
    points: Option<Vec<Vector2<f64>>>,
}

impl Memory {
    /// Takes a sweep (m, base axes) from a base at `at` (odometry frame) before a shut door. The leaf is the line with
    /// this `normal` and this `distance` (m) from the base. Only the first sweep is remembered.
    pub fn remember(&mut self, points: &[Vector2<f64>], normal: &Vector2<f64>, distance: f64, at: &Pose) {
        if self.points.is_some() {
            return;
        }
        let is_room = |(index, point): &(usize, &Vector2<f64>)| {
            (normal.dot(point) - distance).abs() > DOOR && is_met(points, *index)
        };
        let mut room: Vec<_> = points.iter().enumerate().filter(is_room).map(|(_, point)| *point).collect();
        room.extend(going_on(&room));
        let turn = Rotation2::new(at.z);
        self.points = Some(room.into_iter().map(|point| turn * point + at.xy()).collect());
    }

    /// Returns the remembered points in the axes of a base at `at` (m).
    pub fn around(&self, at: &Pose) -> Vec<Vector2<f64>> {
        let turn = Rotation2::new(-at.z);
        self.points.iter().flatten().map(|point| turn * (point - at.xy())).collect()
    }
}

/// Returns points (m) on the continuation of each wall that leaves the field of view beside the laser. Such a wall is
/// assumed to continue.
pub fn going_on(points: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let (mut left, mut random, mut added) = (points.to_vec(), Random::new(1), Vec::new());
    for _ in 0..WALLS {
        let Some(wall) = line::fit(&left, TOLERANCE, &mut random) else { break };
        let is_on = |point: &&Vector2<f64>| (wall.normal.dot(point) - wall.distance).abs() < TOLERANCE;
        let last = left.iter().filter(is_on).copied().min_by(|a, b| a.x.total_cmp(&b.x));
        let along = Vector2::new(-wall.normal.y, wall.normal.x);
        let back = along * -along.x.signum();
        let is_beside = |last: &Vector2<f64>| last.y.abs() > BESIDE_LASER * (last.x - LASER).max(0.0);
        if let Some(last) = last.filter(|last| along.x.abs() > GOES_BACK && is_beside(last)) {
            added.extend((1..=GOES_ON).map(|step| last + back * (STEP * f64::from(step))));
        }
        left.retain(|point| (wall.normal.dot(point) - wall.distance).abs() > 2.0 * TOLERANCE);
    }
    added
}

/// The distance from a point to the straight stretch between `from` and `to` (m).
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
        // A wall ahead: the wrist ends 10 cm before the grasp point, and has a radius of 5 cm.
        let wall: Vec<_> = (-100..100).map(|i| Vector2::new(hand.x + 0.15, 0.005 * f64::from(i))).collect();
        let room = clearance(&wall, &q).unwrap();
        assert!((room - (0.15 + 0.10 - 0.05)).abs() < 1e-3, "{room}");
        // A wall to the right of the base, and two stray points inside the base.
        let mut wall: Vec<_> = (0..100).map(|i| Vector2::new(0.3 + 0.005 * f64::from(i), -0.55)).collect();
        let room = clearance(&wall, &q).unwrap();
        assert!((room - (0.3f64.hypot(0.55) - BASE_RADIUS)).abs() < 6e-3, "{room}");
        wall.extend([Vector2::zeros(), Vector2::new(0.1, 0.0)]);
        assert!((clearance(&wall, &q).unwrap() - room).abs() < 6e-3);
        assert_eq!(clearance(&wall[..2], &q), None);
        // One ray in ten has an echo.
        let (mut random, mut wall) = (Random::new(3), wall);
        for point in &mut wall {
            *point *= if random.unit() < 0.1 { random.unit() } else { 1.0 };
        }
        assert!((clearance(&wall, &q).unwrap() - room).abs() < 6e-3);
    }

    #[test]
    fn a_wall_that_is_out_of_sight_is_remembered() {
        let q = puma560::door_posture();
        let mut points: Vec<_> = (-50..50).map(|i| Vector2::new(1.5, 0.01 * f64::from(i))).collect();
        points.extend((0..100).map(|i| Vector2::new(0.31 + 0.01 * f64::from(i), 0.8)));
        let mut memory = Memory::default();
        memory.remember(&points, &Vector2::x(), 1.5, &Pose::new(1.0, 2.0, 0.0));
        memory.remember(&[], &Vector2::x(), 1.5, &Pose::zeros());
        // The base has turned away from the wall. No points of the door itself are remembered.
        let around = memory.around(&Pose::new(1.6, 2.4, -1.0));
        let room = clearance(&around, &q).unwrap();
        assert!(around.len() == 160 && (room - (0.4 - BASE_RADIUS)).abs() < 1e-3, "{room}");
        // The wall continues beside and behind its visible part.
        let room = clearance(&memory.around(&Pose::new(0.5, 2.4, 0.0)), &q).unwrap();
        assert!((room - (0.4 - BASE_RADIUS)).abs() < 2e-3, "{room}");
    }
}
