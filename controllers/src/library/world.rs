//! DoorWorld: the plant as a process. It owns every device.

use crate::message::{
    ArmCommand, ArmState, BaseCommand, BaseState, CameraState, FtCommand, FtState, GripperCommand, GripperState,
    LaserState,
};
use crate::robot::door::{Description, Lock};
use crate::robot::drive::Owner;
use crate::robot::plant::{Faults, Plant, STEP};
use crate::robot::{camera, laser};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Tick};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use nalgebra::Vector3;
use std::time::Duration;

/// A plant that was held up longer than this loses the time.
const CATCH_UP_MAX: Duration = Duration::from_secs(2);
const SIGNALS_EVERY: Duration = Duration::from_millis(40);
/// A visitor's push grows for this long (s), then ends.
const PUSH_TIME: f64 = 4.0;

/// What it hears.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// To the arm.
    #[device("arm/cmd", owner)]
    arm: In<ArmCommand>,
    /// To the base.
    #[device("base/cmd", owner)]
    base: In<BaseCommand>,
    /// To the wrist sensor.
    #[device("ft/cmd", owner)]
    force: In<FtCommand>,
    /// To the gripper.
    #[device("gripper/cmd", owner)]
    gripper: In<GripperCommand>,
}

/// What it says.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The arm's encoders.
    #[device("arm/state", owner)]
    arm: Out<ArmState>,
    /// The base's encoders.
    #[device("base/state", owner)]
    base: Out<BaseState>,
    /// The wrist sensor.
    #[device("ft/state", owner)]
    force: Out<FtState>,
    /// The gripper.
    #[device("gripper/state", owner)]
    gripper: Out<GripperState>,
    /// The laser.
    #[device("laser/state", owner)]
    laser: Out<LaserState>,
    /// The camera.
    #[device("camera/state", owner)]
    camera: Out<CameraState>,
}

/// A robot before a door.
#[derive(Debug)]
pub(super) struct DoorWorld {
    description: Description,
    seed: u64,
    /// When a visitor begins to push the hand (s), never if negative, and how hard in the end (N).
    push: (f64, f64),
    faults: Faults,
    state: Option<Box<State>>,
}

/// The plant and when it has to say what.
#[derive(Debug)]
struct State {
    plant: Plant,
    began: Time,
    owners: [Owner; 3],
    due: [Due; 6],
    peak: Peak,
}

/// An absolute rhythm.
#[derive(Clone, Copy, Debug)]
struct Due {
    period: Duration,
    next: Time,
}

impl Due {
    /// Returns whether it is time; a rhythm that was missed is not made up for.
    fn is_now(&mut self, now: Time) -> bool {
        let due = now >= self.next;
        while self.next <= now {
            self.next = self.next + self.period;
        }
        due
    }
}

/// The largest force of the last one to two windows, so that no recorder misses a peak.
#[derive(Clone, Copy, Debug)]
struct Peak {
    window: Due,
    now: f64,
    before: f64,
}

impl Peak {
    fn update(&mut self, now: Time, force: f64) {
        if self.window.is_now(now) {
            (self.before, self.now) = (self.now, 0.0);
        }
        self.now = self.now.max(force);
    }
}

impl State {
    fn new(plant: Plant, now: Time) -> Self {
        // Arm, base and wrist 125 Hz, gripper 50 Hz, laser 20 Hz, camera 25 Hz.
        let due = [8, 8, 8, 20, 50, 40].map(|ms| Due { period: Duration::from_millis(ms), next: now });
        let window = Due { period: SIGNALS_EVERY, next: now };
        let peak = Peak { window, now: 0.0, before: 0.0 };
        Self { plant, began: now, owners: Default::default(), due, peak }
    }

    fn obey(&mut self, inputs: &Inputs) {
        let [arm, base, gripper] = &mut self.owners;
        if let Some((command, at)) = fresh(&inputs.arm).filter(|(command, at)| arm.admit(&command.owner, *at)) {
            self.plant.arm_drive.command(command.rates.as_ref(), at);
            if command.rates.is_none() {
                arm.release();
            }
        }
        if let Some((command, at)) = fresh(&inputs.base).filter(|(command, at)| base.admit(&command.owner, *at)) {
            self.plant.base_drive.command(command.velocity.as_ref(), at);
            if command.velocity.is_none() {
                base.release();
            }
        }
        if let Some((command, _)) = fresh(&inputs.gripper).filter(|(command, at)| gripper.admit(&command.owner, *at)) {
            match command.width {
                Some(width) => self.plant.grip_to(width),
                None => gripper.release(),
            }
        }
        if let Some((command, _)) = fresh(&inputs.force) {
            self.plant.force_torque.set_zero(command.after);
        }
    }

    fn advance(&mut self, now: Time, push: (f64, f64)) {
        if now.since(self.plant.now) > CATCH_UP_MAX {
            self.plant.now = now;
        }
        while self.plant.now + STEP <= now {
            let time = self.plant.now.since(self.began).as_secs_f64() - push.0;
            let pushes = push.0 >= 0.0 && (0.0..PUSH_TIME).contains(&time);
            let visitor = if pushes { Vector3::new(0.0, push.1 * time / PUSH_TIME, 0.0) } else { Vector3::zeros() };
            self.plant.step(&visitor);
            self.peak.update(self.plant.now, self.plant.force().norm());
        }
    }

