//! Opening a door about a hinge whose position is estimated during the opening.
//!
//! The hand moves along the path of the handle that [`super::hinge`] estimates, and turns with the door. The force
//! limits the pull: the speed fades from 25 N on and is zero at 50 N. So if the door does not move, the hand pushes
//! steadily and does not tear at it. The limit of 50 N rises slowly up to 70 N, because a strong closer needs that.
//! Only the slow part of the force makes the speed fade: the slope of this fade, 0.12 m/s over 25 N, is ten times the
//! gain that a stiff grasp and a delay allow (see [`super::compliant`]). The quick part of the force only damps the
//! motion, with that gain. A force beyond the largest pull makes the speed fade at once. Unless the direction is
//! given, the hand first pulls gently, then pushes gently, and then repeats both with more force. A door that moves in
//! neither direction is locked.
//!
//! A hand that pushes a door follows it into the opening, so it cannot stay square to the leaf. As soon as the latch is
//! free, the hand lets the lever up. Then it turns about the lever as [`super::swivel`] says.
//!
//! Source: after the fused scheme that "DCA", section 5, ascribes to its reference \[9\]. The law
//! comes from the source of [`super::hinge`]: tangential velocity, compliance across, and an
//! estimate during the motion.

mod attempts;
mod lean;
mod travel;

use super::compliant::{ACROSS, Guide, gain_max};
use super::filter::LowPass;
use super::hinge::Hinge;
use super::lever::Lever;
use super::line::horizontal;
use super::oscillation::OscillationGuard;
use super::ramp::towards;
use super::swing::{HARD, Opens, Swing};
use super::swivel::{Stance, Swivel, Turn};
use attempts::Attempts;
use lean::{Lean, Leaning, PULL_FADE};
use nalgebra::{Isometry3, Rotation3, UnitQuaternion, Vector2, Vector3, Vector6};
use travel::{HandMotion, Travel};

/// Speed of the handle (m/s).
pub const SPEED: f64 = 0.12;
/// The range of the pull, relative to the largest pull (N), in which the hand gives way to a sudden
/// pull of any speed: from the first value below the largest pull to the second value above it.
const SUDDEN: (f64, f64) = (5.0, 15.0);
const SUDDEN_FIRST: (f64, f64) = (5.0, 8.0);
/// The hand does not tear at a door that may be locked: the speed (m/s) until the handle has moved
/// this distance (m), and then the acceleration (m/s²).
const FIRST: (f64, f64) = (0.02, 0.025);
const ACCELERATION: f64 = 0.12;
/// A hand that is slower than this stands still (m/s).
const STALL_SPEED: f64 = 0.02;
/// `STALL_SPEED` is scaled by the allowed speed of the hand, but by no less than this factor.
const CREEP: f64 = 0.25;
/// The lever stays pressed until the handle has gone this far (m): the latch is free by then.
const LEVER_FREE: f64 = 0.085;
/// A leaf at this angle from the wall is certainly open (rad).
const SEEN: f64 = 0.12;
/// A handle that is pushed has left its latch when it has gone this far, and is pushed so fast until the lever is up
/// (m, m/s).
const UNLATCHED: f64 = 0.025;
const LIFT_SPEED: f64 = 0.012;
/// The speed at which a handle is pushed (m/s). It is lower than `SPEED`, because the base has to get clear of the
/// jambs in the meantime.
const PUSH_SPEED: f64 = 0.09;

/// The pose of the hand and the position of the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// The pose of the hand, in the odometry frame (m).
    pub odometry_from_tool: Isometry3<f64>,
    /// The middle of the base, in the odometry frame (m).
    pub base: Vector2<f64>,
}

impl Posture {
    fn stance(&self) -> Stance {
        let Isometry3 { translation, rotation } = self.odometry_from_tool;
        Stance { hand: translation.vector.xy(), ahead: horizontal(&(rotation * Vector3::z())), base: self.base }
    }
}

/// The state of one opening.
#[derive(Clone, Debug, PartialEq)]
pub struct Opening {
    hinge: Hinge,
    /// +1 if the lever points to the left, so that a door that is pulled opens clockwise seen from above.
    left: f64,
    attempts: Attempts,
    travel: Travel,
    lean: Lean,
    lever: Lever,
    guard: OscillationGuard,
    /// The leaf against the wall as seen last (rad, counter-clockwise).
    seen: Option<f64>,
    hand: Hand,
    /// The speed at which the handle may go (m/s).
    top: f64,
    /// The estimated angle of the door (rad).
    angle: f64,
}

