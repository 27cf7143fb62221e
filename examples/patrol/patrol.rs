//! A mobile base with a battery (simulated), a task that drives to a place, and the battery's monitor.

use crate::headline;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Configured, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Quantity,
    Registry, Signal, Stopping, Tick,
};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(20);
/// How old a command or a pose may be.
const FRESH: Duration = Duration::from_millis(200);

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct PatrolPose {
    /// (m)
    x: f64,
    /// (m)
    y: f64,
}

impl Message for PatrolPose {
    const TYPE: &'static str = "PatrolPose";
    const FIELDS: &'static str = "x: Length, y: Length";
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct PatrolVelocity {
    /// (m/s)
    x: f64,
    /// (m/s)
    y: f64,
}

impl Message for PatrolVelocity {
    const TYPE: &'static str = "PatrolVelocity";
    const FIELDS: &'static str = "x: Speed, y: Speed";
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct PatrolBattery {
    /// How full it is (%).
    charge: f64,
}

impl Message for PatrolBattery {
    const TYPE: &'static str = "PatrolBattery";
    const FIELDS: &'static str = "charge: Number";
}

#[derive(Inputs)]
struct BaseInputs {
    /// How to move.
    #[port("In")]
    velocity: In<PatrolVelocity>,
}

#[derive(Outputs)]
struct BaseOutputs {
    /// Where it is.
    #[port("Pose")]
    pose: Out<PatrolPose>,
    /// Its battery.
    #[port("Battery")]
    battery: Out<PatrolBattery>,
}

/// A base that goes anywhere on the floor, at the dock at first. Its battery is drained by time.
struct PatrolBase {
    drain: f64,
    pose: PatrolPose,
    charge: f64,
}

impl Controller for PatrolBase {
    type Inputs = BaseInputs;
    type Outputs = BaseOutputs;
    const TYPE: &'static str = "PatrolBase";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("drain", Kind::Number(0.0, 100.0)).or("1")];
        About::service("Simulates a mobile base; the drain of its battery [%/s].")
            .remembers()
            .every(PERIOD)
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { drain: arguments.number("drain"), pose: PatrolPose { x: 0.0, y: 0.0 }, charge: 100.0 })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &BaseInputs, outputs: &mut BaseOutputs) -> Progress {
        let dt = tick.dt().min(0.1);
        self.charge = (self.charge - self.drain * dt).max(0.0);
        if self.charge <= 0.0 {
            return Progress::Aborted("the battery is empty".to_owned());
        }
        // An old command counts as none: the base stops.
        if let Some(velocity) = inputs.velocity.fresh_within(tick.now, FRESH) {
            self.pose.x += velocity.x * dt;
            self.pose.y += velocity.y * dt;
        }
        outputs.pose.send(self.pose.clone());
        outputs.battery.send(PatrolBattery { charge: self.charge });
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("charge", "%", self.charge), headline("from dock", "m", self.pose.x.hypot(self.pose.y))]
    }
}

#[derive(Inputs)]
struct DriveInputs {
    /// Where the base is.
    #[port("In")]
    pose: In<PatrolPose>,
}

#[derive(Outputs)]
struct DriveOutputs {
    /// How it shall move.
    #[port("Out")]
    velocity: Out<PatrolVelocity>,
}

/// Drives straight to a place, and ends there.
struct DriveTo {
    goal: PatrolPose,
    speed: f64,
}

/// The distance at which a place counts as reached (m).
const NEAR: f64 = 0.02;

/// Returns how to move from a place to another place at a speed, and more slowly near the goal. None at the goal.
fn velocity(from: &PatrolPose, to: &PatrolPose, speed: f64) -> Option<PatrolVelocity> {
    let (x, y) = (to.x - from.x, to.y - from.y);
    let distance = x.hypot(y);
    let speed = speed.min(2.0 * distance);
    (distance > NEAR).then(|| PatrolVelocity { x: speed * x / distance, y: speed * y / distance })
}

impl Controller for DriveTo {
    type Inputs = DriveInputs;
    type Outputs = DriveOutputs;
    const TYPE: &'static str = "DriveTo";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("x", Kind::Quantity(Quantity::Length, -100.0, 100.0)),
            Parameter::new("y", Kind::Quantity(Quantity::Length, -100.0, 100.0)),
            Parameter::new("speed", Kind::Quantity(Quantity::Speed, 0.01, 2.0)).or("0.5"),
        ];
        About::task("Drives straight to a place [m], and ends there; speed [m/s].").every(PERIOD).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let [x, y, speed] = ["x", "y", "speed"].map(|name| arguments.number(name));
        Ok(Self { goal: PatrolPose { x, y }, speed })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &DriveInputs, outputs: &mut DriveOutputs) -> Progress {
        let Some(pose) = inputs.pose.fresh_within(tick.now, FRESH) else { return Progress::Continue };
        match velocity(pose, &self.goal, self.speed) {
            Some(velocity) => {
                outputs.velocity.send(velocity);
                Progress::Continue
            }
            None => Progress::Done(Vec::new()),
        }
    }

    fn stop(&mut self, _: Tick, _: &DriveInputs, outputs: &mut DriveOutputs) -> Stopping {
        outputs.velocity.send(PatrolVelocity { x: 0.0, y: 0.0 });
        Stopping::Finished
    }
}

#[derive(Inputs)]
struct LowInputs {
    /// The battery.
    #[port("In")]
    battery: In<PatrolBattery>,
}

/// Ends when a battery is low.
struct BatteryLow {
    threshold: f64,
}

impl Controller for BatteryLow {
    type Inputs = LowInputs;
    type Outputs = ();
    const TYPE: &'static str = "BatteryLow";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("threshold", Kind::Number(1.0, 99.0)).or("20")];
        About::task("Ends when a battery is below a threshold [%].").every(PERIOD).triggered_by("In").with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { threshold: arguments.number("threshold") })
    }

    /// The level that counts as low may be changed while the base is on its way.
    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        self.threshold = arguments.number("threshold");
        Ok(Configured::Now)
    }

    fn main_calc(&mut self, _: Tick, inputs: &LowInputs, (): &mut ()) -> Progress {
        match inputs.battery.fresh() {
            Some(battery) if battery.charge < self.threshold => Progress::Done(Vec::new()),
            Some(_) | None => Progress::Continue,
        }
    }
}

pub(crate) fn add(registry: &mut Registry) {
    registry.add::<PatrolBase>().add::<DriveTo>().add::<BatteryLow>();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_is_straight_and_ends() {
        let goal = PatrolPose { x: 3.0, y: 4.0 };
        let far = velocity(&PatrolPose { x: 0.0, y: 0.0 }, &goal, 0.5).unwrap();
        assert!((far.x - 0.3).abs() < 1e-9 && (far.y - 0.4).abs() < 1e-9);
        assert!(velocity(&PatrolPose { x: 3.01, y: 4.0 }, &goal, 0.5).is_none());
    }
}
