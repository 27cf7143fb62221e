//! LookAround: finds a handle that is out of sight.

use super::SENSED;
use crate::control::filter::Debounce;
use crate::control::look::Search;
use crate::control::puma560;
use crate::message::{ArmState, CameraState, Velocity};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Stopping, Tick};
use nalgebra::Vector3;
use std::time::Duration;

const IN_A_ROW: u32 = 3;

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The camera.
    #[device("camera/state")]
    camera: In<CameraState>,
    /// The arm's encoders, for which way is up.
    #[device("arm/state")]
    arm: In<ArmState>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Moves the hand back and turns it to both sides until its camera sees the whole lever.
#[derive(Debug)]
pub(super) struct LookAround {
    search: Search,
    seen: Debounce,
}

impl Controller for LookAround {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "LookAround";

    fn about() -> About {
        About::task(
            "Moves the hand back, and turns it to both sides until its camera sees the whole lever. Ends at once if the camera already \
             sees it.",
        )
        .remembers()
        .every(Duration::from_millis(20))
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self { search: Search::default(), seen: Debounce::new(IN_A_ROW) })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.search, self.seen) = (Search::default(), Debounce::new(IN_A_ROW));
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let mut twist = [0.0; 6];
        let seen = inputs.camera.fresh().map(|image| image.marks.iter().all(Option::is_some));
        if seen.is_some_and(|seen| self.seen.update(seen)) {
            outputs.velocity.send(Velocity::of_hand(twist));
            return Progress::Done(Vec::new());
        }
        if let Some(arm) = inputs.arm.fresh_within(tick.now, SENSED) {
            let rotation = puma560::forward(&arm.angles.into()).base_from_tool.rotation;
            match self.search.advance(&(rotation.inverse() * Vector3::z()), super::ramp_dt(tick)) {
                Ok(found) => twist = found.into(),
                Err(_nowhere) => return Progress::Aborted("the handle is nowhere to be seen".to_owned()),
            }
        }
        outputs.velocity.send(Velocity::of_hand(twist));
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // The controller that moves the hand learns of the end at once, and does not have to wait until the last
        // velocity expires.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }
}
