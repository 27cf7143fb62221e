//! PressHandle: presses the lever that the hand holds.

use super::FRESH;
use crate::control::press::Press;
use crate::control::puma560;
use crate::message::{ArmState, FtState, Velocity};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Stopping, Tick};
use comms::logic::time::Time;
use nalgebra::Vector6;
use std::time::Duration;

const TIMEOUT: Duration = Duration::from_secs(8);

/// What it hears.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The arm's encoders.
    #[device("arm/state")]
    arm: In<ArmState>,
    /// The wrist sensor.
    #[device("ft/state")]
    force: In<FtState>,
}

/// What it says.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// How the hand shall move.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Presses a lever handle down, giving way sideways; ends when it is down.
#[derive(Debug, Default)]
pub(super) struct PressHandle {
    press: Option<Press>,
    started: Time,
}

impl Controller for PressHandle {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "PressHandle";

    fn about() -> About {
        About::task("Presses a lever handle down, giving way sideways.")
            .every(Duration::from_millis(20))
            .triggered_by("ft/state")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn run(&mut self, now: Time) {
        self.started = now;
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let (arm, force) = (inputs.arm.fresh_within(tick.now, FRESH), inputs.force.fresh_within(tick.now, FRESH));
        let (mut twist, mut finished) = (Vector6::zeros(), false);
        if let (Some(arm), Some(wrench)) = (arm, force) {
            let base_from_tool = puma560::forward(&arm.angles.into()).base_from_tool;
            let press = self.press.get_or_insert_with(|| Press::new(&base_from_tool));
            let ([x, y, z], [a, b, c]) = (wrench.force, wrench.torque);
            let down = press.update(&base_from_tool, &Vector6::new(x, y, z, a, b, c));
            (twist, finished) = (down.twist_in_tool, down.finished);
        }
        if finished {
            twist = Vector6::zeros();
        }
        outputs.velocity.send(Velocity { twist: twist.into(), null: [0.0; 9] });
        if finished {
            Progress::Done(Vec::new())
        } else if tick.now.since(self.started) > TIMEOUT {
            Progress::Aborted("the lever is not down after 8 s".to_owned())
        } else {
            Progress::Continue
        }
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // Whoever moves the hand learns at once, rather than when the last velocity has grown old.
        outputs.velocity.send(Velocity { twist: [0.0; 6], null: [0.0; 9] });
        Stopping::Finished
    }
}
