//! The battery: a monitor that ends when it is low, and a task that waits until it is full.

use super::PERIOD;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{About, Arguments, Controller, In, Inputs, Kind, Message, Parameter, Progress, Tick};

/// The state of the battery.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Battery {
    /// (%)
    pub(super) charge: f64,
}

impl Message for Battery {
    const TYPE: &'static str = "Battery";
    const FIELDS: &'static str = "charge: Number";
}

#[derive(Inputs)]
pub(super) struct BatteryInputs {
    /// The battery.
    #[port("Battery")]
    battery: In<Battery>,
}

/// Ends when the battery is low.
pub(super) struct LowBattery {
    below: f64,
}

impl Controller for LowBattery {
    type Inputs = BatteryInputs;
    type Outputs = ();
    const TYPE: &'static str = "LowBattery";

    fn about() -> About {
        const BELOW: &[Parameter] = &[Parameter::new("below", Kind::Number(0.0, 100.0)).or("30")];
        About::task("Ends when the battery is below a charge [%].").every(PERIOD).triggered_by("Battery").with(BELOW)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { below: arguments.number("below") })
    }

    fn main_calc(&mut self, _: Tick, inputs: &BatteryInputs, (): &mut ()) -> Progress {
        match inputs.battery.fresh() {
            Some(battery) if battery.charge < self.below => Progress::Done(Vec::new()),
            Some(_) | None => Progress::Continue,
        }
    }
}

/// Waits at the dock until the battery is full.
pub(super) struct Charge;

/// The charge at which the battery counts as full (%).
const FULL: f64 = 95.0;

impl Controller for Charge {
    type Inputs = BatteryInputs;
    type Outputs = ();
    const TYPE: &'static str = "Charge";

    fn about() -> About {
        About::task("Waits at the dock until the battery is full.").every(PERIOD).triggered_by("Battery")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self)
    }

    fn main_calc(&mut self, _: Tick, inputs: &BatteryInputs, (): &mut ()) -> Progress {
        match inputs.battery.fresh() {
            Some(battery) if battery.charge >= FULL => Progress::Done(Vec::new()),
            Some(_) | None => Progress::Continue,
        }
    }
}
