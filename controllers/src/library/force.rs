//! The wrist sensor, and the controllers that watch it.

use super::{StuckForce, Watch, seconds};
use crate::control::filter::Despike;
use crate::control::touch::{Touch, median};
use crate::message::{FtCommand, FtState, Wrench};
use crate::sdk::{
    About, Arguments, Configured, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Tick,
};
use nalgebra::{Vector3, Vector6};
use std::time::Duration;

/// The inputs of the sensors.
#[derive(Debug, Inputs)]
pub(super) struct SensorInputs {
    /// The wrist sensor.
    #[device("ft/state")]
    state: In<FtState>,
}

/// The outputs of [`ForceTorque`].
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The wrench on the hand.
    #[port("Out")]
    wrench: Out<Wrench>,
    /// To the wrist sensor.
    #[device("ft/cmd")]
    command: Out<FtCommand>,
}

/// The largest median of the force on a free hand after the sensor was set to zero (N), over `DRIFT_SAMPLES` samples.
/// Nominal drifts are 6 N. With a sensor that was off by 23 N the laws pulled with 105 N.
const DRIFT_MAX: f64 = 12.0;
const DRIFT_SAMPLES: usize = 25;

/// Publishes the wrench on the hand. With `"zero"` it first sets the sensor to zero, which needs a free hand. Then it
/// refuses a sensor that does not report zero.
#[derive(Debug)]
pub(super) struct ForceTorque {
    zero: bool,
    /// The first forces since the sensor was set to zero (N).
    first: Vec<Vector3<f64>>,
    /// Smaller forces are published as zero (N).
    threshold: f64,
    /// The sensor's count of zeroings when this activation began.
    zeroed_before: Option<u32>,
    stuck: StuckForce,
    despike: Despike,
    watch: Watch,
}

impl Controller for ForceTorque {
    type Inputs = SensorInputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "ForceTorque";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("zero", Kind::Text(&["keep", "zero"])).or("keep"),
            Parameter::new("threshold", Kind::Quantity(Quantity::Force, 0.0, 200.0)).or("0"),
        ];
        About::service(
            "Sends the wrench on the hand, and zero for forces below a threshold [N]; \"zero\" first zeroes the sensor.",
        )
        // The process remembers that the sensor is zeroed: a hand that holds an object is not free.
        .remembers()
        .every(Duration::from_millis(50))
        .triggered_by("ft/state")
        .with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (zero, threshold) = (arguments.text("zero") == "zero", arguments.number("threshold"));
        let (first, stuck, watch) = (Vec::new(), StuckForce::default(), Watch::default());
        Ok(Self { zero, threshold, first, zeroed_before: None, stuck, despike: Despike::default(), watch })
    }

    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        self.threshold = arguments.number("threshold");
        Ok(Configured::Now)
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.zeroed_before, self.watch) = (None, Watch::default());
        (self.first, self.stuck, self.despike) = (Vec::new(), StuckForce::default(), Despike::default());
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &SensorInputs, outputs: &mut Outputs) -> Progress {
        let fresh = inputs.state.fresh();
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no word from the force sensor for 1 s".to_owned());
        }
        let Some(state) = fresh else { return Progress::Continue };
        if let Some(why) = self.stuck.problem(state) {
            return Progress::Aborted(why);
        }
        let before = *self.zeroed_before.get_or_insert(state.zeroed);
        if self.zero && state.zeroed == before {
            outputs.command.send(FtCommand { after: before });
        } else {
            if let Some(drift) = self.drifted(&state.force.into()) {
                let why = "the force sensor is not at zero after it was set to zero, or something pushes the hand";
                return Progress::Aborted(format!("{why}: {drift:.0} N"));
            }
            let ([x, y, z], [a, b, c]) = (state.force, state.torque);
            let [x, y, z, a, b, c] = self.despike.update(&Vector6::new(x, y, z, a, b, c)).into();
            let is_felt = Vector3::new(x, y, z).norm() >= self.threshold;
            let force = if is_felt { [x, y, z] } else { [0.0; 3] };
            outputs.wrench.send(Wrench { measured: seconds(state.stamp), force, torque: [a, b, c] });
        }
        Progress::Continue
    }
}

impl ForceTorque {
    /// Takes a force on a free hand (N). Returns the median of the first forces (N) if a sensor at zero does not report
    /// zero.
    fn drifted(&mut self, force: &Vector3<f64>) -> Option<f64> {
        if !self.zero || self.first.len() >= DRIFT_SAMPLES {
            return None;
        }
        self.first.push(*force);
        // Spikes of the sensor do not move a median.
        let size = median(&self.first).norm();
        (self.first.len() == DRIFT_SAMPLES && !(0.0..=DRIFT_MAX).contains(&size)).then_some(size)
    }
}

/// The outputs of [`ForceSensor`].
#[derive(Debug, Outputs)]
pub(super) struct SensorOutputs {
    /// The wrench on the hand.
    #[port("Out1")]
    wrench: Out<Wrench>,
    /// To the wrist sensor.
    #[device("ft/cmd")]
    command: Out<FtCommand>,
}

