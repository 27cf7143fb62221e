//! Opening a door about a hinge that is being found meanwhile.
//!
//! The hand moves the way the handle goes, as [`super::hinge`] has it, and turns with the door. The pull is limited by
//! force: it fades from 25 N and is gone at 50 N, so a door that does not move is leant on, not torn at; slowly harder, up
//! to 70 N, for a strong closer takes that. It fades by the slow part of the force: its slope, 0.12 m/s over 25 N, is ten
//! times the gain that a stiff grasp and a delay allow (see [`super::compliant`]). The quick part only damps, by that gain;
//! what neither of them stops fades at once when it exceeds the largest pull. A door that does not come when it is pulled is pushed; only one that does
//! neither is locked.
//!
//! Source: after the fused scheme that "DCA", section 5, ascribes to its reference \[9\]; the law is that of
//! [`super::hinge`]'s source: tangential velocity, compliance across, the estimate on line.

use super::calm::Calm;
use super::compliant::{ACROSS, Guide, gain_max};
use super::filter::LowPass;
use super::hinge::Hinge;
use super::line::horizontal;
use super::ramp::towards;
use nalgebra::{Isometry3, Rotation3, Vector2, Vector3, Vector6};

/// Speed of the handle (m/s).
pub const SPEED: f64 = 0.12;
/// Where the pull is gone: at first, and for a door that has not moved for some time (N).
pub const PULL_MAX: (f64, f64) = (50.0, 70.0);
/// What pull and lever come to together at most (N).
const TOTAL_MAX: f64 = 72.0;
/// How quickly it is leant on harder (N/s).
const LEAN: f64 = 15.0;
/// A force on the hand that ends everything (N).
pub const FORCE_MAX: f64 = 80.0;
const PULL_FADE: f64 = 25.0;
/// What of a pull changes more slowly is slow (Hz).
const PULL_SLOW: f64 = 0.3;
/// However suddenly it comes, a pull is given way to from so far below the largest, and is gone so far above it (N).
const SUDDEN: (f64, f64) = (5.0, 15.0);
/// A door that may be shut for good is not torn at: so fast (m/s) until the handle has gone so far (m).
const FIRST: (f64, f64) = (0.03, 0.025);
/// (m/s²).
const ACCELERATION: f64 = 0.12;
/// Noise is no danger (Hz).
const FORCE_CUTOFF: f64 = 12.0;
const RAMP: f64 = 1.0;
/// A pull so far below the largest does not move the door (N).
const STALL_PULL: f64 = 12.0;
const STALL_SPEED: f64 = 0.02;
const STALL_TIME: f64 = 0.5;
/// The lever stays pressed until the handle has gone this far (m): the latch is free by then.
const LEVER_FREE: f64 = 0.085;
/// A leaf that stands so far from the wall does so for sure (rad).
const SEEN: f64 = 0.12;
/// A handle that has not gone this far was never free (m).
const MOVED: f64 = 0.04;

/// Which way the door goes, as the hand sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Swing {
    Pull,
    Push,
}

/// The state of one opening.
#[derive(Clone, Debug, PartialEq)]
pub struct Opening {
    hinge: Hinge,
    /// +1 if the lever points to the left, so that a door that is pulled opens clockwise seen from above.
    left: f64,
    swing: Swing,
    time: f64,
    /// The speed at which the handle may go (m/s).
    top: f64,
    stalled: f64,
    /// Where the pull is gone (N).
    pull_max: f64,
    slow: LowPass<1>,
    beside: LowPass<1>,
    calm: Calm,
    force: LowPass<1>,
    last: Vector2<f64>,
    travelled: f64,
    angle: f64,
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
    /// It has pulled and pushed, and the door never moved.
    Locked,
    /// The door has moved, and does not move any further.
    Blocked,
    /// The force is dangerous.
    Force,
}

