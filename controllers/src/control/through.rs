//! The drive through an open door: the robot backs away from the handle, folds the arm, drives around the leaf's edge,
//! looks, and drives straight through.
//!
//! The door is measured twice: beside the leaf, for the way around it, and in front of the opening, at rest, for the
//! way through. On the way through each sweep corrects the line until the jambs are beside the laser. From there on the
//! robot drives straight on.
//!
//! Source: ours.

use super::angle::wrapped;
use super::caster::Pose;
use super::clearance::{BASE_RADIUS, ROOM_MIN, clearance};
use super::passage::{Corridor, Doorway, Way, corridor};
use super::puma560::Joints;
use super::ramp::towards_together;
use super::redundancy::{BASE_ACCELERATION_MAX, Rates};
use nalgebra::{Isometry2, Isometry3, Point2, Rotation2, Vector2, Vector3};

/// The distance by which the hand backs away from the handle (m).
const BACK: f64 = 0.25;
/// The arm above the base's disc (deg): upper arm up, forearm above it, 1.9 m high. Joint 6 keeps its angle.
const FOLDED_DEG: [f64; 5] = [0.0, 110.0, -140.0, 0.0, -95.0];
const FOLD_SPEED: f64 = 0.7;
const FOLD_GAIN: f64 = 2.0;
/// Joints this near their goal are there (rad).
const FOLDED: f64 = 0.03;
/// The base: its speed (m/s, rad/s), its gain towards a place (1/s), and the share of its acceleration that it uses.
const SPEED: f64 = 0.25;
const SLOW: f64 = 0.15;
const TURN_SPEED: f64 = 0.40;
const GAIN: f64 = 1.2;
const GENTLE: f64 = 0.35;
/// The distance at which a place is reached (m), the angle at which a heading is reached (rad), and the distance at
/// which a place on the way is passed (m).
const THERE: f64 = 0.015;
const TURNED: f64 = 0.02;
const PASSED: f64 = 0.12;
/// The distance to the place on its way that the base steers for (m).
const AHEAD: f64 = 0.35;
/// The number of sweeps that are measured in front of the opening.
const LOOKS: u32 = 10;
/// The weight of each sweep in the estimate of a corridor.
const SHARE: f64 = 0.2;
/// How much more room on each side than the estimate a corridor in a later sweep may have (m).
const TOLERANCE: f64 = 0.02;
/// The remaining distance (m) at which the jambs are beside the laser. From there the base drives straight on.
const BLIND: f64 = 1.05;
/// The greatest turn (rad) of a leaf that stays in place after the hand has let go, and the number of sweeps that it
/// may be out of sight.
const STAYS: f64 = 0.10;
const UNSEEN_MAX: u32 = 10;
/// The first measurement does not see the latch. It reports "too narrow" only if more than this is missing (m).
const GUESS: f64 = 0.03;

/// The measurements of one sweep of the laser.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// The points that the rays have met (m, base axes).
    pub points: Vec<Vector2<f64>>,
    /// The pose of the base at the time of the sweep, in the odometry frame.
    pub from: Pose,
    /// The joint angles at the time of the sweep (rad).
    pub joints: Joints,
}

/// A reason why the robot cannot drive through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Failure {
    /// The leaf does not stay where it was let go.
    Closes,
    /// The base would pass with less than the margin. The first value is the missing width (m). The
    /// second value is the angle to which the leaf has to be open (rad). None if no angle is
    /// enough.
    Narrow(f64, Option<f64>),
    /// The two sides of the opening are not seen.
    Unseen,
    /// Something is too near the robot.
    Room,
}

/// The result of a calculation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Base x, y (m/s), yaw (rad/s), base axes, then joints (rad/s).
    Move(Rates),
    /// The base stands on the other side.
    Through,
    /// The base cannot continue.
    Failed(Failure),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Back { to: Vector2<f64>, heading: f64 },
    Fold { at: Vector2<f64>, heading: f64 },
    Around,
    Face,
    Look { seen: u32, unseen: u32 },
    Pass,
}

