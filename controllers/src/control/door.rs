//! Opening a door about a hinge that is being found meanwhile.
//!
//! The hand moves along the tangent of the estimated circle and turns with the door. The pull is limited by force: it
//! fades from 35 N and is gone at 60 N, so a door that does not move is leant on, not torn at.
//!
//! Source: after the fused scheme that "DCA", section 5, ascribes to its reference \[9\]; the law is ours, close to
//! Karayiannidis et al., "Open Sesame", IROS 2012 (tangential velocity, radial force to zero, hinge on line).

use super::compliant::Guide;
use super::filter::LowPass;
use super::hinge::Hinge;
use nalgebra::{Isometry3, Vector2, Vector3, Vector6};

/// Speed of the handle (m/s).
pub const SPEED: f64 = 0.12;
/// Where the pull is gone (N).
pub const PULL_MAX: f64 = 60.0;
/// A force on the hand that ends everything (N).
pub const FORCE_MAX: f64 = 150.0;
const PULL_FADE: f64 = 25.0;
const RAMP: f64 = 1.0;
const STALL_PULL: f64 = 45.0;
const STALL_SPEED: f64 = 0.02;
const STALL_TIME: f64 = 0.5;
/// The lever stays pressed until the door is this far open [rad]: the latch is free by then.
const LEVER_FREE: f64 = 0.105;
const RADIUS_MIN: f64 = 0.3;

/// The state of one opening.
#[derive(Clone, Debug, PartialEq)]
pub struct Opening {
    hinge: Hinge,
    /// +1 if the door opens counter-clockwise seen from above.
    sense: f64,
    time: f64,
    stalled: f64,
    last: Vector2<f64>,
    speed: LowPass<2>,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull {
    /// Velocity of the hand (m/s, rad/s, tool axes).
    pub twist_in_tool: Vector6<f64>,
    /// For the compliance beside it.
    pub guide: Guide,
    /// How far the door is open by the estimate (rad).
    pub angle: f64,
    /// Why it cannot go on.
    pub failure: Option<Failure>,
}

/// Why an opening cannot go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// It pulls and nothing moves.
    Blocked,
    /// The force is dangerous.
    Force,
}

impl Opening {
    /// Begins with the hand at `odometry_from_tool`, holding a lever that points to the hinge, which should be about
    /// `radius` (m) away. The hand faces the door, so the door opens towards its back.
    pub fn new(odometry_from_tool: &Isometry3<f64>, radius: f64) -> Self {
        let back = -horizontal(&(odometry_from_tool.rotation * Vector3::z()));
        let lever = horizontal(&(odometry_from_tool.rotation * Vector3::x()));
        let along_door = Vector2::new(-back.y, back.x) * Vector2::new(-back.y, back.x).dot(&lever).signum();
        let start = odometry_from_tool.translation.vector.xy();
        let sense = (-along_door).perp(&back).signum();
        let hinge = Hinge::new(start, along_door, radius);
        Self { hinge, sense, time: 0.0, stalled: 0.0, last: start, speed: LowPass::new(3.0) }
    }

    /// Returns the estimate of the hinge.
    pub fn hinge(&self) -> &Hinge {
        &self.hinge
    }

    /// Returns +1 if the door opens counter-clockwise seen from above, else -1.
    pub fn sense(&self) -> f64 {
        self.sense
    }

