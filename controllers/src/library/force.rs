//! The wrist sensor and what watches it.

use super::Watch;
use crate::control::filter::Debounce;
use crate::message::{FtCommand, FtState, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Kind, Parameter, Progress, Tick};
use nalgebra::Vector3;
use std::time::Duration;

const IN_A_ROW: u32 = 3;

crate::inputs! {
    /// What the sensors hear.
    pub(super) struct SensorInputs {
        /// The wrist sensor.
        state: FtState = device("ft/state"),
    }
}
crate::outputs! {
    /// What [`ForceTorque`] says.
    pub(super) struct Outputs {
        /// The wrench on the hand.
        wrench: Wrench = wire("Out"),
        /// To the wrist sensor.
        command: FtCommand = device("ft/cmd"),
    }
}

/// Tells the wrench on the hand; with `"zero"` it sets the sensor to zero first, which is for a free hand.
#[derive(Debug)]
pub(super) struct ForceTorque {
    zero: bool,
    /// How often the sensor had been zeroed when this began.
    zeroed_before: Option<u32>,
    watch: Watch,
}

impl Controller for ForceTorque {
    type Inputs = SensorInputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "ForceTorque";

    fn about() -> About {
        const ZERO: &[Parameter] = &[Parameter::new("zero", Kind::Text(&["keep", "zero"])).or("keep")];
        About::service("Tells the wrench on the hand; with \"zero\" it first sets the sensor, on a free hand, to zero.")
            .every(Duration::from_millis(50))
            .triggered_by("ft/state")
            .with(ZERO)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { zero: arguments.text("zero") == "zero", zeroed_before: None, watch: Watch::default() })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.zeroed_before, self.watch) = (None, Watch::default());
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &SensorInputs, outputs: &mut Outputs) -> Progress {
        let fresh = inputs.state.fresh();
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no word from the force sensor for 1 s".to_owned());
        }
        let Some(state) = fresh else { return Progress::Continue };
        let before = *self.zeroed_before.get_or_insert(state.zeroed);
        if self.zero && state.zeroed == before {
            outputs.command.send(FtCommand { after: before });
        } else {
            outputs.wrench.send(Wrench { force: state.force, torque: state.torque });
        }
        Progress::Continue
    }
}

crate::outputs! {
    /// What [`ForceSensor`] says.
    pub(super) struct SensorOutputs {
        /// The wrench on the hand.
        wrench: Wrench = wire("Out1"),
        /// To the wrist sensor.
        command: FtCommand = device("ft/cmd"),
    }
}

/// Sets the sensor to zero, then tells the wrench on the hand.
#[derive(Debug, Default)]
pub(super) struct ForceSensor {
    zeroed_before: Option<u32>,
    watch: Watch,
}

impl Controller for ForceSensor {
    type Inputs = SensorInputs;
    type Outputs = SensorOutputs;
    const TYPE: &'static str = "ForceSensor";

    fn about() -> About {
        About::service("Sets the force sensor to zero, then tells the wrench on the hand.")
            .every(Duration::from_millis(50))
            .triggered_by("ft/state")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::default();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &SensorInputs, outputs: &mut SensorOutputs) -> Progress {
        let fresh = inputs.state.fresh();
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no word from the force sensor for 1 s".to_owned());
        }
        let Some(state) = fresh else { return Progress::Continue };
        let before = *self.zeroed_before.get_or_insert(state.zeroed);
        if state.zeroed == before {
            outputs.command.send(FtCommand { after: before });
        } else {
            outputs.wrench.send(Wrench { force: state.force, torque: state.torque });
        }
        Progress::Continue
    }
}

/// Waits for a force.
#[derive(Debug)]
struct Threshold {
    threshold: f64,
    debounce: Debounce,
    watch: Watch,
}

impl Threshold {
    fn new(arguments: &Arguments) -> Self {
        let threshold = arguments.number("threshold");
        Self { threshold, debounce: Debounce::new(IN_A_ROW), watch: Watch::default() }
    }

    fn reset(&mut self) {
        (self.debounce, self.watch) = (Debounce::new(IN_A_ROW), Watch::default());
    }

    fn update(&mut self, tick: Tick, wrench: &In<Wrench>) -> Progress {
        let fresh = wrench.fresh();
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no forces for 1 s".to_owned());
        }
        let Some(wrench) = fresh else { return Progress::Continue };
        let force = Vector3::from(wrench.force).norm();
        if self.debounce.update(force > self.threshold) {
            return Progress::Done(super::value(&force));
        }
        Progress::Continue
    }
}

crate::inputs! {
    /// What [`ForceThreshold`] hears.
    pub(super) struct ThresholdInputs {
        /// The wrench on the hand.
        wrench: Wrench = wire("In"),
    }
}

/// Ends when three forces in a row exceed a threshold.
#[derive(Debug)]
pub(super) struct ForceThreshold(Threshold);

impl Controller for ForceThreshold {
    type Inputs = ThresholdInputs;
    type Outputs = ();
    const TYPE: &'static str = "ForceThreshold";

    fn about() -> About {
        const THRESHOLD: &[Parameter] = &[Parameter::new("threshold", Kind::Number(1.0, 200.0)).or("8")];
        About::task("Ends when three forces in a row exceed a threshold [N], leaving the last of them.")
            .every(Duration::from_millis(50))
            .triggered_by("In")
            .with(THRESHOLD)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self(Threshold::new(arguments)))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.0.reset();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &ThresholdInputs, (): &mut ()) -> Progress {
        self.0.update(tick, &inputs.wrench)
    }
}

crate::inputs! {
    /// What [`HitDetector`] hears.
    pub(super) struct HitInputs {
        /// The wrench on the hand.
        wrench: Wrench = wire("In1"),
    }
}

/// Ends when the hand is hit: the one-process detector of the paper's CompliantMotion.
#[derive(Debug)]
pub(super) struct HitDetector(Threshold);

impl Controller for HitDetector {
    type Inputs = HitInputs;
    type Outputs = ();
    const TYPE: &'static str = "HitDetector";

    fn about() -> About {
        const THRESHOLD: &[Parameter] = &[Parameter::new("threshold", Kind::Number(1.0, 200.0)).or("40")];
        About::task("Ends when the hand is hit: three forces in a row above a threshold [N].")
            .every(Duration::from_millis(50))
            .triggered_by("In1")
            .with(THRESHOLD)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self(Threshold::new(arguments)))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.0.reset();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &HitInputs, (): &mut ()) -> Progress {
        self.0.update(tick, &inputs.wrench)
    }
}
