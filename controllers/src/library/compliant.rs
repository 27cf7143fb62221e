//! CompliantCtrl: the hand gives way to forces.

use super::{FRESH, SENSED};
use crate::control::compliant::{ACROSS, Compliance, DELAY_MAX, Guide, STIFFNESS, gain_max, loop_delay};
use crate::message::{Constraint, Velocity, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Out, Outputs, Progress, Tick};
use comms::logic::signals::Signal;
use nalgebra::{Vector3, Vector6};
use std::time::Duration;

/// The cutoff frequency of the mean of the measured age (Hz).
const CUTOFF: f64 = 0.5;
/// The longest time for which the loop may be too slow.
const PATIENCE: Duration = Duration::from_millis(500);

/// The inputs of [`CompliantCtrl`].
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The wrench on the hand.
    #[port("In1")]
    wrench: In<Wrench>,
    /// The direction in which another law leads the hand; without it the hand gives way in every direction.
    #[port("In2", optional)]
    guide: In<Constraint>,
}

/// The outputs of [`CompliantCtrl`].
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out1")]
    velocity: Out<Velocity>,
}

/// Moves the hand in the direction in which it is pushed, except in the direction in which another law leads it.
#[derive(Debug, Default)]
pub(super) struct CompliantCtrl {
    give: Compliance,
    age: Option<f64>,
    slow_for: Duration,
}

impl CompliantCtrl {
    /// Returns the delay of the whole force loop (s).
    fn delay(&self) -> f64 {
        loop_delay(self.age.unwrap_or(0.0))
    }

    /// Measures the delay. Returns whether the loop has been too slow for too long.
    fn is_too_slow(&mut self, tick: Tick, wrench: &In<Wrench>) -> bool {
        if let Some(age) = wrench.fresh().and_then(|_| wrench.age(tick.now)) {
            let mean = self.age.get_or_insert(age.as_secs_f64());
            *mean += (age.as_secs_f64() - *mean) * (1.0 - (-std::f64::consts::TAU * CUTOFF * tick.dt()).exp());
        }
        self.slow_for = if self.delay() > DELAY_MAX { self.slow_for + tick.elapsed } else { Duration::ZERO };
        self.slow_for > PATIENCE
    }

    fn twist(&mut self, tick: Tick, inputs: &Inputs) -> Option<Vector6<f64>> {
        let wrench = inputs.wrench.fresh_within(tick.now, SENSED)?;
        let guide = inputs.guide.fresh_within(tick.now, FRESH);
        // A guide that has become silent is not the same as no guide.
        if guide.is_none() && inputs.guide.received() > 0 {
            return None;
        }
        let guide = guide.map(|guide| Guide {
            tangent_in_tool: Vector3::from(guide.tangent),
            up_in_tool: Vector3::from(guide.up),
            upward: guide.upward,
            turned: guide.turned,
        });
        let [x, y, z] = wrench.force;
        let [a, b, c] = wrench.torque;
        Some(self.give.update(&Vector6::new(x, y, z, a, b, c), guide.as_ref(), self.delay(), tick.dt()))
    }
}

impl Controller for CompliantCtrl {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "CompliantCtrl";

    fn about() -> About {
        About::service("Moves the hand in the direction in which it is pushed, except in directions in which another law leads it.")
            .every(Duration::from_millis(20))
            .triggered_by("In1")
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
        if self.is_too_slow(tick, &inputs.wrench) {
            let (is, most) = (1e3 * self.delay(), 1e3 * DELAY_MAX);
            return Progress::Aborted(format!("the force loop is too slow: {is:.0} ms of at most {most:.0} ms"));
        }
        let twist = self.twist(tick, inputs).unwrap_or_else(Vector6::zeros);
        outputs.velocity.send(Velocity::of_hand(twist.into()));
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        let signal =
            |name: &str, unit: &str, value| Signal { name: name.into(), unit: unit.into(), value, headline: false };
        vec![
            signal("force loop delay", "ms", 1e3 * self.delay()),
            signal("largest gain", "mm/s/N", 1e3 * gain_max(self.delay())),
            signal("stiffness gain delay", "", STIFFNESS * self.delay() * gain_max(self.delay()).min(1.0 / ACROSS)),
        ]
    }
}
