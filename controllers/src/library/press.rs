//! PressHandle: presses the lever that the hand holds.

use super::{SENSED, StuckForce};
use crate::control::filter::Despike;
use crate::control::press::{Press, State};
use crate::control::puma560;
use crate::message::{ArmState, FtState, GripperState, Velocity};
use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Stopping, Tick,
};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use nalgebra::Vector6;
use std::time::Duration;

/// The delay of the force loop in addition to its hops (s), and the number of its hops: sensor, this controller,
/// RedundancyResolution, Puma560Ctrl, arm.
const LAG: f64 = 0.035;
const HOPS: f64 = 4.0;
const TIMEOUT: Duration = Duration::from_secs(12);

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The arm's encoders.
    #[device("arm/state")]
    arm: In<ArmState>,
    /// The wrist sensor.
    #[device("ft/state")]
    force: In<FtState>,
    /// The gripper. Its width shows whether it holds the lever.
    #[device("gripper/state")]
    gripper: In<GripperState>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Presses a lever handle down and gives way sideways. Ends when the lever is at its stop or gives way.
#[derive(Debug)]
pub(super) struct PressHandle {
    /// The least distance between the fingers while they hold the lever (m).
    width_min: f64,
    press: Option<Press>,
    stuck: StuckForce,
    despike: Despike,
    depth: f64,
    started: Time,
}

impl Controller for PressHandle {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "PressHandle";

    fn about() -> About {
        const PARAMETERS: &[Parameter] =
            &[Parameter::new("width_min", Kind::Quantity(Quantity::Length, 0.001, 0.2)).or("0.006")];
        About::task("Presses a lever handle down until it yields, and gives way to forces from the side.")
            .remembers()
            .every(Duration::from_millis(20))
            .triggered_by("ft/state")
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            width_min: arguments.number("width_min"),
            press: None,
            stuck: StuckForce::default(),
            despike: Despike::default(),
            depth: 0.0,
            started: Time::ZERO,
        })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.press, self.stuck, self.despike, self.depth) = (None, StuckForce::default(), Despike::default(), 0.0);
        Ok(())
    }

    fn run(&mut self, now: Time) {
        self.started = now;
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let (arm, force) = (inputs.arm.fresh_within(tick.now, SENSED), inputs.force.fresh_within(tick.now, SENSED));
        if let Some(why) = inputs.force.fresh().and_then(|state| self.stuck.problem(state)) {
            return Progress::Aborted(why);
        }
        let (mut twist, mut state) = (Vector6::zeros(), State::Pressing);
        if let (Some(arm), Some(wrench)) = (arm, force) {
            let base_from_tool = puma560::forward(&arm.angles.into()).base_from_tool;
            let age = inputs.force.age(tick.now).unwrap_or_default();
            let delay = LAG + HOPS * age.as_secs_f64();
            let press = self.press.get_or_insert_with(|| Press::new(&base_from_tool));
            let ([x, y, z], [a, b, c]) = (wrench.force, wrench.torque);
            let new = Vector6::new(x, y, z, a, b, c);
            let old = self.despike.last().filter(|_| inputs.force.fresh().is_none());
            let wrench = old.unwrap_or_else(|| self.despike.update(&new));
            let down = press.update(&base_from_tool, &wrench, delay, tick.dt());
            (twist, state, self.depth) = (down.twist_in_tool, down.state, down.depth);
        }
        let lost = inputs.gripper.fresh().is_some_and(|gripper| gripper.width < self.width_min);
        if state != State::Pressing || lost {
            twist = Vector6::zeros();
        }
        outputs.velocity.send(Velocity::of_hand(twist.into()));
        match state {
            _ if lost => Progress::Aborted("lost the handle: there is nothing between the fingers".to_owned()),
            State::Down => Progress::done(&self.depth),
            State::Stuck => Progress::Aborted(format!("the lever does not go down: {:.0} mm", 1e3 * self.depth)),
            State::Pressing if tick.now.since(self.started) > TIMEOUT => {
                Progress::Aborted(format!("the lever is not down after 12 s: {:.0} mm", 1e3 * self.depth))
            }
            State::Pressing => Progress::Continue,
        }
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // The controller that moves the hand learns of the end at once, and does not have to wait until the last
        // velocity expires.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        vec![Signal { name: "depth".into(), unit: "mm".into(), value: 1e3 * self.depth, headline: false }]
    }
}