impl Opening {
    /// Begins with the hand at `odometry_from_tool`, holding a lever that is pressed and points to the hinge, which should
    /// be about `radius` (m) away. The hand faces the door; it has rolled with the lever, so the side that is down is the
    /// lever's.
    pub fn new(odometry_from_tool: &Isometry3<f64>, radius: f64) -> Self {
        let ahead = horizontal(&(odometry_from_tool.rotation * Vector3::z()));
        let hand = odometry_from_tool.rotation * Vector3::x();
        let leftward = hand.xy().dot(&Vector2::new(-ahead.y, ahead.x));
        // A hand that is level has not pressed: then its x axis points along the lever.
        let side = if hand.z.abs() > 0.05 { -hand.z * leftward } else { leftward };
        Self {
            hinge: Hinge::new(radius),
            left: side.signum(),
            swing: Swing::Pull,
            time: 0.0,
            top: 0.0,
            stalled: 0.0,
            pull_max: PULL_MAX.0,
            slow: LowPass::new(PULL_SLOW),
            beside: LowPass::new(PULL_SLOW),
            calm: Calm::default(),
            force: LowPass::new(FORCE_CUTOFF),
            last: odometry_from_tool.translation.vector.xy(),
            travelled: 0.0,
            angle: 0.0,
            speed: LowPass::new(3.0),
        }
    }

    /// Returns the estimate of the hinge.
    pub fn hinge(&self) -> &Hinge {
        &self.hinge
    }

    /// Returns +1 if the door opens counter-clockwise seen from above, else -1.
    pub fn sense(&self) -> f64 {
        match self.swing {
            Swing::Pull => -self.left,
            Swing::Push => self.left,
        }
    }

    /// Takes the angle of the leaf against the wall as it is seen (rad, counter-clockwise): a leaf that stands the other
    /// way corrects what the hand's roll has told.
    pub fn see(&mut self, leaf: f64) {
        if leaf * self.sense() < -SEEN {
            self.left = -self.left;
            self.hinge = Hinge::new(1.0);
        }
    }

