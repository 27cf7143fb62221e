//! DriveThrough: brings the robot to the other side of a door that it has opened.

use super::{SENSED, StuckLaser, distance, ramp_dt};
use crate::control::caster::Pose;
use crate::control::history::History;
use crate::control::leaf::Wall;
use crate::control::passage::Doorway;
use crate::control::puma560;
use crate::control::redundancy::{Rates, jacobian_in_base};
use crate::control::through::{Drive, Failure, Step, Sweep};
use crate::message::{ArmState, BasePose, GripperState, LaserState, Velocity};
use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Stopping, Tick,
};
use comms::logic::signals::Signal;
use nalgebra::{Isometry2, Vector3};
use std::time::Duration;

/// Fingers further apart than this hold no handle (m).
const OPEN: f64 = 0.06;
/// The longest search for leaf and wall, and the longest wait at rest for inputs that are too old.
const LOOK: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(1);

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The pose of the base.
    #[port("In")]
    pose: In<BasePose>,
    /// The arm's encoders.
    #[device("arm/state")]
    arm: In<ArmState>,
    /// The laser.
    #[device("laser/state")]
    laser: In<LaserState>,
    /// The gripper, which has let go of the handle.
    #[device("gripper/state")]
    gripper: In<GripperState>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The motion of base and arm.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Backs away from the handle, folds the arm and drives through the open door.
#[derive(Debug)]
pub(super) struct DriveThrough {
    margin: f64,
    wall: Wall,
    stuck: StuckLaser,
    drive: Option<Drive>,
    door: Option<Doorway>,
    poses: History<3>,
    joints: History<6>,
    blind: Duration,
    spent: Duration,
}

impl DriveThrough {
    /// Returns a new sweep, with the poses of base and arm at its time.
    fn sweep(&self, inputs: &Inputs) -> Option<Sweep> {
        let sweep = inputs.laser.fresh()?;
        let at = inputs.laser.measured()?;
        let points = distance::points(&sweep.ranges, std::f64::consts::PI);
        Some(Sweep { points, from: self.poses.at(at)?.into(), joints: self.joints.at(at)?.into() })
    }

    /// Measures the door that the hand has opened, and plans the drive.
    fn begin(&mut self, sweep: &Sweep) -> Result<(), Failure> {
        let base_from_tool = puma560::forward(&sweep.joints).base_from_tool;
        let seen = self.wall.update(&sweep.points, &Vector3::zeros(), &base_from_tool);
        let lines = self.wall.lines(&sweep.points, &base_from_tool).filter(|_| seen.is_some());
        let hand = base_from_tool.translation.vector.xy();
        let door = lines.and_then(|(wall, leaf)| Doorway::measured(&sweep.points, &wall, &leaf, &hand));
        let Some(door) = door else { return Ok(()) };
        let door = door.moved(&Isometry2::new(sweep.from.xy(), sweep.from.z));
        self.door = Some(door);
        self.drive = Some(Drive::new(door, &sweep.from, &base_from_tool, self.margin)?);
        Ok(())
    }
}

/// Returns the abort for a failure, with its reason.
fn refuse(failure: Failure, margin: f64) -> Progress {
    let margin = 1e3 * margin;
    let reason = match failure {
        Failure::Closes => "the door closes by itself: its leaf is not where the hand has let go of it".to_owned(),
        Failure::Narrow(missing, Some(needed)) => format!(
            "not wide enough: {:.0} mm are missing for {margin:.0} mm on each side; a leaf of this width has to be open by {:.0} deg",
            1e3 * missing,
            needed.to_degrees()
        ),
        Failure::Narrow(missing, None) => format!(
            "not wide enough: {:.0} mm are missing for {margin:.0} mm on each side, even if the door is opened further",
            1e3 * missing
        ),
        Failure::Unseen => "the laser does not see both sides of the opening".to_owned(),
        Failure::Room => "no room: something is less than 30 mm from the robot".to_owned(),
    };
    Progress::Aborted(reason)
}

impl Controller for DriveThrough {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "DriveThrough";