/// A drive through one door. Places are in the odometry frame.
#[derive(Clone, Debug)]
pub struct Drive {
    margin: f64,
    door: Doorway,
    way: Way,
    stage: Stage,
    /// The estimated distance from the way to the nearest point on each side (m).
    room: Option<f64>,
    /// In how many sweeps in a row the leaf was not seen.
    unseen: u32,
    base: [f64; 3],
}

impl Drive {
    /// Returns the drive through `door` (m, odometry frame). The base is at `base` (odometry frame), and the hand at
    /// `base_from_tool`. The drive keeps `margin` (m) to each side.
    ///
    /// # Errors
    /// If the door is certainly too narrow, or not open far enough.
    pub fn new(door: Doorway, base: &Pose, base_from_tool: &Isometry3<f64>, margin: f64) -> Result<Self, Failure> {
        let missing = 2.0 * (BASE_RADIUS + margin - door.room());
        if missing > GUESS {
            return Err(Failure::Narrow(missing, door.angle_needed(BASE_RADIUS, margin)));
        }
        let approach = Rotation2::new(base.z) * (base_from_tool.rotation * Vector3::z()).xy();
        let stage = Stage::Back { to: base.xy() - approach * BACK, heading: base.z };
        Ok(Self { margin, door, way: door.way(), stage, room: None, unseen: 0, base: [0.0; 3] })
    }

    /// Returns the free width on each side of the base on its way through (m), once it is measured.
    pub fn clearance(&self) -> Option<f64> {
        self.room.map(|room| room - BASE_RADIUS)
    }

    /// Returns the number of the present stage of the drive, from 1 to 6.
    pub fn stage(&self) -> u8 {
        match self.stage {
            Stage::Back { .. } => 1,
            Stage::Fold { .. } => 2,
            Stage::Around => 3,
            Stage::Face => 4,
            Stage::Look { .. } => 5,
            Stage::Pass => 6,
        }
    }

    /// Takes the pose of the base (odometry frame), the joint angles (rad), and a new sweep if there is one, `dt` (s)
    /// after the last call.
    pub fn update(&mut self, base: &Pose, joints: &Joints, sweep: Option<&Sweep>, dt: f64) -> Step {
        if let Some(failure) = sweep.and_then(|sweep| self.look(sweep)) {
            return Step::Failed(failure);
        }
        let Some((velocity, arm)) = self.advance(base, joints) else { return Step::Through };
        let steps = BASE_ACCELERATION_MAX.map(|most| most * GENTLE * dt);
        self.base = towards_together(&self.base, &velocity, &steps);
        Step::Move(Rates::from_fn(|i, _| if i < 3 { self.base[i] } else { arm[i - 3] }))
    }

    /// Returns the reason against going on that a sweep shows, if there is one.
    fn look(&mut self, sweep: &Sweep) -> Option<Failure> {
        if clearance(&sweep.points, &sweep.joints).is_some_and(|room| room < ROOM_MIN) {
            return Some(Failure::Room);
        }
        let odometry_from_base = Isometry2::new(sweep.from.xy(), sweep.from.z);
        let points: Vec<_> =
            sweep.points.iter().map(|point| (odometry_from_base * Point2::from(*point)).coords).collect();
        match self.stage {
            Stage::Back { .. } | Stage::Fold { .. } => {
                let turned = self.door.turned(&points);
                self.unseen = if turned.is_none() { self.unseen + 1 } else { 0 };
                let closes = turned.is_some_and(|turned| turned.abs() > STAYS) || self.unseen > UNSEEN_MAX;
                closes.then_some(Failure::Closes)
            }
            Stage::Around | Stage::Face => None,
            Stage::Look { seen, unseen } => match corridor(&points, &self.way, self.door.length(&self.way)) {
                Some(found) => {
                    self.believe(&found, 1.0 / f64::from(seen + 1));
                    self.stage = Stage::Look { seen: seen + 1, unseen };
                    if seen + 1 < LOOKS {
                        return None;
                    }
                    let missing = self.room.map_or(f64::INFINITY, |room| 2.0 * (BASE_RADIUS + self.margin - room));
                    self.stage = Stage::Pass;
                    (missing > 0.0).then(|| Failure::Narrow(missing, self.door.angle_needed(BASE_RADIUS, self.margin)))
                }
                None => {
                    self.stage = Stage::Look { seen, unseen: unseen + 1 };
                    (unseen > UNSEEN_MAX).then_some(Failure::Unseen)
                }
            },
            Stage::Pass => {
                let length = self.door.length(&self.way);
                if length - self.way.coordinates(&sweep.from.xy()).x > BLIND {
                    // A corridor that is wider than before has a side that is out of sight.
                    let room = self.room.unwrap_or(f64::INFINITY);
                    let is_same = |found: &Corridor| (BASE_RADIUS..room + TOLERANCE).contains(&found.room);
                    if let Some(found) = corridor(&points, &self.way, length).filter(is_same) {
                        self.believe(&found, SHARE);
                    }
                }
                None
            }
        }
    }

