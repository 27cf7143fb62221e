//! ConfigCtrl and AddVelocity: the arm's posture as one law among several, and the sum of the laws.

use super::FRESH;
use crate::control::puma560::Joints;
use crate::message::{JointState, Velocity};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Stopping, Tick};
use nalgebra::{SVector, Vector3};
use std::time::Duration;

const POSTURE_GAIN: f64 = 0.9;
const LINEAR_MAX: f64 = 0.25;
const ANGULAR_MAX: f64 = 0.8;

/// The inputs of [`ConfigCtrl`].
#[derive(Debug, Inputs)]
pub(super) struct ConfigInputs {
    /// The arm's joints.
    #[port("In")]
    joints: In<JointState>,
}

/// The outputs of [`ConfigCtrl`] and [`AddVelocity`].
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Keeps the arm in the posture that it has at the start, as far as this does not move the hand. So the base carries
/// the arm.
#[derive(Debug, Default)]
pub(super) struct ConfigCtrl {
    reference: Option<Joints>,
}

impl Controller for ConfigCtrl {
    type Inputs = ConfigInputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "ConfigCtrl";

    fn about() -> About {
        About::service("Keeps the arm's posture without a motion of the hand, so that the base carries the arm.")
            .remembers()
            .every(Duration::from_millis(20))
            .triggered_by("In")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, inputs: &ConfigInputs, outputs: &mut Outputs) -> Progress {
        if let Some(joints) = inputs.joints.fresh() {
            let angles = Joints::from(joints.angles);
            let back = (*self.reference.get_or_insert(angles) - angles) * POSTURE_GAIN;
            let null = std::array::from_fn(|i| if i < 3 { 0.0 } else { back[i - 3] });
            outputs.velocity.send(Velocity { null, ..Velocity::REST });
        }
        Progress::Continue
    }
}

/// The inputs of [`AddVelocity`].
#[derive(Debug, Inputs)]
pub(super) struct AddInputs {
    /// The first velocity; each new one makes a sum.
    #[port("In1")]
    first: In<Velocity>,
    /// The second.
    #[port("In2", optional)]
    second: In<Velocity>,
    /// The third.
    #[port("In3", optional)]
    third: In<Velocity>,
}

/// Adds velocities; an input without recent values counts as zero. The base does not turn if one input asks for that. A
/// velocity that brings the hand to rest is passed on alone.
#[derive(Debug)]
pub(super) struct AddVelocity;

impl Controller for AddVelocity {
    type Inputs = AddInputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "AddVelocity";

    fn about() -> About {
        About::service("Adds velocities; an input without new values is treated as zero.")
            .every(Duration::from_millis(10))
            .triggered_by("In1")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, tick: Tick, inputs: &AddInputs, outputs: &mut Outputs) -> Progress {
        let all: [&In<Velocity>; 3] = [&inputs.first, &inputs.second, &inputs.third];
        let fresh = || all.iter().filter_map(|input| input.fresh_within(tick.now, FRESH));
        if let Some(rests) = fresh().find(|velocity| velocity.rests) {
            outputs.velocity.send(rests.clone());
            return Progress::Continue;
        }
        let null: SVector<f64, 9> = fresh().map(|velocity| SVector::from(velocity.null)).sum();
        let twist: SVector<f64, 6> = fresh().map(|velocity| SVector::from(velocity.twist)).sum();
        let linear = Vector3::new(twist[0], twist[1], twist[2]).cap_magnitude(LINEAR_MAX);
        let angular = Vector3::new(twist[3], twist[4], twist[5]).cap_magnitude(ANGULAR_MAX);
        let twist = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
        let steady = fresh().any(|velocity| velocity.steady);
        outputs.velocity.send(Velocity { twist, null: null.into(), steady, rests: false });
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &AddInputs, outputs: &mut Outputs) -> Stopping {
        // The controller that moves the hand learns of the end at once, and does not have to wait until the last
        // velocity expires.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }
}
