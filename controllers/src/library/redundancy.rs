//! RedundancyResolution: distributes one velocity of the hand over base and arm.

use super::{FRESH, SENSED, Watch, ramp_dt};
use crate::control::redundancy::{Motion, Rates, Resolver};
use crate::message::{BaseVelocity, JointState, JointVelocity, Velocity};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Tick};
use comms::logic::signals::Signal;
use nalgebra::Vector6;
use std::time::Duration;

/// After a gap this long the drives have stopped by themselves (s).
const GAP: f64 = 0.08;

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The velocity of the hand.
    #[port("In")]
    velocity: In<Velocity>,
    /// The arm's joints.
    #[port("In1")]
    joints: In<JointState>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the base.
    #[port("Out1")]
    base: Out<BaseVelocity>,
    /// The rates of the arm's joints.
    #[port("Out2")]
    arm: Out<JointVelocity>,
}

/// Distributes the velocity of the hand over base and arm; without a command, brings both to rest.
#[derive(Debug, Default)]
pub(super) struct RedundancyResolution {
    resolver: Resolver,
    watch: Watch,
    rests: bool,
    singular_value: f64,
    scaling: f64,
}

impl Controller for RedundancyResolution {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "RedundancyResolution";

    fn about() -> About {
        About::service(
            "Divides the velocity of the hand between base and arm; without a command, base and arm come to rest.",
        )
        .every(Duration::from_millis(10))
        .triggered_by("In")
        .signals_every(Duration::from_millis(100))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let joints = inputs.joints.fresh_within(tick.now, SENSED);
        if self.watch.is_silent(tick.now, joints.is_some()) {
            return Progress::Aborted("no joint angles for 1 s".to_owned());
        }
        if let Some(joints) = joints.filter(|_| tick.dt() > GAP) {
            self.resolver.restart(Rates::from_fn(|i, _| if i < 3 { 0.0 } else { joints.rates[i - 3] }));
        }
        let rates = match (joints, inputs.velocity.fresh_within(tick.now, FRESH)) {
            (Some(joints), Some(velocity)) => {
                let (twist_in_tool, null) = (Vector6::from(velocity.twist), Rates::from(velocity.null));
                let motion = Motion { twist_in_tool, null, steady: velocity.steady, rests: velocity.rests };
                self.rests = velocity.moves_nothing() && (velocity.rests || self.rests);
                let resolved = self.resolver.resolve(&joints.angles.into(), &motion, ramp_dt(tick));
                self.singular_value = resolved.singular_value_min;
                self.scaling = resolved.scaling;
                resolved.rates
            }
            (Some(joints), None) => self.resolver.rest(&joints.angles.into(), ramp_dt(tick)),
            (None, _) => {
                self.resolver.restart(Rates::zeros());
                Rates::zeros()
            }
        };
        outputs.base.send(BaseVelocity { rates: std::array::from_fn(|i| rates[i]) });
        outputs.arm.send(JointVelocity { rates: std::array::from_fn(|i| rates[i + 3]), rests: self.rests });
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        let signal = |name: &str, value| Signal { name: name.into(), unit: String::new(), value, headline: false };
        vec![signal("smallest singular value", self.singular_value), signal("speed scaling", self.scaling)]
    }
}