    /// Takes the pose of the hand and the force on it (N, tool axes), `dt` (s) after the last call.
    pub fn update(&mut self, odometry_from_tool: &Isometry3<f64>, force_in_tool: &Vector3<f64>, dt: f64) -> Pull {
        let hand = odometry_from_tool.translation.vector.xy();
        let velocity = (hand - self.last) / dt.max(1e-3);
        let speed = self.speed.update(&[velocity.x, velocity.y], dt);
        self.last = hand;
        self.time += dt;
        self.hinge.update(hand);
        let radial = (hand - self.hinge.centre()).try_normalize(1e-6).unwrap_or_else(Vector2::x);
        let tangent = Vector3::new(-radial.y, radial.x, 0.0) * self.sense;
        let tool_from_odometry = odometry_from_tool.rotation.inverse();
        let tangent_in_tool = tool_from_odometry * tangent;
        let up_in_tool = tool_from_odometry * Vector3::z();
        let pull = -force_in_tool.dot(&tangent_in_tool);
        let fade = ((PULL_MAX - pull) / PULL_FADE).clamp(0.0, 1.0);
        let along = SPEED * (self.time / RAMP).min(1.0) * fade;
        let linear = tangent_in_tool * along;
        let angular = up_in_tool * (self.sense * along / self.hinge.radius().max(RADIUS_MIN));
        let angle = self.sense * self.hinge.angle(hand);
        let still = speed[0].hypot(speed[1]) < STALL_SPEED;
        let stalls = self.time > RAMP && pull > STALL_PULL && still;
        self.stalled = if stalls { self.stalled + dt } else { (self.stalled - dt).max(0.0) };
        let failure = if force_in_tool.norm() > FORCE_MAX {
            Some(Failure::Force)
        } else {
            (self.stalled > STALL_TIME).then_some(Failure::Blocked)
        };
        Pull {
            twist_in_tool: Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z),
            guide: Guide { tangent_in_tool, up_in_tool, upward: angle > LEVER_FREE },
            angle,
            failure,
        }
    }
}

fn horizontal(v: &Vector3<f64>) -> Vector2<f64> {
    v.xy().try_normalize(1e-6).unwrap_or_else(Vector2::x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, UnitQuaternion};

    /// The hand before a door: z ahead into it, x (the lever) to the left or right along it.
    fn hand(at: Vector2<f64>, yaw: f64, lever_left: bool) -> Isometry3<f64> {
        let ahead = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
        let left = Vector3::z().cross(&ahead);
        let lever = if lever_left { left } else { -left };
        let axes = [lever, ahead.cross(&lever), ahead];
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&axes));
        Isometry3::from_parts(Vector3::new(at.x, at.y, 1.0).into(), rotation)
    }

    #[test]
    fn opens_either_way() {
        for (lever_left, side) in [(true, 1.0), (false, -1.0)] {
            // The hinge is 0.8 m along the door; a door that follows freely opens by the commanded arc.
            let centre = Vector2::new(0.0, 0.8 * side);
            let mut pose = hand(Vector2::zeros(), 0.0, lever_left);
            let mut opening = Opening::new(&pose, 0.7);
            let mut angle = 0.0;
            for _ in 0..1000 {
                let pull = opening.update(&pose, &Vector3::zeros(), 0.01);
                assert_eq!(pull.failure, None);
                let v = pose.rotation * Vector3::from(pull.twist_in_tool.fixed_rows::<3>(0));
                let radial = (pose.translation.vector.xy() - centre).normalize();
                angle += 0.01 * side * -radial.perp(&v.xy()) / 0.8;
                let at = centre + Vector2::new(-angle.sin(), -side * angle.cos()) * 0.8;
                pose = hand(at, -side * angle, lever_left);
            }
            // 9.5 s at 0.12 m/s on a radius of 0.8 m, less what the wrong prior costs at first.
            assert!((angle - 9.5 * 0.12 / 0.8).abs() < 0.02, "{angle}");
            let pull = opening.update(&pose, &Vector3::zeros(), 0.01);
            assert!((pull.angle - angle).abs() < 0.02, "{} {angle}", pull.angle);
        }
    }

    #[test]
    fn a_locked_door_is_blocked() {
        let pose = hand(Vector2::zeros(), 0.0, true);
        let mut opening = Opening::new(&pose, 0.7);
        let failed =
            (0..300).position(|_| opening.update(&pose, &Vector3::new(0.0, 0.0, 58.0), 0.01).failure.is_some());
        assert!(failed.is_some_and(|at| (145..160).contains(&at)), "{failed:?}");
    }
}