/// The hand on its way.
#[derive(Clone, Debug, PartialEq)]
struct Hand {
    /// Where it was when the opening began, and where it is now.
    start: Stance,
    last: Stance,
    speed: LowPass<2>,
}

impl Hand {
    /// Takes where the hand is, `dt` (s) after the last call. Returns its velocity and the slow part of its speed (m/s).
    fn advance(&mut self, stance: Stance, dt: f64) -> (Vector2<f64>, f64) {
        let velocity = (stance.hand - self.last.hand) / dt.max(1e-3);
        let [x, y] = self.speed.update(&[velocity.x, velocity.y], dt);
        self.last = stance;
        (velocity, x.hypot(y))
    }
}

/// The motion that the law asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull {
    /// Velocity of the hand (m/s, rad/s, tool axes).
    pub twist_in_tool: Vector6<f64>,
    /// The guide for compliance across the path.
    pub guide: Guide,
    /// Extra velocity of the base that does not move the hand (m/s, odometry axes).
    pub base: Vector2<f64>,
    /// The estimated angle of the door (rad).
    pub angle: f64,
    /// The slow part of the pull (N), the pull at which the hand stops (N), and the factor that slows all motion down,
    /// at most 1.
    pub effort: [f64; 3],
    /// The reason why the opening cannot continue, if there is one.
    pub failure: Option<Failure>,
}

/// A reason why an opening cannot continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The hand has pulled and pushed as far as allowed, and the door never moved.
    Locked,
    /// The door has moved, and does not move any further.
    Blocked,
}

impl Opening {
    /// Begins with a hand that holds a pressed lever. The lever points to the hinge, which is about `radius` (m) away.
    /// The hand faces the door. It has rolled with the lever, so the lever is on the side of the hand that is down.
    pub fn new(posture: &Posture, radius: f64, opens: Opens) -> Self {
        let (start, attempts) = (posture.stance(), Attempts::new(opens));
        let hand = posture.odometry_from_tool.rotation * Vector3::x();
        let leftward = hand.xy().dot(&Vector2::new(-start.ahead.y, start.ahead.x));
        // A hand that is level has not pressed: then its x axis points along the lever.
        let side = if hand.z.abs() > 0.05 { -hand.z * leftward } else { leftward };
        Self {
            hinge: Hinge::new(radius),
            left: side.signum(),
            lean: Lean::new(attempts.limits()),
            attempts,
            travel: Travel::default(),
            lever: Lever::default(),
            guard: OscillationGuard::default(),
            seen: None,
            hand: Hand { start, last: start, speed: LowPass::new(3.0) },
            top: 0.0,
            angle: 0.0,
        }
    }

    /// Returns the estimate of the hinge.
    pub fn hinge(&self) -> &Hinge {
        &self.hinge
    }

    /// Returns +1 if the door opens counter-clockwise seen from above, else -1.
    pub fn sense(&self) -> f64 {
        match self.swing() {
            Swing::Pull => -self.left,
            Swing::Push => self.left,
        }
    }

    /// Returns +1 if the hinge is to the left of a hand that faces the leaf, -1 if it is to the right.
    pub fn left(&self) -> f64 {
        self.left
    }

    /// Returns the distance from the first place of the handle to the present one (m), measured by arm and wheels.
    pub fn way(&self) -> f64 {
        (self.hand.last.hand - self.hand.start.hand).norm()
    }

    /// Returns whether the hand pushes the door.
    pub fn pushes(&self) -> bool {
        self.swing() == Swing::Push
    }

    /// Returns the angle from the hand to the leaf (rad, counter-clockwise): zero while the hand turns with the leaf.
    pub fn askew(&self) -> f64 {
        match self.swing() {
            Swing::Pull => 0.0,
            Swing::Push => self.hinge.beside(),
        }
    }

    fn swing(&self) -> Swing {
        self.attempts.swing()
    }

    /// Takes the observed angle between leaf and wall (rad, counter-clockwise). If the leaf is on the other side than
    /// the hand's roll suggested, the side of the hinge is corrected. Also takes the observed distance of the hinge
    /// (m), if it is known.
    pub fn see(&mut self, leaf: f64, radius: Option<f64>) {
        self.seen = Some(leaf);
        if let Some(radius) = radius.filter(|_| self.pushes()) {
            self.hinge.see(radius);
        }
        if leaf * self.sense() < -SEEN {
            self.left = -self.left;
            self.hinge = Hinge::new(1.0);
        }
    }

