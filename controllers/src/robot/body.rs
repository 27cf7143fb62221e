//! The robot's body: its collisions, and the effect of forces on its drives.
//!
//! Seen from above, the base is a disc, the arm consists of three capsules, and leaf, jambs and walls are stretches.
//! All are as high as the robot. The fingers are left out, because they are there to touch things. A drive is a
//! velocity servo of finite stiffness. A force makes it a little slower or faster (its droop). Beyond the torque of its
//! motor, the drive gives way.
//!
//! Source: torques of Armstrong, Khatib, Burdick, "The explicit dynamic model and inertial parameters of the PUMA 560
//! arm", ICRA 1986, table of maximum torques; all other numbers are our choice. The arm's own weight is left out.

use super::setup::Machine;
use crate::control::caster::Pose;
use crate::control::puma560::{A, ALPHA, D, Joints, MOUNT_HEIGHT};
use crate::control::redundancy::Rates;
use nalgebra::{Isometry3, Point2, UnitQuaternion, Vector2, Vector3};

/// A stretch of wall, seen from above: its two ends (m).
pub type Wall = (Vector2<f64>, Vector2<f64>);

/// Largest torques of the joints (Nm).
const TORQUES_MAX: [f64; 6] = [97.6, 186.4, 89.4, 24.2, 20.1, 21.3];
/// Largest yaw torque of the base (Nm) for each newton that it can push.
const YAW_ARM: f64 = 0.3;
/// The rate that a newton or newton metre adds to a drive: base x, y (m/s), yaw (rad/s), joints (rad/s).
const DROOP: [f64; 9] = [5e-5, 5e-5, 1e-4, 1e-4, 1e-4, 1e-4, 5e-4, 5e-4, 5e-4];
/// The same for the part of a force beyond the motor's torque.
const YIELD: [f64; 9] = [2e-3, 2e-3, 1e-2, 2e-2, 2e-2, 2e-2, 0.2, 0.2, 0.2];
const BASE_RADIUS: f64 = 0.31;
/// The radii of upper arm, forearm and wrist (m).
const RADII: [f64; 3] = [0.09, 0.07, 0.05];
/// The distance from the wrist's centre to where the fingers begin (m).
const WRIST_LENGTH: f64 = 0.10;
/// The stiffness of the robot's skin against a wall (N/m).
const STIFFNESS: f64 = 2e4;
/// The stiffness of the bumper around the base (N/m), and its travel (m). Beyond this travel the base is as stiff as
/// the skin elsewhere.
const BUMPER: f64 = 2e3;
const TRAVEL: f64 = 0.045;

/// A force on a part of the robot, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// The point at which the force acts (m).
    pub at: Vector3<f64>,
    /// The force (N).
    pub force: Vector3<f64>,
    /// The torque (Nm).
    pub torque: Vector3<f64>,
    /// The number of joints between the base and this part.
    pub joints: usize,
}

/// A part of the robot against a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The load on the part.
    pub load: Load,
    /// The index of the wall.
    pub wall: usize,
    /// The point on the wall (m).
    pub at: Vector2<f64>,
}

/// The robot's joints and links in the world frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    base: Pose,
    /// Axis and origin of each joint, world frame.
    axes: [(Vector3<f64>, Vector3<f64>); 6],
    /// Shoulder, elbow, wrist's centre, and where the fingers begin (m, world frame).
    points: [Vector3<f64>; 4],
}

/// The effect of forces on the drives: base x, y (m/s), yaw (rad/s), base axes, then joints (rad/s).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Yielding {
    /// The part that the servos allow; the encoders measure it.
    pub droop: Rates,
    /// The part beyond the motors' torque. The wheels slip, so only the arm's encoders measure it.
    pub excess: Rates,
}

