//! Motion control at the level of the robot: it follows a planned way.
//!
//! The robot steers to a point on its way that lies a little ahead of it (pure pursuit), and slows down before the end.
//! Source: Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm (1992).

use super::base::Twist;
use super::museum::{Point, wrapped};
use super::sonar::Walls;
use super::{FRESH, FloorPose, PERIOD, TourLeg, start};
use controllers::sdk::{About, Arguments, Controller, In, Inputs, Out, Outcome, Outputs, Progress, Stopping, Tick};

/// The usual speed (m/s). The pace of the executive is a factor for it.
const SPEED: f64 = 0.7;
const PACE_MAX: f64 = 1.5;
/// The deceleration before the end of the way (m/s²).
const BRAKE: f64 = 0.6;
/// How far ahead on its way the robot looks.
const AHEAD: f64 = 0.4;
/// The distance at which the end counts as reached.
const NEAR: f64 = 0.12;
/// The robot turns on the spot if the way leads further aside than this.
const ASIDE_MAX: f64 = 0.8;
/// The free way that the robot needs to go ahead, and how long it waits for this (s).
const FREE: f64 = 0.25;
const BLOCKED_MAX: f64 = 4.0;

#[derive(Inputs)]
pub(super) struct DriveInputs {
    /// Where the robot is.
    #[port("Pose")]
    pose: In<FloorPose>,
    /// The walls around it.
    #[port("Walls")]
    walls: In<Walls>,
    /// The pace that a visitor wants: 1 is the usual pace.
    #[port("Pace", optional)]
    pace: In<f64>,
}

#[derive(Outputs)]
pub(super) struct DriveOutputs {
    /// How the base shall move.
    #[port("Twist")]
    twist: Out<Twist>,
}

/// Follows the way to an exhibit.
#[derive(Default)]
pub(super) struct DriveLeg {
    leg: TourLeg,
    /// The number of the next corner.
    corner: usize,
    /// How long the way has not been free (s).
    blocked: f64,
}

/// The part of a way that lies before the robot.
struct Before {
    /// Where to steer.
    target: Point,
    /// The length of the rest of the way.
    rest: f64,
}

impl DriveLeg {
    fn corners(&self) -> impl Iterator<Item = Point> {
        self.leg.x.iter().zip(&self.leg.y).map(|(x, y)| Point::new(*x, *y))
    }

    /// Passes the corners that are reached; returns the rest of the way. None at its end.
    fn follow(&mut self, from: Point) -> Option<Before> {
        let corners: Vec<Point> = self.corners().collect();
        while self.corner + 1 < corners.len() && from.distance(corners[self.corner]) < AHEAD {
            self.corner += 1;
        }
        let target = *corners.get(self.corner)?;
        let ahead = corners[self.corner..].windows(2).map(|pair| pair[0].distance(pair[1])).sum::<f64>();
        let rest = from.distance(target) + ahead;
        (rest > NEAR).then_some(Before { target, rest })
    }
}

/// Returns the motion towards a point.
fn towards(pose: FloorPose, before: &Before, pace: f64) -> Twist {
    let direction = (before.target.y - pose.y).atan2(before.target.x - pose.x);
    let aside = wrapped(direction - pose.yaw);
    if aside.abs() > ASIDE_MAX {
        return Twist { forward: 0.0, turn: 1.5 * aside.signum() };
    }
    let speed = (SPEED * pace).min((2.0 * BRAKE * before.rest).sqrt()).max(0.08);
    Twist { forward: speed * aside.cos(), turn: 2.0 * aside }
}

impl Controller for DriveLeg {
    type Inputs = DriveInputs;
    type Outputs = DriveOutputs;
    const TYPE: &'static str = "DriveLeg";

    fn about() -> About {
        const OUTCOMES: &[Outcome] =
            &[Outcome { tag: "arrived", type_name: None }, Outcome { tag: "blocked", type_name: None }];
        About::task("Follows the way to an exhibit.").every(PERIOD).starts_with::<TourLeg>().ends_with(OUTCOMES)
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, value: &[u8]) -> Result<(), String> {
        *self = Self { leg: start(value)?, corner: 0, blocked: 0.0 };
        let is_sound = self.leg.x.len() == self.leg.y.len() && !self.leg.x.is_empty();
        if is_sound { Ok(()) } else { Err("the way has no end".to_owned()) }
    }

    fn main_calc(&mut self, tick: Tick, inputs: &DriveInputs, outputs: &mut DriveOutputs) -> Progress {
        let walls = inputs.walls.fresh_within(tick.now, FRESH);
        let (Some(pose), Some(walls)) = (inputs.pose.fresh_within(tick.now, FRESH).copied(), walls) else {
            outputs.twist.send(Twist::default());
            return Progress::Continue;
        };
        let Some(before) = self.follow(Point::new(pose.x, pose.y)) else {
            return Progress::outcome("arrived", &());
        };
        let pace = inputs.pace.latest().copied().unwrap_or(1.0).clamp(0.2, PACE_MAX);
        let mut twist = towards(pose, &before, pace);
        let is_blocked = twist.forward > 0.0 && walls.ahead < FREE.min(before.rest);
        self.blocked = if is_blocked { self.blocked + tick.dt() } else { 0.0 };
        if is_blocked {
            twist.forward = 0.0;
        }
        if self.blocked > BLOCKED_MAX {
            return Progress::outcome("blocked", &());
        }
        outputs.twist.send(twist);
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &DriveInputs, outputs: &mut DriveOutputs) -> Stopping {
        outputs.twist.send(Twist::default());
        Stopping::Finished
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_turns_first_and_slows_down_before_the_end() {
        let pose = FloorPose::default();
        let target = |x, y, rest| Before { target: Point::new(x, y), rest };
        let behind = towards(pose, &target(-1.0, 0.1, 1.0), 1.0);
        assert!(behind.forward == 0.0 && behind.turn > 0.0);
        let [far, near] = [5.0, 0.2].map(|rest| towards(pose, &target(rest, 0.0, rest), 1.0).forward);
        assert!((far - SPEED).abs() < 1e-9 && near < 0.6, "{far} {near}");
    }

    #[test]
    fn a_way_ends_at_its_last_corner() {
        let leg = TourLeg { number: 1.0, stops: vec![1.0], x: vec![1.0, 1.0], y: vec![0.0, 1.0] };
        let mut drive = DriveLeg { leg, ..DriveLeg::default() };
        assert!((drive.follow(Point::new(0.0, 0.0)).unwrap().rest - 2.0).abs() < 1e-9);
        assert!(drive.follow(Point::new(1.0, 0.0)).unwrap().target == Point::new(1.0, 1.0));
        assert!(drive.follow(Point::new(1.0, 0.95)).is_none());
    }
}