/// Sets the sensor to zero, then publishes the wrench on the hand.
#[derive(Debug, Default)]
pub(super) struct ForceSensor {
    zeroed_before: Option<u32>,
    stuck: StuckForce,
    watch: Watch,
}

impl Controller for ForceSensor {
    type Inputs = SensorInputs;
    type Outputs = SensorOutputs;
    const TYPE: &'static str = "ForceSensor";

    fn about() -> About {
        About::service("Sets the force sensor to zero, and then sends the wrench on the hand.")
            .remembers()
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
        if let Some(why) = self.stuck.problem(state) {
            return Progress::Aborted(why);
        }
        let before = *self.zeroed_before.get_or_insert(state.zeroed);
        if state.zeroed == before {
            outputs.command.send(FtCommand { after: before });
        } else {
            outputs.wrench.send(Wrench { measured: seconds(state.stamp), force: state.force, torque: state.torque });
        }
        Progress::Continue
    }
}

/// Waits for a force above the threshold.
#[derive(Debug)]
struct Threshold {
    threshold: f64,
    /// The time after which a force is treated as part of the background (s). None if this never happens.
    forgets: Option<f64>,
    touch: Touch,
    watch: Watch,
}

impl Threshold {
    fn new(arguments: &Arguments, forgets: Option<f64>) -> Self {
        let threshold = arguments.number("threshold");
        Self { threshold, forgets, touch: Touch::new(forgets), watch: Watch::default() }
    }

    fn configure(&mut self, arguments: &Arguments) -> Configured {
        self.threshold = arguments.number("threshold");
        Configured::Now
    }

    fn reset(&mut self) {
        (self.touch, self.watch) = (Touch::new(self.forgets), Watch::default());
    }

    fn update(&mut self, tick: Tick, wrench: &In<Wrench>) -> Progress {
        let fresh = wrench.fresh();
        if self.watch.is_silent(tick.now, fresh.is_some()) {
            return Progress::Aborted("no forces for 1 s".to_owned());
        }
        let Some(wrench) = fresh else { return Progress::Continue };
        match self.touch.update(&Vector3::from(wrench.force), self.threshold, tick.dt()) {
            Some(force) => Progress::done(&force.norm()),
            None => Progress::Continue,
        }
    }
}

/// The inputs of [`ForceThreshold`].
#[derive(Debug, Inputs)]
pub(super) struct ThresholdInputs {
    /// The wrench on the hand.
    #[port("In")]
    wrench: In<Wrench>,
}

/// Ends when a force exceeds a threshold and its own noise. If `forgets` is set, constant forces
/// are ignored, for example the drift of a sensor or an unknown payload.
#[derive(Debug)]
pub(super) struct ForceThreshold(Threshold);

impl Controller for ForceThreshold {
    type Inputs = ThresholdInputs;
    type Outputs = ();
    const TYPE: &'static str = "ForceThreshold";

    fn about() -> About {
        const THRESHOLD: &[Parameter] = &[
            Parameter::new("threshold", Kind::Quantity(Quantity::Force, 1.0, 200.0)).or("8"),
            Parameter::new("forget", Kind::Quantity(Quantity::Time, 0.0, 60.0)).or("0"),
        ];
        About::task(
            "Ends when a force exceeds a threshold [N] and its own noise, and leaves the force. A force that stays is ignored after some \
             time [s], unless this time is 0.",
        )
        // The process remembers the force and the noise of the free hand.
        .remembers()
        .every(Duration::from_millis(50))
        .triggered_by("In")
        .with(THRESHOLD)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self(Threshold::new(arguments, Some(arguments.number("forget")).filter(|forget| *forget > 0.0))))
    }

    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        Ok(self.0.configure(arguments))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.0.reset();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &ThresholdInputs, (): &mut ()) -> Progress {
        self.0.update(tick, &inputs.wrench)
    }
}

/// The inputs of [`HitDetector`].
#[derive(Debug, Inputs)]
pub(super) struct HitInputs {
    /// The wrench on the hand.
    #[port("In1")]
    wrench: In<Wrench>,
}

/// Ends when the hand is hit: the one-process detector of the paper's CompliantMotion.
#[derive(Debug)]
pub(super) struct HitDetector(Threshold);

impl Controller for HitDetector {
    type Inputs = HitInputs;
    type Outputs = ();
    const TYPE: &'static str = "HitDetector";

    fn about() -> About {
        const THRESHOLD: &[Parameter] =
            &[Parameter::new("threshold", Kind::Quantity(Quantity::Force, 1.0, 200.0)).or("40")];
        About::task("Ends when the hand is hit: a force above a threshold [N] and above its own noise.")
            .remembers()
            .every(Duration::from_millis(50))
            .triggered_by("In1")
            .with(THRESHOLD)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self(Threshold::new(arguments, None)))
    }

    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        Ok(self.0.configure(arguments))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.0.reset();
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &HitInputs, (): &mut ()) -> Progress {
        self.0.update(tick, &inputs.wrench)
    }
}