impl Body {
    /// Returns the body with its base at `base` and these joint angles (rad).
    pub fn new(base: &Pose, joints: &Joints) -> Self {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), base.z);
        let mut frame = Isometry3::from_parts(Vector3::new(base.x, base.y, MOUNT_HEIGHT).into(), yaw);
        let (mut axes, mut origins) = ([(Vector3::zeros(), Vector3::zeros()); 6], [Vector3::zeros(); 6]);
        for i in 0..6 {
            axes[i] = (frame.rotation * Vector3::z(), frame.translation.vector);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), joints[i]);
            let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), ALPHA[i]);
            let offset = turn * Vector3::new(A[i], 0.0, 0.0) + Vector3::new(0.0, 0.0, D[i]);
            frame *= Isometry3::from_parts(offset.into(), turn * twist);
            origins[i] = frame.translation.vector;
        }
        let fingers = origins[5] + frame.rotation * Vector3::new(0.0, 0.0, WRIST_LENGTH);
        Self { base: *base, axes, points: [origins[0], origins[1], origins[3], fingers] }
    }

    /// Returns the distance from the base's disc to the nearest wall (m).
    pub fn base_room(&self, walls: &[Wall]) -> f64 {
        let middle = self.base.xy();
        let room = |wall: &Wall| (middle - nearest(&(middle, middle), wall).1).norm() - BASE_RADIUS;
        walls.iter().map(room).fold(f64::INFINITY, f64::min)
    }

    /// Returns the collisions of the robot's parts with the walls.
    pub fn hits(&self, walls: &[Wall]) -> Vec<Hit> {
        let middle = self.base.xy().push(MOUNT_HEIGHT);
        let [shoulder, elbow, wrist, fingers] = self.points;
        let parts = [
            (middle, middle, BASE_RADIUS, 0),
            (shoulder, elbow, RADII[0], 2),
            (elbow, wrist, RADII[1], 3),
            (wrist, fingers, RADII[2], 6),
        ];
        let mut hits = Vec::new();
        for (from, to, radius, joints) in parts {
            for (wall, stretch) in walls.iter().enumerate() {
                let (share, at) = nearest(&(from.xy(), to.xy()), stretch);
                let on_part = from + (to - from) * share;
                let away = on_part.xy() - at;
                let distance = away.norm();
                if distance < radius && distance > 1e-9 {
                    let force = (away / distance * (pressed(radius - distance, joints))).push(0.0);
                    hits.push(Hit { load: Load { at: on_part, force, torque: Vector3::zeros(), joints }, wall, at });
                }
            }
        }
        hits
    }

    /// Returns the effect of loads on the drives.
    pub fn yielding(&self, machine: &Machine, loads: &[Load]) -> Yielding {
        let torques: Rates = loads.iter().map(|load| self.torques(load)).sum();
        let limit = |i: usize| match i {
            0 | 1 => machine.traction,
            2 => machine.traction * YAW_ARM,
            _ => TORQUES_MAX[i - 3] * machine.torque_limit,
        };
        let excess = Rates::from_fn(|i, _| {
            let beyond = torques[i].abs() - limit(i);
            if beyond > 0.0 { beyond * torques[i].signum() * YIELD[i] } else { 0.0 }
        });
        Yielding { droop: Rates::from_fn(|i, _| torques[i] * DROOP[i] * machine.droop), excess }
    }

    /// Returns the forces (N) and torques (Nm) of one load along the axes of base and joints, by its virtual work.
    pub fn torques(&self, load: &Load) -> Rates {
        let (s, c) = self.base.z.sin_cos();
        let arm = load.at - self.base.xy().push(0.0);
        Rates::from_fn(|i, _| match i {
            0 => c * load.force.x + s * load.force.y,
            1 => c * load.force.y - s * load.force.x,
            2 => arm.cross(&load.force).z + load.torque.z,
            _ if i - 3 < load.joints => {
                let (axis, origin) = self.axes[i - 3];
                axis.dot(&((load.at - origin).cross(&load.force) + load.torque))
            }
            _ => 0.0,
        })
    }
}

/// The force (N) of a part behind `joints` joints that is pressed by `depth` (m).
fn pressed(depth: f64, joints: usize) -> f64 {
    if joints == 0 { BUMPER * depth + STIFFNESS * (depth - TRAVEL).max(0.0) } else { STIFFNESS * depth }
}

