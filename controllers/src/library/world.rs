//! DoorWorld: the plant as a process. It owns every device.

mod delay;
mod failing;
mod parameters;
mod server;
mod shown;
#[cfg(test)]
mod tests;

use crate::control::caster::Odometry;
use crate::message::{
    ArmCommand, ArmState, BaseCommand, BaseState, CameraState, FtCommand, FtState, GripperCommand, GripperState,
    LaserState,
};
use crate::robot::plant::{Plant, STEP};
use crate::robot::setup::Setup;
use crate::sdk::{About, Arguments, Controller, Exports, In, Inputs, Out, Outputs, Progress, Random, Stopping, Tick};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use delay::{Delayed, Delays};
use failing::{Failing, Failure, Stamped};
use nalgebra::Vector3;
use server::Servers;
use std::time::Duration;

/// If a plant is delayed by more than this, it skips the lost time.
const CATCH_UP_MAX: Duration = Duration::from_secs(2);
const SIGNALS_EVERY: Duration = Duration::from_millis(40);
/// The longest stop of the plant: arm and base come to rest first, and the arm takes up to 3.5 s. A drive without a
/// command for `LEFT_AFTER` is no longer used by its controller.
const STOP_WITHIN: Duration = Duration::from_millis(3500);
const LEFT_AFTER: Duration = Duration::from_millis(500);
/// A visitor's push grows for this long (s), then ends.
const PUSH_TIME: f64 = 4.0;

/// The inputs of the controller.
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

/// The outputs of the controller.
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
    setup: Setup,
    delays: Delays,
    /// The time at which a visitor begins to push the hand (s), and the final force (N). With a negative time, no
    /// visitor comes.
    push: (f64, f64),
    failing: Failing,
    /// The locks and queues of the devices. They outlive a restart of the plant.
    servers: Servers,
    state: Option<Box<State>>,
}

/// The plant, and the times of its samples.
#[derive(Debug)]
struct State {
    plant: Plant,
    began: Time,
    /// The pose of the base that its odometry reports.
    odometry: Odometry,
    due: [Due; 6],
    delays: Delays,
    /// The generator of all jitter.
    random: Random,
    orders: Delayed<Order>,
    samples: Samples,
    failure: Failure,
    peak: Peak,
    /// When the plant was told to stop.
    stopping: Option<Time>,
}

/// A command on its way to its device.
#[derive(Debug)]
enum Order {
    Arm(ArmCommand),
    Base(BaseCommand),
    Gripper(GripperCommand),
    Force(FtCommand),
}

/// Samples on their way from their devices.
#[derive(Debug, Default)]
struct Samples {
    arm: Line<ArmState>,
    base: Line<BaseState>,
    force: Line<FtState>,
    gripper: Line<GripperState>,
    laser: Line<LaserState>,
    camera: Line<CameraState>,
}

/// The samples of one device.
#[derive(Debug)]
struct Line<T> {
    way: Delayed<T>,
    last: Option<T>,
}

impl<T> Default for Line<T> {
    fn default() -> Self {
        Self { way: Delayed::default(), last: None }
    }
}

impl<T: Stamped> Line<T> {
    fn put(&mut self, now: Time, device: usize, measured: T, bus: &mut Bus<'_>) {
        let Some(sample) = bus.failure.of(device, measured, &mut self.last) else { return };
        self.way.put(now, sample, bus.delays.state[device], bus.delays.jitter, bus.random);
    }
}

/// The delays and failures of samples between their devices and their readers.
struct Bus<'a> {
    delays: Delays,
    failure: &'a Failure,
    random: &'a mut Random,
}

/// A rhythm with fixed times.
#[derive(Clone, Copy, Debug)]
struct Due {
    period: Duration,
    next: Time,
}

impl Due {
    /// Returns whether the next time has come. Missed times are skipped.
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
    /// The largest force since the start.
    ever: f64,
}

impl Peak {
    fn update(&mut self, now: Time, force: f64) {
        if self.window.is_now(now) {
            (self.before, self.now) = (self.now, 0.0);
        }
        self.now = self.now.max(force);
        self.ever = self.ever.max(force);
    }
}

impl State {
    fn new(plant: Plant, delays: Delays, failing: Failing, seed: u64, now: Time) -> Self {
        // Arm, base and wrist 125 Hz, gripper 50 Hz, laser 20 Hz, camera 25 Hz.
        let due = [8, 8, 8, 20, 50, 40].map(|ms| Due { period: Duration::from_millis(ms), next: now });
        let window = Due { period: SIGNALS_EVERY, next: now };
        Self {
            plant,
            began: now,
            odometry: Odometry::default(),
            due,
            delays,
            random: Random::new(seed.rotate_left(17)),
            orders: Delayed::default(),
            samples: Samples::default(),
            failure: Failure::new(failing),
            peak: Peak { window, now: 0.0, before: 0.0, ever: 0.0 },
            stopping: None,
        }
    }

