//! Two controllers: `Ramp` counts up and ends, `Smooth` follows its input. The spec beside this file wires one to the
//! other.

use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Configured, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Registry,
    Signal, Tick, process,
};
use std::time::Duration;

/// The message from the one controller to the other.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Level {
    value: f64,
}

impl Message for Level {
    const TYPE: &'static str = "Level";
    const FIELDS: &'static str = "value: Number";
}

#[derive(Outputs)]
struct RampOutputs {
    /// One more at each beat.
    #[port("Out")]
    level: Out<Level>,
}

/// Counts up to a number, one each 50 ms, and ends.
struct Ramp {
    until: f64,
    value: f64,
}

impl Controller for Ramp {
    type Inputs = ();
    type Outputs = RampOutputs;
    const TYPE: &'static str = "Ramp";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("until", Kind::Number(1.0, 1e6))];
        About::task("Counts up to a number, and ends.").remembers().every(Duration::from_millis(50)).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { until: arguments.number("until"), value: 0.0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.value = 0.0;
        Ok(())
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut RampOutputs) -> Progress {
        self.value += 1.0;
        outputs.level.send(Level { value: self.value });
        if self.value < self.until { Progress::Continue } else { Progress::Done(Vec::new()) }
    }
}

#[derive(Inputs)]
struct SmoothInputs {
    /// The level to follow.
    #[port("In")]
    level: In<Level>,
}

/// Moves a part of the way to each value of its input.
struct Smooth {
    gain: f64,
    value: f64,
}

impl Controller for Smooth {
    type Inputs = SmoothInputs;
    type Outputs = ();
    const TYPE: &'static str = "Smooth";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("gain", Kind::Number(0.0, 1.0)).or("0.5")];
        About::service("Follows what it hears, a part of the way at a time.")
            .every(Duration::from_millis(100))
            .triggered_by("In")
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(50))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { gain: arguments.number("gain"), value: 0.0 })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.value = 0.0;
        Ok(())
    }

    /// `dca param set` changes the gain while this runs.
    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        self.gain = arguments.number("gain");
        Ok(Configured::Now)
    }

    fn main_calc(&mut self, _: Tick, inputs: &SmoothInputs, (): &mut ()) -> Progress {
        if let Some(level) = inputs.level.fresh() {
            self.value += self.gain * (level.value - self.value);
        }
        Progress::Continue
    }

    /// Returns the numbers that the summary, the report and the record of a run show.
    fn signals(&self) -> Vec<Signal> {
        vec![Signal { name: "smoothed".into(), unit: String::new(), value: self.value, headline: true }]
    }
}

fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.add::<Ramp>().add::<Smooth>();
    registry
}

fn main() -> std::process::ExitCode {
    process::run(&registry())
}

#[cfg(test)]
mod tests {
    use super::*;
    use controllers::sdk::Time;
    use controllers::sdk::harness::{Disturbance, Ending, Harness};

    /// Both with the arguments and wires of the spec, in one thread on virtual time.
    #[test]
    fn the_ramp_ends_and_the_other_follows() {
        let (registry, mut harness) = (registry(), Harness::new(Disturbance::NONE));
        let ramp = harness.add(registry.create("Ramp", &["until=20"]).unwrap());
        let smooth = harness.add(registry.create("Smooth", &["gain=0.5"]).unwrap());
        let wire = harness.connect((ramp, "Out"), (smooth, "In")).unwrap();
        harness.open(wire);
        harness.activate(smooth, b"");
        harness.activate(ramp, b"");
        let report = harness.run(Time::ZERO + Duration::from_secs(2)).unwrap();
        assert_eq!((report.module, report.ending), (ramp, Ending::Done(Vec::new())));
        // Half of the way each time: one step behind, and a little more.
        let value = harness.signals(smooth)[0].value;
        assert!((17.0..20.0).contains(&value), "{value}");
    }
}
