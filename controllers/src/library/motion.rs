//! LinearTrajectory: straight ahead.

use super::ramp_dt;
use crate::control::approach::{Approach, Progress as Way};
use crate::message::Velocity;
use crate::sdk::{About, Arguments, Controller, Kind, Out, Outputs, Parameter, Progress, Quantity, Stopping, Tick};
use std::time::Duration;

const ACCELERATION: f64 = 0.1;

/// The outputs of the controllers.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Moves the hand straight along its approach axis: quickly at first, slowly where it may meet something.
#[derive(Debug)]
pub(super) struct LinearTrajectory {
    way: Approach,
    at: Way,
    /// +1 ahead, -1 back.
    sense: f64,
}

impl Controller for LinearTrajectory {
    type Inputs = ();
    type Outputs = Outputs;
    const TYPE: &'static str = "LinearTrajectory";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("speed", Kind::Quantity(Quantity::Speed, 0.001, 0.25)).or("0.04"),
            Parameter::new("length", Kind::Quantity(Quantity::Length, -2.0, 2.0)).or("0.25"),
            Parameter::new("slow", Kind::Quantity(Quantity::Speed, 0.001, 0.25)).or("0.009"),
            Parameter::new("slow_after", Kind::Quantity(Quantity::Length, 0.0, 2.0)).or("0.135"),
        ];
        About::task(
            "Moves the hand straight along its approach axis over a length [m], back if negative: at a speed [m/s], \
            and slowly [m/s] after a part of the way [m].",
        )
        .remembers()
        .every(Duration::from_millis(10))
        .with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (length, fast) = (arguments.number("length"), arguments.number("speed"));
        let (slow, free) = (arguments.number("slow"), arguments.number("slow_after"));
        let way = Approach { fast, slow, free, length: length.abs(), acceleration: ACCELERATION };
        Ok(Self { way, at: Way::default(), sense: length.signum() })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.at = Way::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Outputs) -> Progress {
        self.at = self.way.advance(self.at, ramp_dt(tick));
        let mut twist = [0.0; 6];
        twist[2] = self.sense * self.at.speed;
        outputs.velocity.send(Velocity::of_hand(twist));
        if self.at.speed > 0.0 { Progress::Continue } else { Progress::Done(Vec::new()) }
    }

    fn stop(&mut self, _: Tick, _: &(), outputs: &mut Outputs) -> Stopping {
        // Whoever moves the hand learns at once, rather than when the last velocity has grown old.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }
}