    /// Takes new commands, and obeys the commands that have reached their device.
    fn obey(&mut self, now: Time, inputs: &Inputs, servers: &mut Servers) {
        let orders = [
            inputs.arm.fresh().cloned().map(Order::Arm),
            inputs.base.fresh().cloned().map(Order::Base),
            inputs.gripper.fresh().cloned().map(Order::Gripper),
            inputs.force.fresh().cloned().map(Order::Force),
        ];
        servers.arm.note_refused(inputs.arm.refused());
        servers.base.note_refused(inputs.base.refused());
        servers.gripper.note_refused(inputs.gripper.refused());
        let (delay, jitter) = (self.delays.command, self.delays.jitter);
        for order in orders.into_iter().flatten().chain(queued(now, servers)) {
            self.orders.put(now, order, delay, jitter, &mut self.random);
        }
        while let Some(order) = self.orders.take(now) {
            self.execute(now, order, servers);
        }
    }

    fn execute(&mut self, now: Time, order: Order, servers: &mut Servers) {
        let Servers { base, arm, gripper } = servers;
        match order {
            Order::Arm(command) if arm.admit(&command.owner, command.fence, now) => {
                self.plant.arm.drive.command(command.rates.as_ref(), now);
                if command.rates.is_none() {
                    arm.release();
                }
            }
            Order::Base(command) if base.admit(&command.owner, command.fence, now) => {
                self.plant.base.drive.command(command.velocity.as_ref(), now);
                if command.velocity.is_none() {
                    base.release();
                }
            }
            Order::Gripper(command) if gripper.admit(&command.owner, command.fence, now) => match command.width {
                Some(width) => self.plant.gripper.close_to(width, command.force),
                None => gripper.release(),
            },
            Order::Force(command) => self.plant.force_torque.set_zero(command.after),
            Order::Arm(_) | Order::Base(_) | Order::Gripper(_) => {}
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
            let force = self.plant.force().norm().max(self.plant.collision());
            self.peak.update(self.plant.now, force);
        }
    }

    /// Returns whether the controllers of arm and base have let go of them, or will not do so in time.
    fn is_left(&mut self, now: Time) -> bool {
        let began = *self.stopping.get_or_insert(now);
        let Plant { arm, base, .. } = &self.plant;
        let is_left = arm.drive.is_left(now, LEFT_AFTER) && base.drive.is_left(now, LEFT_AFTER);
        is_left || now.since(began) + LEFT_AFTER > STOP_WITHIN
    }

    /// Measures the due samples, and publishes those that have arrived.
    fn publish(&mut self, now: Time, outputs: &mut Outputs) {
        self.measure(now);
        let samples = &mut self.samples;
        while let Some(state) = samples.arm.way.take(now) {
            outputs.arm.send(state);
        }
        while let Some(state) = samples.base.way.take(now) {
            outputs.base.send(state);
        }
        while let Some(state) = samples.force.way.take(now) {
            outputs.force.send(state);
        }
        while let Some(state) = samples.gripper.way.take(now) {
            outputs.gripper.send(state);
        }
        while let Some(state) = samples.laser.way.take(now) {
            outputs.laser.send(state);
        }
        while let Some(state) = samples.camera.way.take(now) {
            outputs.camera.send(state);
        }
    }

    fn measure(&mut self, now: Time) {
        let stamp = self.plant.now;
        let due = self.due.each_mut().map(|due| due.is_now(now));
        self.failure.update(stamp.since(self.began).as_secs_f64(), self.plant.door.angle);
        let (plant, samples) = (&mut self.plant, &mut self.samples);
        let mut bus = Bus { delays: self.delays, failure: &self.failure, random: &mut self.random };
        if due[0] {
            let (angles, rates) = (plant.arm.encoders().into(), plant.joint_rates());
            samples.arm.put(now, 0, ArmState { stamp, angles, rates }, &mut bus);
        }
        if due[1] {
            let (casters, bumped) = (plant.casters(), plant.bumped());
            self.odometry.update(&casters);
            let (steering, rolling) = (std::array::from_fn(|i| casters[i]), std::array::from_fn(|i| casters[i + 4]));
            samples.base.put(now, 1, BaseState { stamp, steering, rolling, bumped }, &mut bus);
        }
        if due[2] {
            let [x, y, z, a, b, c] = plant.force_torque.read(&mut plant.random);
            let zeroed = plant.force_torque.zeroed();
            let state = FtState { stamp, force: [x, y, z], torque: [a, b, c], zeroed };
            samples.force.put(now, 2, state, &mut bus);
        }
        if due[3] {
            let (width, force) = (plant.width_reported(), plant.gripper.force());
            samples.gripper.put(now, 3, GripperState { stamp, width, force }, &mut bus);
        }
        if due[4] {
            samples.laser.put(now, 4, LaserState { stamp, ranges: plant.sweep() }, &mut bus);
        }
        if due[5] {
            samples.camera.put(now, 5, CameraState { stamp, marks: plant.look() }, &mut bus);
        }
    }