    fn believe(&mut self, found: &Corridor, share: f64) {
        let beside = self.way.coordinates(&found.way.at).y;
        let turn = found.way.heading - self.way.heading;
        let left = Rotation2::new(self.way.heading) * Vector2::y();
        self.way.at += left * (beside * share);
        self.way.heading += wrapped(turn) * share;
        let room = self.room.get_or_insert(found.room);
        *room += (found.room - *room) * share;
    }

    /// Returns the velocities of the base (base axes) and of the joints; none once the base is through.
    fn advance(&mut self, base: &Pose, joints: &Joints) -> Option<([f64; 3], Joints)> {
        let folded = folded(joints);
        let arm = towards_folded(joints, &folded);
        let (place, heading, speed) = match self.stage {
            Stage::Back { to, heading } => {
                if (base.xy() - to).norm() < THERE {
                    self.stage = Stage::Fold { at: to, heading };
                }
                return Some((towards_place(base, &to, heading, SLOW), Joints::zeros()));
            }
            Stage::Fold { at, heading } => {
                if (joints - folded).amax() < FOLDED {
                    self.stage = Stage::Around;
                }
                (at, heading, SLOW)
            }
            Stage::Around => {
                let around = self.door.around();
                if (base.xy() - around).norm() < PASSED {
                    self.stage = Stage::Face;
                }
                (around, base.z, SPEED)
            }
            Stage::Face => {
                let turn = self.way.heading - base.z;
                if (base.xy() - self.way.at).norm() < THERE && wrapped(turn).abs() < TURNED {
                    self.stage = Stage::Look { seen: 0, unseen: 0 };
                }
                (self.way.at, self.way.heading, SPEED)
            }
            Stage::Look { .. } => (base.xy(), base.z, 0.0),
            Stage::Pass => {
                let (at, length) = (self.way.coordinates(&base.xy()), self.door.length(&self.way));
                if at.x > length - THERE {
                    return None;
                }
                // The base first drives onto the line, then along it.
                let ahead = if at.y.abs() < 2.0 * THERE || at.x > AHEAD { AHEAD } else { 0.0 };
                (self.way.at + self.way.along() * (at.x.max(0.0) + ahead).min(length), self.way.heading, SLOW)
            }
        };
        Some((towards_place(base, &place, heading, speed), arm))
    }
}

/// The folded arm; its last joint keeps its angle.
fn folded(joints: &Joints) -> Joints {
    Joints::from_fn(|i, _| FOLDED_DEG.get(i).map_or(joints[i], |angle| angle.to_radians()))
}

/// Returns the rates that move all joints together (rad/s), so that the hand comes in before it comes up.
fn towards_folded(joints: &Joints, folded: &Joints) -> Joints {
    let wanted = (folded - joints) * FOLD_GAIN;
    wanted / (wanted.amax() / FOLD_SPEED).max(1.0)
}

/// Returns the velocity (base axes) of a base at `base` towards a place (m) and a heading (rad).
fn towards_place(base: &Pose, place: &Vector2<f64>, heading: f64, speed: f64) -> [f64; 3] {
    let way = Rotation2::new(-base.z) * (place - base.xy()) * GAIN;
    let way = way.cap_magnitude(speed);
    let turn = (wrapped(heading - base.z) * GAIN).clamp(-TURN_SPEED, TURN_SPEED);
    [way.x, way.y, turn]
}

