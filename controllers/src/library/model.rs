//! ModelBasedCtrl: opens the door about the hinge that it finds.

use super::FRESH;
use crate::control::caster::Pose;
use crate::control::door::{Failure, Opening, Pull};
use crate::control::puma560;
use crate::message::{BasePose, Constraint, JointState, Velocity, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Tick};
use comms::logic::signals::Signal;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::time::Duration;

/// The longest an opening may take.
const TIMEOUT: Duration = Duration::from_secs(40);

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
    spent: Duration,
}

impl ModelBasedCtrl {
    /// The hand in the odometry frame, while everything is fresh.
    fn hand(tick: Tick, inputs: &Inputs) -> Option<(Isometry3<f64>, Vector3<f64>)> {
        let wrench = inputs.wrench.fresh_within(tick.now, FRESH)?;
        let joints = inputs.joints.fresh_within(tick.now, FRESH)?;
        let pose = Pose::from(inputs.pose.fresh_within(tick.now, FRESH)?.pose);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.z);
        let odometry_from_base = Isometry3::from_parts(Vector3::new(pose.x, pose.y, 0.0).into(), yaw);
        let base_from_tool = puma560::forward(&joints.angles.into()).base_from_tool;
        Some((odometry_from_base * base_from_tool, Vector3::from(wrench.force)))
    }

    fn result(&self, pull: &Pull) -> Progress {
        let radius = self.opening.as_ref().map_or(self.radius, |opening| opening.hinge().radius());
        let valid = self.opening.as_ref().is_some_and(|opening| opening.hinge().is_valid());
        match pull.failure {
            Some(Failure::Blocked) => Progress::Aborted("blocked: it pulls and the door does not move".to_owned()),
            Some(Failure::Force) => Progress::Aborted("the force on the hand exceeds 150 N".to_owned()),
            None if valid && pull.angle >= self.goal => Progress::Done(super::value(&[pull.angle, radius])),
            None if self.spent > TIMEOUT => Progress::Aborted("the door is not open after 40 s".to_owned()),
            None => Progress::Continue,
        }
    }
}

impl Controller for ModelBasedCtrl {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "ModelBasedCtrl";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("goal", Kind::Number(0.1, 2.5)).or("1.2217"),
            Parameter::new("radius", Kind::Number(0.3, 1.5)).or("0.7"),
        ];
        About::task("Pulls a door open to an angle [rad] about its hinge, first guessed at a radius [m].")
            .every(Duration::from_millis(20))
            .triggered_by("In1")
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (goal, radius) = (arguments.number("goal"), arguments.number("radius"));
        Ok(Self { goal, radius, opening: None, angle: 0.0, spent: Duration::ZERO })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.opening, self.angle, self.spent) = (None, 0.0, Duration::ZERO);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        self.spent += tick.elapsed;
        let Some((hand, force)) = Self::hand(tick, inputs) else {
            // Without eyes it does not pull; the others see a fresh zero.
            outputs.velocity.send(Velocity { twist: [0.0; 6], null: [0.0; 9] });
            return if self.spent > TIMEOUT {
                Progress::Aborted("no forces, joint angles or odometry".to_owned())
            } else {
                Progress::Continue
            };
        };
        let opening = self.opening.get_or_insert_with(|| Opening::new(&hand, self.radius));
        let pull = opening.update(&hand, &force, tick.dt());
        self.angle = pull.angle;
        outputs.velocity.send(Velocity { twist: pull.twist_in_tool.into(), null: [0.0; 9] });
        outputs.guide.send(Constraint {
            tangent: pull.guide.tangent_in_tool.into(),
            up: pull.guide.up_in_tool.into(),
            upward: pull.guide.upward,
        });
        self.result(&pull)
    }

    fn signals(&self) -> Vec<Signal> {
        let radius = self.opening.as_ref().map_or(f64::NAN, |opening| opening.hinge().radius());
        let signal =
            |name: &str, unit: &str, value| Signal { name: name.into(), unit: unit.into(), value, headline: false };
        vec![signal("estimated angle", "deg", self.angle.to_degrees()), signal("estimated radius", "m", radius)]
    }
}