    fn signals(&self) -> Vec<Signal> {
        let plant = &self.plant;
        let (hand, handle) = (plant.hand(), plant.door.handle());
        let in_handle = handle.world_from_handle.inv_mul(&hand.world_from_tool);
        let aside = in_handle.translation.vector.xy().norm();
        let base = &plant.base.drive.velocity;
        let mut signals = vec![
            signal("door angle", "deg", plant.door.angle.to_degrees(), true),
            signal("contact force", "N", self.peak.now.max(self.peak.before), true),
            signal("peak force", "N", self.peak.ever, true),
            signal("collision force", "N", plant.collision(), false),
            signal("room of base", "mm", 1e3 * plant.base_room(), false),
            signal("base beyond wall", "m", plant.base.pose().x, false),
            signal("handle held", "", f64::from(u8::from(plant.gripper.holds())), false),
            signal("lever angle", "deg", plant.door.lever.to_degrees(), false),
            signal("hand beside handle", "mm", 1e3 * aside, false),
            signal("hand to handle angle", "deg", in_handle.rotation.angle().to_degrees(), false),
            signal("gripper width", "mm", 1e3 * plant.gripper.width(), false),
            signal("base speed", "m/s", base[0].hypot(base[1]), false),
            signal("base yaw rate", "rad/s", base[2], false),
            signal("joint limits hit", "", f64::from(plant.arm.limits_hit()), false),
        ];
        let force = plant.force();
        for (name, value) in [("force x", force.x), ("force y", force.y), ("force z", force.z)] {
            signals.push(signal(name, "N", value, false));
        }
        for (joint, rate) in plant.arm.drive.velocity.iter().enumerate() {
            signals.push(signal(&format!("joint {} speed", joint + 1), "rad/s", *rate, false));
        }
        signals
    }
}

/// Returns the commands that have arrived as messages.
fn queued(now: Time, servers: &mut Servers) -> Vec<Order> {
    let Servers { base, arm, gripper } = servers;
    let mut orders = Vec::new();
    while let Some(taken) = base.take(now) {
        let (owner, velocity) = (taken.header.sender, Some(taken.data.rates));
        orders.push(Order::Base(BaseCommand { owner, velocity, fence: taken.fence }));
    }
    while let Some(taken) = arm.take(now) {
        let (owner, rates) = (taken.header.sender, Some(taken.data.rates));
        orders.push(Order::Arm(ArmCommand { owner, rates, fence: taken.fence }));
    }
    while let Some(taken) = gripper.take(now) {
        let (owner, width, force) = (taken.header.sender, Some(taken.data.width), taken.data.force);
        orders.push(Order::Gripper(GripperCommand { owner, width, force, fence: taken.fence }));
    }
    orders
}

fn signal(name: &str, unit: &str, value: f64, headline: bool) -> Signal {
    Signal { name: name.into(), unit: unit.into(), value, headline }
}

impl DoorWorld {
    /// Advances the plant to the present time.
    fn work(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) {
        let Some(state) = &mut self.state else { return };
        state.obey(tick.now, inputs, &mut self.servers);
        state.advance(tick.now, self.push);
        state.publish(tick.now, outputs);
    }
}

impl Controller for DoorWorld {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "DoorWorld";

    fn about() -> About {
        About::service(
            "Simulates the robot before a door and owns its devices. SI units; the manual's page on the door has every \
            parameter with its unit and meaning.",
        )
        .remembers()
        .every(Duration::from_millis(4))
        .with(parameters::PARAMETERS)
        .signals_every(SIGNALS_EVERY)
        .stop_within(STOP_WITHIN)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            setup: parameters::setup(arguments),
            delays: parameters::delays(arguments),
            push: (arguments.number("push_at"), arguments.number("push")),
            failing: Failing::new(arguments),
            servers: Servers::new(arguments),
            state: None,
        })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.state = None;
        self.servers.begin();
        Ok(())
    }

    fn exports(exports: &mut Exports<Self>) {
        shown::exports(exports);
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        self.state.get_or_insert_with(|| {
            let plant = Plant::new(self.setup, tick.now);
            Box::new(State::new(plant, self.delays, self.failing, self.setup.seed, tick.now))
        });
        self.work(tick, inputs, outputs);
        Progress::Continue
    }

    /// Robot and door continue until the controllers have brought arm and base to rest.
    fn stop(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Stopping {
        self.work(tick, inputs, outputs);
        let is_left = self.state.as_mut().is_none_or(|state| state.is_left(tick.now));
        if is_left { Stopping::Finished } else { Stopping::Again }
    }

    fn signals(&self) -> Vec<Signal> {
        self.state.as_ref().map(|state| state.signals()).unwrap_or_default()
    }
}
