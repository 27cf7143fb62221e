//! LinearTrajectory: straight ahead.

use crate::control::ramp::Trapezoid;
use crate::message::Velocity;
use crate::sdk::{About, Arguments, Controller, Kind, Out, Outputs, Parameter, Progress, Stopping, Tick};
use comms::logic::time::Time;
use std::time::Duration;

const ACCELERATION: f64 = 0.1;

/// What it says.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// How the hand shall move.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Moves the hand straight along its approach axis.
#[derive(Debug)]
pub(super) struct LinearTrajectory {
    motion: Trapezoid,
    started: Time,
}

impl Controller for LinearTrajectory {
    type Inputs = ();
    type Outputs = Outputs;
    const TYPE: &'static str = "LinearTrajectory";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("speed", Kind::Number(0.001, 0.25)).or("0.018"),
            Parameter::new("length", Kind::Number(0.001, 2.0)).or("0.25"),
        ];
        About::task("Moves the hand straight along its approach axis, at a speed [m/s], over a length [m].")
            .every(Duration::from_millis(10))
            .with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let motion = Trapezoid::new(arguments.number("length"), arguments.number("speed"), ACCELERATION);
        Ok(Self { motion, started: Time::ZERO })
    }

    fn run(&mut self, now: Time) {
        self.started = now;
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Outputs) -> Progress {
        let time = tick.now.since(self.started).as_secs_f64();
        let mut twist = [0.0; 6];
        twist[2] = self.motion.speed_at(time);
        outputs.velocity.send(Velocity { twist, null: [0.0; 9] });
        if time > self.motion.duration() { Progress::Done(Vec::new()) } else { Progress::Continue }
    }

    fn stop(&mut self, _: Tick, _: &(), outputs: &mut Outputs) -> Stopping {
        // Whoever moves the hand learns at once, rather than when the last velocity has grown old.
        outputs.velocity.send(Velocity { twist: [0.0; 6], null: [0.0; 9] });
        Stopping::Finished
    }
}