/// Returns the point of a part that is nearest to a wall, as a share of the part's length, and the nearest point on the
/// wall.
fn nearest(part: &Wall, wall: &Wall) -> (f64, Vector2<f64>) {
    let along = part.1 - part.0;
    let on_wall = |p: &Vector2<f64>| {
        let stretch = wall.1 - wall.0;
        wall.0 + stretch * ((p - wall.0).dot(&stretch) / stretch.norm_squared().max(1e-12)).clamp(0.0, 1.0)
    };
    let share_of = |p: &Vector2<f64>| ((p - part.0).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    // If two stretches do not cross, an end of one of them is nearest. Capsules are stopped long before they cross.
    let shares = [0.0, 1.0, share_of(&wall.0), share_of(&wall.1)];
    let places = shares.map(|share| (share, on_wall(&(part.0 + along * share))));
    let distance = |(share, at): &(f64, Vector2<f64>)| {
        nalgebra::distance(&Point2::from(part.0 + along * *share), &Point2::from(*at))
    };
    places.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or((0.0, wall.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::puma560;

    fn body(base: Pose) -> Body {
        Body::new(&base, &puma560::door_posture())
    }

    #[test]
    fn torques_are_the_virtual_work_of_a_force() {
        // The work of a force over a small step of each axis, by the same forward kinematics as in the plant.
        let (base, joints) = (Pose::new(-1.4, 0.3, 0.2), puma560::door_posture() + Joints::repeat(0.1));
        let place = |base: &Pose, joints: &Joints| {
            let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), base.z);
            let world_from_base = Isometry3::from_parts(Vector3::new(base.x, base.y, 0.0).into(), yaw);
            (world_from_base * puma560::forward(joints).base_from_tool).translation.vector
        };
        let (at, force) = (place(&base, &joints), Vector3::new(12.0, -30.0, 7.0));
        let load = Load { at, force, torque: Vector3::zeros(), joints: 6 };
        let torques = Body::new(&base, &joints).torques(&load);
        let (s, c) = base.z.sin_cos();
        for i in 0..9 {
            let h = 1e-6;
            let (mut moved, mut turned) = (base, joints);
            match i {
                0 => moved += Pose::new(c, s, 0.0) * h,
                1 => moved += Pose::new(-s, c, 0.0) * h,
                2 => moved.z += h,
                _ => turned[i - 3] += h,
            }
            let work = force.dot(&(place(&moved, &turned) - at)) / h;
            // The error of a forward difference: second derivatives of a metre or two, times 40 N, times half of h.
            assert!((work - torques[i]).abs() < 1e-4, "{i}: {work} {}", torques[i]);
        }
    }

    #[test]
    fn beyond_its_torque_a_joint_gives_way() {
        let body = body(Pose::new(-1.5, 0.2, 0.0));
        let at = body.points[2];
        let push = |newton: f64| {
            let load = Load { at, force: Vector3::new(0.0, newton, 0.0), torque: Vector3::zeros(), joints: 3 };
            (body.yielding(&Machine::default(), &[load]), body.torques(&load))
        };
        let (weak, _) = push(60.0);
        assert!(weak.excess.amax() <= 0.0 && weak.droop[3].abs() > 0.0);
        let (strong, torques) = push(400.0);
        let beyond = torques[3].abs() - 97.6;
        assert!(beyond > 0.0 && (strong.excess[3].abs() - beyond * 0.02).abs() < 1e-12);
        assert!((strong.excess[1] - (400.0 - 200.0) * 2e-3).abs() < 1e-12);
    }

    #[test]
    fn walls_push_back_along_their_normal() {
        let wall = (Vector2::new(0.0, -3.0), Vector2::new(0.0, 3.0));
        assert_eq!(body(Pose::new(-2.0, 0.0, 0.0)).hits(&[wall]), []);
        assert!((body(Pose::new(-2.0, 0.0, 0.0)).base_room(&[wall]) - 1.69).abs() < 1e-12);
        // The bumper is pressed by 1 cm: 20 N, straight back; the arm is on the far side of the wall.
        let hits = body(Pose::new(-0.30, 0.0, std::f64::consts::PI)).hits(&[wall]);
        let base = hits.iter().find(|hit| hit.load.joints == 0).expect("the base is in the wall");
        assert!((base.load.force - Vector3::new(-20.0, 0.0, 0.0)).norm() < 1e-6, "{base:?}");
        // Behind the bumper's travel of 45 mm is the base: 5 mm beyond it add 100 N.
        let hits = body(Pose::new(-0.26, 0.0, std::f64::consts::PI)).hits(&[wall]);
        assert!(hits.iter().any(|hit| (hit.load.force - Vector3::new(-200.0, 0.0, 0.0)).norm() < 1e-6), "{hits:?}");
        // A corner pushes away from itself.
        let corner = (Vector2::new(0.0, 0.0), Vector2::new(1.0, 0.0));
        let hits = body(Pose::new(-0.18, 0.24, std::f64::consts::PI)).hits(&[corner]);
        let base = hits.iter().find(|hit| hit.load.joints == 0).expect("the base is at the corner");
        assert!((base.load.force - Vector3::new(-0.6, 0.8, 0.0) * 20.0).norm() < 1e-6, "{base:?}");
    }
}