#[cfg(test)]
mod tests {
    use super::super::passage::tests::doorway as door;
    use super::super::{caster, puma560};
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn walls(door: &Doorway) -> Vec<(Vector2<f64>, Vector2<f64>)> {
        let beside = (door.latch - door.hinge).normalize();
        vec![(door.hinge, door.edge), (door.latch, door.latch + beside * 2.0), (door.hinge, door.hinge - beside * 2.0)]
    }

    /// Returns the sweep of a laser 30 cm before the centre over a half circle, in base axes.
    fn sweep(base: &Pose, walls: &[(Vector2<f64>, Vector2<f64>)]) -> Vec<Vector2<f64>> {
        let ray = |step: u32| {
            let bearing = FRAC_PI_2 * (f64::from(step) / 180.0 - 1.0);
            let turn = Rotation2::new(base.z + bearing);
            let from = base.xy() + Rotation2::new(base.z) * Vector2::x() * 0.3;
            let range = walls.iter().filter_map(|(a, b)| {
                let (along, wall, to) = (turn * Vector2::x(), b - a, a - from);
                let cross = along.perp(&wall);
                let (range, share) = (to.perp(&wall) / cross, to.perp(&along) / cross);
                (range > 0.0 && (0.0..=1.0).contains(&share)).then_some(range)
            });
            let range = range.fold(f64::INFINITY, f64::min);
            let at = Vector2::new(0.3, 0.0) + Rotation2::new(bearing) * Vector2::x() * range;
            range.is_finite().then_some(at)
        };
        (0..=360).filter_map(ray).collect()
    }

