//! A speed controller for a motor: the motor (simulated), a PID law, and a task that gives it a goal and waits.

use crate::headline;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Configured, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Quantity,
    Registry, Signal, Stopping, Tick,
};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(5);

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct MotorSpeed {
    /// (rad/s)
    speed: f64,
}

impl Message for MotorSpeed {
    const TYPE: &'static str = "MotorSpeed";
    const FIELDS: &'static str = "speed: AngularSpeed";
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct MotorVoltage {
    /// (V)
    voltage: f64,
}

impl Message for MotorVoltage {
    const TYPE: &'static str = "MotorVoltage";
    const FIELDS: &'static str = "voltage: Voltage";
}

#[derive(Inputs)]
struct MotorInputs {
    /// The voltage of the amplifier.
    #[port("In")]
    voltage: In<MotorVoltage>,
}

#[derive(Outputs)]
struct MotorOutputs {
    /// The speed that the encoder measures.
    #[port("Out")]
    speed: Out<MotorSpeed>,
}

/// A direct-current motor with a flywheel: `J w' = k (u - k w) / R - b w`. A command older than 100 ms counts as 0 V.
struct Motor {
    inertia: f64,
    speed: f64,
}

impl Motor {
    /// Torque constant (Nm/A, V s).
    const K: f64 = 0.05;
    /// Resistance (ohm).
    const R: f64 = 1.0;
    /// Viscous friction (Nm s).
    const B: f64 = 1e-4;

    /// Lets time pass (s) in steps that are short against every time constant.
    fn advance(&mut self, voltage: f64, mut time: f64) {
        while time > 0.0 {
            let step = time.min(1e-3);
            let torque = Self::K * (voltage - Self::K * self.speed) / Self::R - Self::B * self.speed;
            self.speed += torque / self.inertia * step;
            time -= step;
        }
    }
}

impl Controller for Motor {
    type Inputs = MotorInputs;
    type Outputs = MotorOutputs;
    const TYPE: &'static str = "Motor";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("inertia", Kind::Number(1e-5, 1e-2)).or("0.0005")];
        About::service("Simulates a motor with a flywheel; inertia [kg m2].").remembers().every(PERIOD).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { inertia: arguments.number("inertia"), speed: 0.0 })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &MotorInputs, outputs: &mut MotorOutputs) -> Progress {
        let voltage = inputs.voltage.fresh_within(tick.now, Duration::from_millis(100)).map_or(0.0, |v| v.voltage);
        // A calculation that was held up does not make the simulation run away.
        self.advance(voltage, tick.dt().min(0.1));
        outputs.speed.send(MotorSpeed { speed: self.speed });
        Progress::Continue
    }
}

#[derive(Inputs)]
struct PidInputs {
    /// The wanted speed.
    #[port("Goal")]
    goal: In<MotorSpeed>,
    /// The measured speed.
    #[port("In")]
    speed: In<MotorSpeed>,
}

#[derive(Outputs)]
struct PidOutputs {
    /// To the amplifier.
    #[port("Out")]
    voltage: Out<MotorVoltage>,
}

/// The law itself, without ports: it can be tested with numbers alone.
#[derive(Debug, Default)]
struct Pid {
    kp: f64,
    ki: f64,
    kd: f64,
    /// The most that may come out (V).
    limit: f64,
    integral: f64,
    measured: Option<f64>,
}

impl Pid {
    /// Returns what to do about an error after `dt` seconds. The derivative is the derivative of
    /// the measurement, so a new goal causes no jump. The integral does not change while the output
    /// is at its limit.
    fn update(&mut self, goal: f64, measured: f64, dt: f64) -> f64 {
        let error = goal - measured;
        let rate = self.measured.replace(measured).map_or(0.0, |before| (measured - before) / dt);
        let free = self.kp * error + self.ki * (self.integral + error * dt) - self.kd * rate;
        let output = free.clamp(-self.limit, self.limit);
        if (free - output).abs() <= 0.0 || error.signum() != free.signum() {
            self.integral += error * dt;
        }
        output
    }
}

/// Brings a motor to a speed.
struct PidCtrl {
    pid: Pid,
    error: f64,
}

impl PidCtrl {
    fn take(&mut self, arguments: &Arguments) {
        let [kp, ki, kd, limit] = ["kp", "ki", "kd", "limit"].map(|name| arguments.number(name));
        self.pid = Pid { kp, ki, kd, limit, ..std::mem::take(&mut self.pid) };
    }
}