    fn about() -> About {
        const PARAMETERS: &[Parameter] =
            &[Parameter::new("margin", Kind::Quantity(Quantity::Length, 0.03, 0.5)).or("0.05")];
        About::task(
            "Backs away from the handle of an open door, folds the arm and drives through, with a margin [m] on each side.",
        )
        .remembers()
        .every(Duration::from_millis(20))
        .with(PARAMETERS)
        .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            margin: arguments.number("margin"),
            wall: Wall::default(),
            stuck: StuckLaser::default(),
            drive: None,
            door: None,
            poses: History::default(),
            joints: History::default(),
            blind: Duration::ZERO,
            spent: Duration::ZERO,
        })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.wall, self.stuck, self.drive, self.door) = (Wall::default(), StuckLaser::default(), None, None);
        (self.poses, self.joints) = (History::default(), History::default());
        (self.blind, self.spent) = (Duration::ZERO, Duration::ZERO);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let rest = Velocity::REST;
        self.spent += tick.elapsed;
        if let Some(why) = inputs.laser.fresh().and_then(|sweep| self.stuck.problem(&sweep.ranges)) {
            outputs.velocity.send(rest);
            return Progress::Aborted(why);
        }
        let pose = inputs.pose.fresh_within(tick.now, SENSED).zip(inputs.pose.measured());
        let arm = inputs.arm.fresh_within(tick.now, SENSED).zip(inputs.arm.measured());
        let gripper = inputs.gripper.fresh_within(tick.now, SENSED);
        let is_seeing = inputs.laser.fresh_within(tick.now, SENSED).is_some();
        let (Some((pose, moved)), Some((arm, turned)), Some(gripper), true) = (pose, arm, gripper, is_seeing) else {
            // Without sensors the controller does not move the robot. The other controllers receive a fresh zero.
            outputs.velocity.send(rest);
            self.blind += tick.elapsed;
            let why = "inputs are too old: odometry, joint angles, the laser or the gripper's width";
            return if self.blind > PATIENCE { Progress::Aborted(why.to_owned()) } else { Progress::Continue };
        };
        self.blind = Duration::ZERO;
        self.poses.push(moved, pose.pose);
        self.joints.push(turned, arm.angles);
        let (base, joints) = (Pose::from(pose.pose), puma560::Joints::from(arm.angles));
        if gripper.width < OPEN {
            outputs.velocity.send(rest);
            return Progress::Aborted("the fingers are not open: they may hold the handle".to_owned());
        }
        let sweep = self.sweep(inputs);
        if let (None, Some(sweep)) = (&self.drive, &sweep)
            && let Err(failure) = self.begin(sweep)
        {
            outputs.velocity.send(rest);
            return refuse(failure, self.margin);
        }
        let step = match &mut self.drive {
            Some(drive) => drive.update(&base, &joints, sweep.as_ref(), ramp_dt(tick)),
            None if self.spent > LOOK => {
                outputs.velocity.send(rest);
                let why =
                    "no open leaf in front of the hand: the door closes by itself, or the laser does not see the leaf";
                return Progress::Aborted(why.to_owned());
            }
            None => Step::Move(Rates::zeros()),
        };
        match step {
            Step::Move(rates) => {
                // All nine rates have to stay unchanged: the motion of the hand follows from them.
                let forward = puma560::forward(&joints);
                let twist = jacobian_in_base(&forward) * rates;
                let tool = forward.base_from_tool.rotation.inverse();
                let (linear, angular) = (tool * twist.fixed_rows::<3>(0), tool * twist.fixed_rows::<3>(3));
                let twist = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
                outputs.velocity.send(Velocity { null: rates.into(), ..Velocity::of_hand(twist) });
                Progress::Continue
            }
            Step::Through => {
                outputs.velocity.send(rest);
                let room = self.drive.as_ref().and_then(Drive::clearance);
                Progress::done(&room)
            }
            Step::Failed(failure) => {
                outputs.velocity.send(rest);
                refuse(failure, self.margin)
            }
        }
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // The controller that moves the base learns of the end at once, and does not have to wait until the last
        // velocity expires.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        let signal =
            |name: &str, unit: &str, value| Signal { name: name.into(), unit: unit.into(), value, headline: false };
        let clearance = self.drive.as_ref().and_then(Drive::clearance).unwrap_or(f64::NAN);
        let of_door = |number: fn(&Doorway) -> f64| self.door.as_ref().map_or(f64::NAN, number);
        vec![
            signal("part", "", self.drive.as_ref().map_or(0.0, |drive| f64::from(drive.stage()))),
            signal("leaf angle", "deg", of_door(Doorway::angle).to_degrees()),
            signal("leaf width", "m", of_door(Doorway::width)),
            signal("clearance", "mm", 1e3 * clearance),
        ]
    }
}