    fn publish(&mut self, now: Time, outputs: &mut Outputs) {
        let stamp = self.plant.now;
        let due = self.due.each_mut().map(|due| due.is_now(now));
        let plant = &mut self.plant;
        if due[0] {
            let (angles, rates) = ((*plant.joints()).into(), plant.arm_drive.velocity);
            outputs.arm.send(ArmState { stamp, angles, rates });
        }
        if due[1] {
            let casters = plant.casters();
            let (steering, rolling) = (std::array::from_fn(|i| casters[i]), std::array::from_fn(|i| casters[i + 4]));
            outputs.base.send(BaseState { stamp, steering, rolling });
        }
        if due[2] {
            let [x, y, z, a, b, c] = plant.force_torque.read(&mut plant.random);
            let zeroed = plant.force_torque.zeroed();
            outputs.force.send(FtState { stamp, force: [x, y, z], torque: [a, b, c], zeroed });
        }
        if due[3] {
            let (width, force) = plant.grip();
            outputs.gripper.send(GripperState { stamp, width, force });
        }
        if due[4] {
            let base = *plant.base();
            outputs.laser.send(LaserState { stamp, ranges: laser::sweep(&base, &plant.door, &mut plant.random) });
        }
        if due[5] {
            let (hand, handle) = (plant.hand(), plant.door.handle());
            let marks = camera::look(&hand.world_from_tool, &handle, &mut plant.random);
            outputs.camera.send(CameraState { stamp, marks });
        }
    }

    fn signals(&self) -> Vec<Signal> {
        let plant = &self.plant;
        let (hand, handle) = (plant.hand(), plant.door.handle());
        let in_handle = handle.world_from_handle.inv_mul(&hand.world_from_tool);
        let aside = in_handle.translation.vector.xy().norm();
        let base = &plant.base_drive.velocity;
        let mut signals = vec![
            signal("door angle", "deg", plant.door.angle.to_degrees(), true),
            signal("contact force", "N", self.peak.now.max(self.peak.before), true),
            signal("lever angle", "deg", plant.door.lever.to_degrees(), false),
            signal("hand beside handle", "mm", 1e3 * aside, false),
            signal("hand to handle angle", "deg", in_handle.rotation.angle().to_degrees(), false),
            signal("gripper width", "mm", 1e3 * plant.grip().0, false),
            signal("base speed", "m/s", base[0].hypot(base[1]), false),
            signal("base yaw rate", "rad/s", base[2], false),
            signal("joint limits hit", "", f64::from(plant.limits_hit()), false),
        ];
        let force = plant.force();
        for (name, value) in [("force x", force.x), ("force y", force.y), ("force z", force.z)] {
            signals.push(signal(name, "N", value, false));
        }
        for (joint, rate) in plant.arm_drive.velocity.iter().enumerate() {
            signals.push(signal(&format!("joint {} speed", joint + 1), "rad/s", *rate, false));
        }
        signals
    }
}

fn signal(name: &str, unit: &str, value: f64, headline: bool) -> Signal {
    Signal { name: name.into(), unit: unit.into(), value, headline }
}

/// A command that has just come in, and when.
fn fresh<T>(input: &In<T>) -> Option<(&T, Time)> {
    input.fresh().zip(input.arrived())
}

impl Controller for DoorWorld {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "DoorWorld";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("lock", Kind::Text(&["unlocked", "locked"])).or("unlocked"),
            Parameter::new("seed", Kind::Number(0.0, 1e9)).or("1"),
            Parameter::new("radius", Kind::Number(0.5, 1.2)).or("0.82"),
            Parameter::new("closer", Kind::Number(0.0, 30.0)).or("8"),
            Parameter::new("push_at", Kind::Number(-1.0, 1e6)).or("-1"),
            Parameter::new("push", Kind::Number(0.0, 200.0)).or("60"),
            Parameter::new("lose_at", Kind::Number(-1.0, 2.5)).or("-1"),
            Parameter::new("slip_force", Kind::Number(1.0, 1000.0)).or("160"),
            Parameter::new("base_slip_at", Kind::Number(-1.0, 1e6)).or("-1"),
            Parameter::new("base_slip_for", Kind::Number(0.0, 60.0)).or("1"),
        ];
        About::service(
            "Simulates the robot before a door and owns its devices; radius [m], closer [Nm], push [N, s]; \
            faults: lose_at [rad], slip_force [N], base_slip_at and base_slip_for [s], -1 for never.",
        )
        .every(Duration::from_millis(4))
        .with(PARAMETERS)
        .signals_every(SIGNALS_EVERY)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let lock = if arguments.text("lock") == "locked" { Lock::Locked } else { Lock::Unlocked };
        let (radius, closer) = (arguments.number("radius"), arguments.number("closer"));
        let at = |name| Some(arguments.number(name)).filter(|at| *at >= 0.0).unwrap_or(f64::INFINITY);
        let faults = Faults {
            lose_at: at("lose_at"),
            slip_force: arguments.number("slip_force"),
            base_slip: (at("base_slip_at"), arguments.number("base_slip_for")),
        };
        Ok(Self {
            faults,
            description: Description { radius, closer, lock },
            seed: arguments.number("seed").to_bits(),
            push: (arguments.number("push_at"), arguments.number("push")),
            state: None,
        })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.state = None;
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        let state = self.state.get_or_insert_with(|| {
            let mut plant = Plant::new(self.description, self.seed, tick.now);
            plant.faults = self.faults;
            Box::new(State::new(plant, tick.now))
        });
        state.obey(inputs);
        state.advance(tick.now, self.push);
        state.publish(tick.now, outputs);
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        self.state.as_ref().map(|state| state.signals()).unwrap_or_default()
    }
}