    /// Drives through a door `truth` that differs from the door `told` to the drive. The base follows commands with a
    /// lag, and its odometry counts `wheels` times the way. Returns the end, the final pose, and the least distance to
    /// anything.
    fn drive(told: &Doorway, truth: &Doorway, wheels: f64) -> (Step, Pose, f64) {
        let angle = truth.angle();
        let mirror = (truth.hinge.y).signum();
        let face = Vector2::new(-angle.cos(), mirror * angle.sin());
        let hand = truth.hinge + (truth.edge - truth.hinge) * 0.9 + face * 0.06;
        let mut joints = puma560::door_posture();
        let tool = puma560::forward(&joints).base_from_tool;
        let heading = (-face).y.atan2((-face).x);
        let start = hand - Rotation2::new(heading) * tool.translation.vector.xy();
        let mut base = Pose::new(start.x, start.y, heading);
        let mut odometry = base;
        let mut drive = match Drive::new(*told, &odometry, &tool, 0.05) {
            Ok(drive) => drive,
            Err(failure) => return (Step::Failed(failure), base, f64::INFINITY),
        };
        let (walls, mut velocity, mut nearest) = (walls(truth), Vector3::zeros(), f64::INFINITY);
        let dt = 0.02;
        for i in 0..6000 {
            let sweep = (i % 3 == 0).then(|| Sweep { points: sweep(&base, &walls), from: odometry, joints });
            match drive.update(&odometry, &joints, sweep.as_ref(), dt) {
                Step::Move(rates) => {
                    let wanted: Vector3<f64> = rates.fixed_rows::<3>(0).into();
                    velocity += (wanted - velocity) * (dt / 0.1);
                    joints += rates.fixed_rows::<6>(3) * dt;
                }
                end @ (Step::Through | Step::Failed(_)) => return (end, base, nearest),
            }
            base = caster::advance(&base, &(velocity * dt));
            odometry = caster::advance(&odometry, &(velocity * dt * wheels));
            let beside = |(a, b): &(Vector2<f64>, Vector2<f64>)| {
                let share = ((base.xy() - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
                (base.xy() - a - (b - a) * share).norm() - BASE_RADIUS
            };
            nearest = walls.iter().map(beside).fold(nearest, f64::min);
        }
        (Step::Move(Rates::zeros()), base, nearest)
    }

    #[test]
    fn it_stands_on_the_other_side_and_came_near_nothing() {
        for mirror in [1.0, -1.0] {
            for (angle, width, wheels) in
                [(1.2, 0.9, 1.0), (1.4, 0.76, 1.03), (FRAC_PI_2, 0.9, 0.96), (1.2, 1.15, 1.05)]
            {
                let door = door(angle, width, mirror);
                let (end, base, nearest) = drive(&door, &door, wheels);
                assert_eq!(end, Step::Through, "{angle} {width} {wheels} {base}");
                assert!(base.x > BASE_RADIUS, "{base}");
                // The measured room, except for 1 cm on each side of the line.
                assert!(nearest > (door.room() - BASE_RADIUS).min(0.15) - 0.015, "{nearest} of {}", door.room());
            }
        }
    }

    #[test]
    fn the_first_measure_may_be_wrong() {
        for mirror in [1.0, -1.0] {
            let truth = door(1.3, 0.9, mirror);
            let mut told = truth;
            told.latch += Vector2::new(0.02, mirror * 0.04);
            told.hinge += Vector2::new(0.03, mirror * 0.03);
            let (end, base, nearest) = drive(&told, &truth, 1.0);
            assert!(end == Step::Through && base.x > BASE_RADIUS && nearest > 0.08, "{end:?} {base} {nearest}");
        }
    }

    #[test]
    fn what_is_missing_is_said() {
        // The leaf alone shows that the passage is narrow: 0.66 m where 0.72 m are needed, and a leaf of 0.9 m at 40 degrees.
        let narrow = door(FRAC_PI_2, 0.66, 1.0);
        let Step::Failed(Failure::Narrow(missing, None)) = drive(&narrow, &narrow, 1.0).0 else { panic!("it passes") };
        assert!((missing - 0.06).abs() < 1e-6, "{missing}");
        let little = door(0.7, 0.9, 1.0);
        let Step::Failed(Failure::Narrow(missing, Some(needed))) = drive(&little, &little, 1.0).0 else {
            panic!("it passes")
        };
        assert!((missing - (0.72 - 0.9 * 0.7f64.sin())).abs() < 1e-6 && (needed - 0.8f64.asin()).abs() < 1e-6);
        // The measurement in front of the opening decides: it shows a jamb that was hidden behind the leaf.
        let told = door(1.3, 0.9, 1.0);
        let mut truth = told;
        truth.latch.y += 0.20;
        let (end, base, _) = drive(&told, &truth, 1.0);
        let Step::Failed(Failure::Narrow(missing, _)) = end else { panic!("{end:?} at {base}") };
        assert!(missing > 0.03 && missing < 0.08 && base.x < -BASE_RADIUS, "{missing} {base}");
    }

    #[test]
    fn a_leaf_that_swings_back_is_noticed() {
        let (told, truth) = (door(1.3, 0.9, 1.0), door(1.1, 0.9, 1.0));
        let mut drive = Drive::new(
            told,
            &Pose::new(-1.2, 1.5, -1.3),
            &puma560::forward(&puma560::door_posture()).base_from_tool,
            0.05,
        )
        .unwrap();
        let base = Pose::new(-1.2, 1.5, -1.3);
        let sweep = Sweep { points: sweep(&base, &walls(&truth)), from: base, joints: puma560::door_posture() };
        assert_eq!(drive.update(&base, &puma560::door_posture(), Some(&sweep), 0.02), Step::Failed(Failure::Closes));
    }

    #[test]
    fn the_folded_arm_is_above_the_base() {
        let joints = folded(&puma560::door_posture());
        let [shoulder, elbow, wrist, fingers] = puma560::outline(&joints);
        for (point, radius) in [(shoulder, 0.09), (elbow, 0.09), (wrist, 0.07), (fingers, 0.05)] {
            assert!(point.xy().norm() + radius < BASE_RADIUS && point.z < 1.9, "{point}");
        }
        let tool = puma560::forward(&joints).base_from_tool.translation.vector;
        assert!(tool.xy().norm() < BASE_RADIUS, "{tool}");
        // While the arm folds, the hand reaches out by a centimetre or two. It has backed away by 25.
        let reach = |at: &Joints| puma560::forward(at).base_from_tool.translation.vector.xy().norm();
        let (mut at, from) = (puma560::door_posture(), reach(&puma560::door_posture()));
        while (joints - at).amax() > FOLDED {
            at += towards_folded(&at, &joints) * 0.02;
            assert!(reach(&at) < from + 0.03, "{} {from}", reach(&at));
        }
    }
}