impl Controller for PidCtrl {
    type Inputs = PidInputs;
    type Outputs = PidOutputs;
    const TYPE: &'static str = "Pid";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("kp", Kind::Number(0.0, 100.0)).or("0.05"),
            Parameter::new("ki", Kind::Number(0.0, 100.0)).or("0.5"),
            Parameter::new("kd", Kind::Number(0.0, 10.0)).or("0.0005"),
            Parameter::new("limit", Kind::Quantity(Quantity::Voltage, 0.0, 48.0)).or("24"),
        ];
        About::service("Brings a motor to a speed: a PID law; limit [V].")
            .remembers()
            .every(PERIOD)
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(50))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let mut controller = Self { pid: Pid::default(), error: 0.0 };
        controller.take(arguments);
        Ok(controller)
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.pid.integral, self.pid.measured) = (0.0, None);
        Ok(())
    }

    /// Gains may be changed while the motor turns.
    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        self.take(arguments);
        Ok(Configured::Now)
    }

    fn main_calc(&mut self, tick: Tick, inputs: &PidInputs, outputs: &mut PidOutputs) -> Progress {
        // Without a measurement there is nothing to send, and the motor then stops by itself.
        let Some(measured) = inputs.speed.fresh_within(tick.now, Duration::from_millis(100)) else {
            return Progress::Continue;
        };
        let goal = inputs.goal.latest().map_or(0.0, |goal| goal.speed);
        self.error = goal - measured.speed;
        let voltage = self.pid.update(goal, measured.speed, tick.dt());
        outputs.voltage.send(MotorVoltage { voltage });
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, _: &PidInputs, outputs: &mut PidOutputs) -> Stopping {
        outputs.voltage.send(MotorVoltage { voltage: 0.0 });
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("speed error", "rad/s", self.error)]
    }
}

#[derive(Inputs)]
struct ReachInputs {
    /// The speed that the encoder measures.
    #[port("In")]
    speed: In<MotorSpeed>,
}

#[derive(Outputs)]
struct ReachOutputs {
    /// The goal.
    #[port("Out")]
    goal: Out<MotorSpeed>,
}

/// Asks for a speed, and ends when it was kept for a while.
struct ReachSpeed {
    speed: f64,
    tolerance: f64,
    kept: Duration,
}

impl ReachSpeed {
    /// How long the speed has to be kept.
    const KEPT: Duration = Duration::from_millis(300);
}

impl Controller for ReachSpeed {
    type Inputs = ReachInputs;
    type Outputs = ReachOutputs;
    const TYPE: &'static str = "ReachSpeed";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("speed", Kind::Quantity(Quantity::AngularSpeed, -500.0, 500.0)),
            Parameter::new("tolerance", Kind::Quantity(Quantity::AngularSpeed, 0.01, 50.0)).or("2"),
        ];
        About::task("Asks for a speed [rad/s], and ends when it was kept for 0.3 s.").every(PERIOD).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let [speed, tolerance] = ["speed", "tolerance"].map(|name| arguments.number(name));
        Ok(Self { speed, tolerance, kept: Duration::ZERO })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.kept = Duration::ZERO;
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &ReachInputs, outputs: &mut ReachOutputs) -> Progress {
        outputs.goal.send(MotorSpeed { speed: self.speed });
        let is_near = inputs.speed.fresh().map(|now| (now.speed - self.speed).abs() < self.tolerance);
        self.kept = match is_near {
            Some(true) => self.kept + tick.elapsed,
            Some(false) => Duration::ZERO,
            None => self.kept,
        };
        if self.kept >= Self::KEPT { Progress::Done(Vec::new()) } else { Progress::Continue }
    }
}

pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Motor>().add::<PidCtrl>().add::<ReachSpeed>();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed loop with numbers alone: it reaches the goal, within the limit, and hardly overshoots.
    #[test]
    fn the_motor_reaches_its_speed() {
        let mut pid = Pid { kp: 0.05, ki: 0.5, kd: 0.0005, limit: 24.0, ..Pid::default() };
        let mut motor = Motor { inertia: 5e-4, speed: 0.0 };
        let mut highest = 0.0_f64;
        for _ in 0..600 {
            let voltage = pid.update(200.0, motor.speed, 0.005);
            assert!(voltage.abs() <= 24.0);
            motor.advance(voltage, 0.005);
            highest = highest.max(motor.speed);
        }
        assert!((motor.speed - 200.0).abs() < 1.0 && highest < 230.0, "{} {highest}", motor.speed);
    }
}