    /// Takes the posture and the wrench on the hand (N, Nm, tool axes), `dt` (s) after the last call. `delay` (s) is
    /// the delay of the force loop; `pace`, at most 1, slows all motion down.
    pub fn update(&mut self, posture: &Posture, wrench: &Vector6<f64>, pace: f64, delay: f64, dt: f64) -> Pull {
        let force: Vector3<f64> = wrench.fixed_rows::<3>(0).into();
        let torque: Vector3<f64> = wrench.fixed_rows::<3>(3).into();
        let (stance, sense, swing) = (posture.stance(), self.sense(), self.swing());
        let turned = self.hand.last.ahead.perp(&stance.ahead);
        let (velocity, speed) = self.hand.advance(stance, dt);
        let turn = self.turn(&stance, &posture.odometry_from_tool.rotation);
        // If the guard has reduced the gain, the hand has to move more slowly. Otherwise the same error would cause a
        // larger force.
        let share = self.guard.update(&force, dt);
        let pace = pace.min(share) * turn.pace;
        self.lean.pass(dt * pace);
        let way = if swing == Swing::Pull { -stance.ahead } else { stance.ahead };
        let tangent = Rotation3::from_axis_angle(&Vector3::z_axis(), self.hinge.beside()) * way.push(0.0);
        let tool_from_odometry = posture.odometry_from_tool.rotation.inverse();
        let tangent_in_tool = tool_from_odometry * tangent;
        let up_in_tool = tool_from_odometry * Vector3::z();
        let pull = -force.dot(&tangent_in_tool);
        let slow_pull = self.lean.feel(pull, dt);
        // The force of the lever's spring is included.
        let beside = (force - tangent_in_tool * force.dot(&tangent_in_tool)).norm();
        // A door that has come is the right way.
        let limits = if self.has_come() { HARD } else { self.attempts.limits() };
        let most = self.lean.most(beside, limits, dt);
        let fade = ((most - slow_pull) / PULL_FADE).clamp(0.0, 1.0);
        let from_to = if self.has_come() { SUDDEN } else { SUDDEN_FIRST };
        let sudden = ((most + from_to.1 - pull) / (from_to.0 + from_to.1)).clamp(0.0, 1.0);
        let (lifted, roll) = self.lift(&posture.odometry_from_tool, force.dot(&up_in_tool), dt);
        self.top = towards(self.top, self.top_speed(), ACCELERATION * dt * pace);
        let damping = (slow_pull - pull) * gain_max(delay).min(1.0 / ACROSS) * share;
        let along = self.top * pace * fade.min(sudden) + damping;
        let motion = HandMotion { speed: velocity.dot(&tangent.xy()), commanded: along, pull };
        let moved = self.travel.advance(&motion, &self.attempts, dt);
        let guide = Guide {
            tangent_in_tool,
            up_in_tool,
            upward: self.travel.travelled() > self.free_at(),
            turned: swing == Swing::Push,
        };
        let (rate, force_left) = (moved / dt.max(1e-3), force.dot(&guide.felt()));
        let turning = if swing == Swing::Pull {
            self.angle += moved * self.hinge.curvature();
            self.hinge.update(rate, force_left, sense * torque.dot(&up_in_tool), dt);
            sense * along * self.hinge.curvature()
        } else {
            self.angle = turn.angle;
            self.hinge.update_turning(rate, force_left, turned, sense, dt);
            turn.rate
        };
        let linear = tangent_in_tool * along + up_in_tool * lifted;
        let angular = up_in_tool * turning + Vector3::z() * roll;
        let leaning = Leaning {
            slow_pull,
            most,
            hardest: limits.pull,
            is_still: speed < STALL_SPEED * pace * (self.top / SPEED).max(CREEP),
            has_come: self.has_come(),
            is_pushed: self.pushes(),
        };
        self.lean.lean(&leaning, dt);
        Pull {
            twist_in_tool: Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z),
            guide,
            base: turn.base,
            angle: self.angle,
            failure: self.failure(),
            effort: [slow_pull, most, pace],
        }
    }

    /// The turn about the lever of a hand that pushes, once the hand may turn.
    fn turn(&self, stance: &Stance, rotation: &UnitQuaternion<f64>) -> Turn {
        let turn = Swivel::new(&self.hand.start, self.left).turn(stance, self.hinge.beside(), self.hinge.radius());
        match self.swing() {
            Swing::Push if self.lever.is_up(rotation) => turn,
            Swing::Push | Swing::Pull => Turn { rate: 0.0, pace: 1.0, base: Vector2::zeros(), ..turn },
        }
    }

    /// How far the handle has to move until the latch is free (m).
    fn free_at(&self) -> f64 {
        if self.swing() == Swing::Pull { LEVER_FREE } else { UNLATCHED }
    }

    /// Returns the speed of the hand upwards (m/s) and its roll (rad/s). The hand keeps the lever down while the latch
    /// may catch. A hand that pushes then lets the lever up, because it has to turn about it.
    fn lift(&mut self, odometry_from_tool: &Isometry3<f64>, upward: f64, dt: f64) -> (f64, f64) {
        if self.travel.travelled() < self.free_at() {
            return (self.lever.hold(odometry_from_tool.translation.z, upward, dt), 0.0);
        }
        let rise = self.pushes().then(|| self.lever.rise(&odometry_from_tool.rotation, upward, dt));
        rise.flatten().unwrap_or_default()
    }

    /// Returns whether the door has moved in the direction of the current attempt.
    fn has_come(&self) -> bool {
        self.travel.has_come(&self.attempts)
    }

    fn top_speed(&self) -> f64 {
        match self.swing() {
            _ if self.travel.travelled() < FIRST.1 => FIRST.0,
            Swing::Pull => SPEED,
            Swing::Push if self.lever.is_rising() => LIFT_SPEED,
            Swing::Push => PUSH_SPEED,
        }
    }

    fn failure(&mut self) -> Option<Failure> {
        if !self.lean.is_stalled() {
            return None;
        }
        // A grasp that slides, or wheels that slip, have not moved the leaf.
        let leaf = self.seen.map(|leaf| leaf * self.sense());
        let turned = self.travel.travelled() * self.hinge.curvature();
        let came = self.has_come() && leaf.is_none_or(|leaf| leaf > 0.5 * turned);
        if came || self.attempts.is_last() {
            return Some(if came { Failure::Blocked } else { Failure::Locked });
        }
        self.try_next();
        None
    }

    /// Begins the next attempt.
    fn try_next(&mut self) {
        let way = self.travel.restart(self.swing());
        self.attempts.next(way);
        self.lean.restart(self.attempts.limits());
        self.hinge = Hinge::new(self.hinge.radius());
        (self.top, self.angle) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hand before a door: its z axis points into the door, and its x axis, the lever, to the left or right along it.
    fn hand(at: Vector2<f64>, yaw: f64, lever_left: bool) -> Isometry3<f64> {
        let ahead = Vector3::new(yaw.cos(), yaw.sin(), 0.0);
        let left = Vector3::z().cross(&ahead);
        let lever = if lever_left { left } else { -left };
        let axes = [lever, ahead.cross(&lever), ahead];
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&axes));
        Isometry3::from_parts(Vector3::new(at.x, at.y, 1.0).into(), rotation)
    }

    /// The posture of this hand, with its base 0.8 m behind it.
    fn standing(hand: &Isometry3<f64>) -> Posture {
        let base = hand.translation.vector - hand.rotation * Vector3::z() * 0.8;
        Posture { odometry_from_tool: *hand, base: base.xy() }
    }

    #[test]
    fn opens_either_way() {
        for (lever_left, side) in [(true, 1.0), (false, -1.0)] {
            // The hinge is 0.8 m along the door; a door that follows freely opens by the commanded arc.
            let centre = Vector2::new(0.0, 0.8 * side);
            let mut pose = hand(Vector2::zeros(), 0.0, lever_left);
            let mut opening = Opening::new(&standing(&pose), 0.8, Opens::Either);
            let mut angle = 0.0;
            for _ in 0..1000 {
                let pull = opening.update(&standing(&pose), &Vector6::zeros(), 1.0, 0.03, 0.01);
                assert_eq!(pull.failure, None);
                let v = pose.rotation * Vector3::from(pull.twist_in_tool.fixed_rows::<3>(0));
                let radial = (pose.translation.vector.xy() - centre).normalize();
                angle += 0.01 * side * -radial.perp(&v.xy()) / 0.8;
                let at = centre + Vector2::new(-angle.sin(), -side * angle.cos()) * 0.8;
                pose = hand(at, -side * angle, lever_left);
            }
            // 25 mm at 0.02 m/s, then 8.6 s at 0.12 m/s, both with their ramps, on a radius of 0.8 m.
            assert!((angle - 1.28).abs() < 0.02, "{angle}");
            let pull = opening.update(&standing(&pose), &Vector6::zeros(), 1.0, 0.03, 0.01);
            assert!((pull.angle - angle).abs() < 0.02, "{} {angle}", pull.angle);
        }
    }

    #[test]
    fn a_locked_door_is_pulled_and_pushed() {
        let pose = hand(Vector2::zeros(), 0.0, true);
        let mut opening = Opening::new(&standing(&pose), 0.7, Opens::Either);
        let mut pushed = false;
        let failed = (0..2000).find_map(|at| {
            let against = if pushed { -65.0 } else { 65.0 };
            let pull =
                opening.update(&standing(&pose), &Vector6::new(0.0, 0.0, against, 0.0, 0.0, 0.0), 1.0, 0.03, 0.01);
            pushed = opening.sense() > 0.0;
            pull.failure.map(|failure| (at, failure))
        });
        // Each of six attempts has one second of ramp and half a second without motion. In addition there is the time
        // to lean 5 N harder, and twice 20 N harder, at 15 N/s.
        assert!(failed.is_some_and(|(at, _)| (1150..1250).contains(&at)), "{failed:?}");
        assert_eq!(failed.map(|(_, failure)| failure), Some(Failure::Locked));
    }

    /// A hand whose grasp has this stiffness (N/m), before a door that moves when it is pushed with `moves` (N) or
    /// more. Returns the failure, if there is one within 20 s, and the largest pull and push (N).
    fn strained(stiffness: f64, moves: f64) -> (Option<Failure>, f64, f64) {
        let mut opening = Opening::new(&standing(&hand(Vector2::zeros(), 0.0, true)), 0.7, Opens::Either);
        let (mut at, mut handle, mut pulled, mut pushed) = (0.0, 0.0f64, 0.0f64, 0.0f64);
        for _ in 0..2500 {
            let push = stiffness * (at - handle);
            handle += 0.2 * ((push - moves) / stiffness).max(0.0);
            (pulled, pushed) = (pulled.max(-push), pushed.max(push));
            let wrench = Vector6::new(0.0, 0.0, -push, 0.0, 0.0, 0.0);
            let pose = hand(Vector2::new(at, 0.0), 0.0, true);
            let pull = opening.update(&standing(&pose), &wrench, 1.0, 0.03, 0.008);
            if pull.failure.is_some() || handle > 0.02 {
                return (pull.failure, pulled, pushed);
            }
            at += 0.008 * (pose.rotation * pull.twist_in_tool.fixed_rows::<3>(0)).x;
        }
        (None, pulled, pushed)
    }

    /// The give of the fingers must not count as a motion of the door: soft fingers give by 20 mm and more in each
    /// direction.
    #[test]
    fn a_door_to_push_is_not_pulled_harder_than_it_takes_to_find_out() {
        for stiffness in [3000.0, 6000.0, 16_000.0] {
            let (failure, pulled, pushed) = strained(stiffness, 30.0);
            assert!(failure.is_none() && pulled < 50.0 && pushed < 50.0, "{stiffness}: {failure:?} {pulled} {pushed}");
            let (failure, pulled, _) = strained(stiffness, 1e6);
            assert!(failure == Some(Failure::Locked) && pulled < 80.0, "{stiffness}: {failure:?} {pulled}");
        }
    }

    #[test]
    fn a_door_that_is_told_to_be_pushed_is_not_pulled() {
        let pose = hand(Vector2::zeros(), 0.0, true);
        let mut opening = Opening::new(&standing(&pose), 0.7, Opens::Push);
        let against = Vector6::new(0.0, 0.0, -75.0, 0.0, 0.0, 0.0);
        let failed = (0..800).find_map(|_| {
            assert!(opening.pushes() && opening.sense() > 0.0);
            opening.update(&standing(&pose), &against, 1.0, 0.03, 0.01).failure
        });
        assert_eq!(failed, Some(Failure::Locked));
    }

    #[test]
    fn a_hand_that_has_rolled_with_the_lever_knows_its_side() {
        for (lever_left, x_left) in [(true, true), (true, false), (false, true), (false, false)] {
            let level = hand(Vector2::zeros(), 0.0, x_left);
            // The hand rolls about its approach, so that the lever's side goes down.
            let down = if lever_left { -0.6 } else { 0.6 };
            let roll = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), down);
            let sense = Opening::new(&standing(&(roll * level)), 0.7, Opens::Either).sense();
            assert!((sense - if lever_left { -1.0 } else { 1.0 }).abs() < 1e-12, "{lever_left} {x_left}");
        }
    }
}