    /// Takes the pose of the hand and the wrench on it (N, Nm, tool axes), `dt` (s) after the last call; `delay` (s) is
    /// that of the force loop; `pace`, at most 1, slows everything down.
    pub fn update(
        &mut self,
        odometry_from_tool: &Isometry3<f64>,
        wrench: &Vector6<f64>,
        pace: f64,
        (delay, dt): (f64, f64),
    ) -> Pull {
        let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
        let torque: Vector3<f64> = wrench.fixed_rows::<3>(3).into();
        let hand = odometry_from_tool.translation.vector.xy();
        let velocity = (hand - self.last) / dt.max(1e-3);
        let speed = self.speed.update(&[velocity.x, velocity.y], dt);
        self.last = hand;
        // A loop that may give way less has to go more slowly, or it meets the same error with more force.
        let share = self.calm.update(&force, dt);
        let pace = pace * share;
        self.time += dt * pace;
        let (ahead, sense) = (horizontal(&(odometry_from_tool.rotation * Vector3::z())), self.sense());
        let way = match self.swing {
            Swing::Pull => -ahead,
            Swing::Push => ahead,
        };
        let tangent = Rotation3::from_axis_angle(&Vector3::z_axis(), self.hinge.beside()) * way.push(0.0);
        let tool_from_odometry = odometry_from_tool.rotation.inverse();
        let tangent_in_tool = tool_from_odometry * tangent;
        let up_in_tool = tool_from_odometry * Vector3::z();
        let pull = -force.dot(&tangent_in_tool);
        let [size] = self.force.update(&[force.norm()], dt);
        let [slow_pull] = self.slow.update(&[pull], dt);
        // The lever's spring counts, too.
        let beside = force - tangent_in_tool * force.dot(&tangent_in_tool);
        let [beside] = self.beside.update(&[beside.norm().min(TOTAL_MAX)], dt);
        let most = self.pull_max.min((TOTAL_MAX.powi(2) - beside.powi(2)).sqrt());
        let fade = ((most - slow_pull) / PULL_FADE).clamp(0.0, 1.0);
        let sudden = ((most + SUDDEN.1 - pull) / (SUDDEN.0 + SUDDEN.1)).clamp(0.0, 1.0);
        let top = if self.travelled < FIRST.1 { FIRST.0 } else { SPEED };
        self.top = towards(self.top, top, ACCELERATION * dt * pace);
        let damping = (slow_pull - pull) * gain_max(delay).min(1.0 / ACROSS) * share;
        let along = self.top * pace * fade.min(sudden) + damping;
        // What the wheels say counts only as far as a hand can have moved.
        let moved = velocity.dot(&tangent.xy()).clamp(0.0, along.max(0.0)) * dt;
        self.travelled += moved;
        self.angle += moved * self.hinge.curvature();
        let force_left = force.dot(&up_in_tool.cross(&tangent_in_tool));
        self.hinge.update(moved / dt.max(1e-3), force_left, sense * torque.dot(&up_in_tool), dt);
        let linear = tangent_in_tool * along;
        let angular = up_in_tool * (sense * along * self.hinge.curvature());
        let still = speed[0].hypot(speed[1]) < STALL_SPEED * pace;
        let stalls = self.time > RAMP && slow_pull > most - STALL_PULL && still;
        if stalls && self.pull_max < PULL_MAX.1.min(most + 1.0) {
            self.pull_max = (self.pull_max + LEAN * dt).min(PULL_MAX.1);
        } else {
            self.stalled = if stalls { self.stalled + dt } else { (self.stalled - dt).max(0.0) };
        }
        Pull {
            twist_in_tool: Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z),
            guide: Guide { tangent_in_tool, up_in_tool, upward: self.travelled > LEVER_FREE },
            angle: self.angle,
            failure: self.failure(size),
        }
    }

    fn failure(&mut self, size: f64) -> Option<Failure> {
        if size > FORCE_MAX {
            return Some(Failure::Force);
        }
        if self.stalled <= STALL_TIME {
            return None;
        }
        match self.swing {
            _ if self.travelled > MOVED => Some(Failure::Blocked),
            Swing::Pull => {
                let radius = self.hinge.radius();
                (self.swing, self.hinge) = (Swing::Push, Hinge::new(radius));
                (self.time, self.stalled, self.travelled, self.angle) = (0.0, 0.0, 0.0, 0.0);
                (self.pull_max, self.top, self.slow) = (PULL_MAX.0, 0.0, LowPass::new(PULL_SLOW));
                None
            }
            Swing::Push => Some(Failure::Locked),
        }
    }
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
            let mut opening = Opening::new(&pose, 0.8);
            let mut angle = 0.0;
            for _ in 0..1000 {
                let pull = opening.update(&pose, &Vector6::zeros(), 1.0, (0.03, 0.01));
                assert_eq!(pull.failure, None);
                let v = pose.rotation * Vector3::from(pull.twist_in_tool.fixed_rows::<3>(0));
                let radial = (pose.translation.vector.xy() - centre).normalize();
                angle += 0.01 * side * -radial.perp(&v.xy()) / 0.8;
                let at = centre + Vector2::new(-angle.sin(), -side * angle.cos()) * 0.8;
                pose = hand(at, -side * angle, lever_left);
            }
            // 25 mm at 0.03 m/s, then 9 s at 0.12 m/s, both with their ramps, on a radius of 0.8 m.
            assert!((angle - 1.345).abs() < 0.02, "{angle}");
            let pull = opening.update(&pose, &Vector6::zeros(), 1.0, (0.03, 0.01));
            assert!((pull.angle - angle).abs() < 0.02, "{} {angle}", pull.angle);
        }
    }

    #[test]
    fn a_locked_door_is_pulled_and_pushed() {
        let pose = hand(Vector2::zeros(), 0.0, true);
        let mut opening = Opening::new(&pose, 0.7);
        let mut pushed = false;
        let failed = (0..800).find_map(|at| {
            let against = if pushed { -65.0 } else { 65.0 };
            let pull = opening.update(&pose, &Vector6::new(0.0, 0.0, against, 0.0, 0.0, 0.0), 1.0, (0.03, 0.01));
            pushed = opening.sense() > 0.0;
            pull.failure.map(|failure| (at, failure))
        });
        // Twice a second of ramp, 20 N more at 15 N/s, and half a second without motion.
        assert!(failed.is_some_and(|(at, _)| (540..620).contains(&at)), "{failed:?}");
        assert_eq!(failed.map(|(_, failure)| failure), Some(Failure::Locked));
    }

    #[test]
    fn a_hand_that_has_rolled_with_the_lever_knows_its_side() {
        for (lever_left, x_left) in [(true, true), (true, false), (false, true), (false, false)] {
            let level = hand(Vector2::zeros(), 0.0, x_left);
            // The lever's side goes down, about the approach.
            let down = if lever_left { -0.6 } else { 0.6 };
            let roll = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), down);
            let sense = Opening::new(&(roll * level), 0.7).sense();
            assert!((sense - if lever_left { -1.0 } else { 1.0 }).abs() < 1e-12, "{lever_left} {x_left}");
        }
    }
}
