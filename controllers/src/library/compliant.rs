//! CompliantCtrl: the hand gives way.

use super::FRESH;
use crate::control::compliant::{Compliance, Guide};
use crate::message::{Constraint, Velocity, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Tick};
use nalgebra::{Vector3, Vector6};
use std::time::Duration;

/// Of the force loop (s), until it is measured.
const DELAY: f64 = 0.035;

/// What it hears.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The wrench on the hand.
    #[port("In1")]
    wrench: In<Wrench>,
    /// The direction in which another law leads the hand; without it the hand gives way in every direction.
    #[port("In2", optional)]
    guide: In<Constraint>,
}

/// What it says.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// How the hand shall move.
    #[port("Out1")]
    velocity: Out<Velocity>,
}

/// Moves the hand the way it is pushed, except in the direction in which another law leads it.
#[derive(Debug, Default)]
pub(super) struct CompliantCtrl {
    give: Compliance,
}

impl CompliantCtrl {
    fn twist(&mut self, tick: Tick, inputs: &Inputs) -> Option<Vector6<f64>> {
        let wrench = inputs.wrench.fresh_within(tick.now, FRESH)?;
        let guide = inputs.guide.fresh_within(tick.now, FRESH);
        // A guide that has fallen silent is not the same as none.
        if guide.is_none() && inputs.guide.received() > 0 {
            return None;
        }
        let guide = guide.map(|guide| Guide {
            tangent_in_tool: Vector3::from(guide.tangent),
            up_in_tool: Vector3::from(guide.up),
            upward: guide.upward,
        });
        let [x, y, z] = wrench.force;
        let [a, b, c] = wrench.torque;
        Some(self.give.update(&Vector6::new(x, y, z, a, b, c), guide.as_ref(), DELAY, tick.dt()))
    }
}

impl Controller for CompliantCtrl {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "CompliantCtrl";

    fn about() -> About {
        About::service("Moves the hand the way it is pushed, except where another law leads it.")
            .every(Duration::from_millis(20))
            .triggered_by("In1")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let twist = self.twist(tick, inputs).unwrap_or_else(Vector6::zeros);
        outputs.velocity.send(Velocity { twist: twist.into(), null: [0.0; 9] });
        Progress::Continue
    }
}
