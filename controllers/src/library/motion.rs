//! LinearTrajectory: moves the hand straight ahead.

use super::{FRESH, StuckForce, ramp_dt};
use crate::control::approach::{Approach, Progress as Way};
use crate::message::{FtState, Velocity};
use crate::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Stopping, Tick,
};
use std::time::Duration;

const ACCELERATION: f64 = 0.1;

/// The longest wait at rest for the wrist sensor.
const PATIENCE: Duration = Duration::from_secs(1);

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The wrist sensor, without which a hand that is to touch something does not move.
    #[device("ft/state")]
    force: In<FtState>,
}

/// The outputs of the controllers.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out")]
    velocity: Out<Velocity>,
}

/// Moves the hand straight along its approach axis: fast at first, slowly where it may meet something. A hand that has
/// to touch something moves only while the wrist sensor works, and fails if it reaches the end of its path.
#[derive(Debug)]
pub(super) struct LinearTrajectory {
    way: Approach,
    at: Way,
    /// +1 for ahead, -1 for back.
    sense: f64,
    /// Whether the hand has to touch something on the way.
    touches: bool,
    stuck: StuckForce,
    /// The time since the wrist sensor was fresh.
    numb: Duration,
}

impl LinearTrajectory {
    /// Returns whether a hand that has to touch something feels now. The error is the reason why it will not feel any
    /// more.
    fn feels(&mut self, tick: Tick, force: &In<FtState>) -> Result<bool, String> {
        if !self.touches {
            return Ok(true);
        }
        if let Some(why) = force.fresh().and_then(|state| self.stuck.problem(state)) {
            return Err(why);
        }
        let feels = force.fresh_within(tick.now, FRESH).is_some();
        self.numb = if feels { Duration::ZERO } else { self.numb + tick.elapsed };
        if self.numb > PATIENCE { Err("no word from the force sensor for 1 s".to_owned()) } else { Ok(feels) }
    }
}

impl Controller for LinearTrajectory {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "LinearTrajectory";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("speed", Kind::Quantity(Quantity::Speed, 0.001, 0.25)).or("0.04"),
            Parameter::new("length", Kind::Quantity(Quantity::Length, -2.0, 2.0)).or("0.25"),
            Parameter::new("slow", Kind::Quantity(Quantity::Speed, 0.001, 0.25)).or("0.009"),
            Parameter::new("slow_after", Kind::Quantity(Quantity::Length, 0.0, 2.0)).or("0.135"),
            Parameter::new("until", Kind::Text(&["end", "touch"])).or("end"),
        ];
        About::task(
            "Moves the hand straight along its approach axis over a length [m], back if negative: at a speed [m/s], \
            and slowly [m/s] after a part of the way [m]. Until a \"touch\" it moves while the wrist sensor is heard, and fails at the end \
            of the way.",
        )
        .remembers()
        .every(Duration::from_millis(10))
        .with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (length, fast) = (arguments.number("length"), arguments.number("speed"));
        let (slow, free) = (arguments.number("slow"), arguments.number("slow_after"));
        let way = Approach { fast, slow, free, length: length.abs(), acceleration: ACCELERATION };
        let (touches, stuck) = (arguments.text("until") == "touch", StuckForce::default());
        Ok(Self { way, at: Way::default(), sense: length.signum(), touches, stuck, numb: Duration::ZERO })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.at, self.stuck, self.numb) = (Way::default(), StuckForce::default(), Duration::ZERO);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        match self.feels(tick, &inputs.force) {
            Ok(true) => self.at = self.way.advance(self.at, ramp_dt(tick)),
            Ok(false) => {
                self.at.speed = 0.0;
                outputs.velocity.send(Velocity::REST);
                return Progress::Continue;
            }
            Err(why) => return Progress::Aborted(why),
        }
        let mut twist = [0.0; 6];
        twist[2] = self.sense * self.at.speed;
        outputs.velocity.send(Velocity::of_hand(twist));
        if self.at.speed > 0.0 {
            Progress::Continue
        } else if self.touches {
            Progress::Aborted(format!("nothing was touched on the path of {:.0} mm", 1e3 * self.way.length))
        } else {
            Progress::Done(Vec::new())
        }
    }

    fn stop(&mut self, _: Tick, _: &Inputs, outputs: &mut Outputs) -> Stopping {
        // The controller that moves the hand learns of the end at once, and does not have to wait until the last
        // velocity expires.
        outputs.velocity.send(Velocity::REST);
        Stopping::Finished
    }
}
