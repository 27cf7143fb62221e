//! ModelBasedCtrl: opens the door about the hinge that it finds.

use super::FRESH;
use crate::control::caster::Pose;
use crate::control::door::{Failure, Opening, Pull};
use crate::control::opened::{Doubt, Evidence, Expected};
use crate::control::puma560;
use crate::message::{BasePose, Constraint, GripperState, JointState, Velocity, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Tick};
use comms::logic::signals::Signal;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::time::Duration;

/// The longest an opening may take.
const TIMEOUT: Duration = Duration::from_secs(40);
/// How long it stands still and waits for inputs that are too old to be believed.
const PATIENCE: Duration = Duration::from_secs(1);

/// What it hears.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The wrench on the hand.
    #[port("In1")]
    wrench: In<Wrench>,
    /// The arm's joints.
    #[port("In2")]
    joints: In<JointState>,
    /// Where the base is.
    #[port("In3")]
    pose: In<BasePose>,
    /// The gripper, which holds the handle as long as its width says so.
    #[device("gripper/state")]
    gripper: In<GripperState>,
}

/// What it says.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// How the hand shall move.
    #[port("Out1")]
    velocity: Out<Velocity>,
    /// Where it leads the hand, for compliance beside it.
    #[port("Out2")]
    guide: Out<Constraint>,
}

/// Pulls a door open about its hinge, which it finds meanwhile; ends at an angle, or when nothing moves.
#[derive(Debug)]
pub(super) struct ModelBasedCtrl {
    goal: f64,
    radius: f64,
    opening: Option<Opening>,
    angle: f64,
    turned: f64,
    expected: Expected,
    /// For how long an input has been too old.
    blind: Duration,
    spent: Duration,
}

impl ModelBasedCtrl {
    /// The hand in the odometry frame, the force on it (N) and the width between the fingers (m), while everything is
    /// fresh.
    fn hand(tick: Tick, inputs: &Inputs) -> Option<(Isometry3<f64>, Vector3<f64>, f64)> {
        let gripper = inputs.gripper.fresh_within(tick.now, FRESH)?;
        let wrench = inputs.wrench.fresh_within(tick.now, FRESH)?;
        let joints = inputs.joints.fresh_within(tick.now, FRESH)?;
        let pose = Pose::from(inputs.pose.fresh_within(tick.now, FRESH)?.pose);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.z);
        let odometry_from_base = Isometry3::from_parts(Vector3::new(pose.x, pose.y, 0.0).into(), yaw);
        let base_from_tool = puma560::forward(&joints.angles.into()).base_from_tool;
        Some((odometry_from_base * base_from_tool, Vector3::from(wrench.force), gripper.width))
    }

    fn result(&self, pull: &Pull, width: f64) -> Progress {
        let radius = self.opening.as_ref().map_or(self.radius, |opening| opening.hinge().radius());
        let valid = self.opening.as_ref().is_some_and(|opening| opening.hinge().is_valid());
        match pull.failure {
            Some(Failure::Blocked) => Progress::Aborted("blocked: it pulls and the door does not move".to_owned()),
            Some(Failure::Force) => Progress::Aborted("the force on the hand exceeds 150 N".to_owned()),
            None if !self.expected.holds(width) => refuse(Doubt::Handle),
            None if valid && pull.angle >= self.goal => {
                let evidence = Evidence { width, angle: pull.angle, turned: pull.turned, radius };
                let doubt = self.expected.doubt(&evidence);
                doubt.map_or_else(|| Progress::Done(super::value(&[pull.angle, radius])), refuse)
            }
            None if self.spent > TIMEOUT => Progress::Aborted("the door is not open after 40 s".to_owned()),
            None => Progress::Continue,
        }
    }
}

/// The reason for a doubt.
fn refuse(doubt: Doubt) -> Progress {
    let reason = match doubt {
        Doubt::Handle => "lost the handle: the fingers are not as far apart as a handle is wide",
        Doubt::Turn => "the hand has not turned with the door: its direction and the estimated angle differ",
        Doubt::Hinge => "the hinge estimate is not sane: its radius is no door's",
    };
    Progress::Aborted(reason.to_owned())
}

impl Controller for ModelBasedCtrl {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "ModelBasedCtrl";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("goal", Kind::Number(0.1, 2.5)).or("1.2217"),
            Parameter::new("radius", Kind::Number(0.3, 1.5)).or("0.7"),
            Parameter::new("width_min", Kind::Number(0.001, 0.2)).or("0.006"),
            Parameter::new("width_max", Kind::Number(0.001, 0.2)).or("0.07"),
            Parameter::new("radius_min", Kind::Number(0.1, 1.5)).or("0.3"),
            Parameter::new("radius_max", Kind::Number(0.3, 3.0)).or("1.5"),
        ];
        About::task("Pulls a door open to an angle [rad] about its hinge, first guessed at a radius [m]; ends only if it holds the handle.")
            .every(Duration::from_millis(20))
            .triggered_by("In1")
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let expected = Expected {
            width: (arguments.number("width_min"), arguments.number("width_max")),
            radius: (arguments.number("radius_min"), arguments.number("radius_max")),
        };
        let ((width_min, width_max), (radius_min, radius_max)) = (expected.width, expected.radius);
        if width_min > width_max || radius_min > radius_max {
            return Err("`width_min` and `radius_min` must not exceed `width_max` and `radius_max`".to_owned());
        }
        let (goal, radius) = (arguments.number("goal"), arguments.number("radius"));
        let (blind, spent) = (Duration::ZERO, Duration::ZERO);
        Ok(Self { goal, radius, opening: None, angle: 0.0, turned: 0.0, expected, blind, spent })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.opening, self.angle, self.turned) = (None, 0.0, 0.0);
        (self.blind, self.spent) = (Duration::ZERO, Duration::ZERO);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        self.spent += tick.elapsed;
        let Some((hand, force, width)) = Self::hand(tick, inputs) else {
            // Without eyes it does not pull; the others see a fresh zero.
            outputs.velocity.send(Velocity { twist: [0.0; 6], null: [0.0; 9] });
            self.blind += tick.elapsed;
            return if self.blind > PATIENCE {
                Progress::Aborted(
                    "inputs are too old: forces, joint angles, odometry or the gripper's width".to_owned(),
                )
            } else {
                Progress::Continue
            };
        };
        self.blind = Duration::ZERO;
        let opening = self.opening.get_or_insert_with(|| Opening::new(&hand, self.radius));
        let pull = opening.update(&hand, &force, tick.dt());
        (self.angle, self.turned) = (pull.angle, pull.turned);
        outputs.velocity.send(Velocity { twist: pull.twist_in_tool.into(), null: [0.0; 9] });
        outputs.guide.send(Constraint {
            tangent: pull.guide.tangent_in_tool.into(),
            up: pull.guide.up_in_tool.into(),
            upward: pull.guide.upward,
        });
        self.result(&pull, width)
    }

    fn signals(&self) -> Vec<Signal> {
        let radius = self.opening.as_ref().map_or(f64::NAN, |opening| opening.hinge().radius());
        let signal =
            |name: &str, unit: &str, value| Signal { name: name.into(), unit: unit.into(), value, headline: false };
        vec![
            signal("estimated angle", "deg", self.angle.to_degrees()),
            signal("estimated radius", "m", radius),
            signal("hand turned", "deg", self.turned.to_degrees()),
        ]
    }
}
