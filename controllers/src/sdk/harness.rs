//! Runs all modules in one thread on virtual time. The same seed gives the same result, bit for bit.
//!
//! Every calculation happens on its absolute deadline, or when its trigger sample arrives. Its values arrive one
//! transfer time later. A [`Disturbance`] simulates a busy machine: calculations are delayed, transfers take longer,
//! and samples are lost. Modules with the same time run in the order in which their calculations were armed.

mod calls;
mod disturbance;
mod lines;

use super::arguments::Arguments;
use super::controller::{Progress, Stopping};
use super::interface::{Binding, Direction};
use super::module::{Delivery, DeliveryError, Module};
use super::random::Random;
pub use calls::CallEnd;
use comms::logic::control::{MessageFate, PortMessage};
use comms::logic::human::span;
use comms::logic::object::ObjectError;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
pub use disturbance::Disturbance;
use lines::{Lines, Wire};
use std::collections::BTreeMap;
use std::time::Duration;
use thiserror::Error;

/// Identifies a module of a harness.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ModuleId(usize);

impl ModuleId {
    /// Returns how many modules were added before this one.
    pub fn number(self) -> usize {
        self.0
    }
}

/// Identifies a wire of a harness.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct WireId(usize);

/// The end of an activation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// When the stop of the activation had finished.
    pub at: Time,
    /// The module whose activation ended.
    pub module: ModuleId,
    /// How the activation ended.
    pub ending: Ending,
}

/// How an activation ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The activation ended normally, with a value.
    Done(Vec<u8>),
    /// The activation failed.
    Aborted(String),
    /// The activation was asked to stop.
    Stopped,
    /// The activation was asked to stop, and something outside may not be as the stop should leave it.
    Unconfirmed(String),
}

/// Why a wire cannot be made.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ConnectError {
    /// There is no such port, or it is bound to a device.
    #[error("`{module}` has no {direction} `{port}` to connect")]
    NoPort {
        /// The controller type.
        module: &'static str,
        /// `input` or `output`.
        direction: &'static str,
        /// The given name of the port.
        port: String,
    },
    /// The ports are of different types.
    #[error("`{from}` cannot feed `{to}`: the types differ")]
    Types {
        /// The output's type.
        from: &'static str,
        /// The input's type.
        to: &'static str,
    },
}

/// Modules, wires and a queue of the next events.
pub struct Harness {
    now: Time,
    slots: Vec<Slot>,
    lines: Lines,
    queue: BTreeMap<(Time, u64), HarnessEvent>,
    reports: Vec<Report>,
    numbered: u64,
    sent: u64,
    disturbance: Disturbance,
    random: Random,
    meddler: Option<Box<Meddler>>,
    listener: Option<Box<Listener>>,
}

/// Sees each value that leaves an output.
type Listener = dyn FnMut(&Sent<'_>);

/// A value that leaves an output, also if the output is not connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sent<'a> {
    /// The time of its calculation.
    pub at: Time,
    /// The module that sends it.
    pub module: ModuleId,
    /// The output.
    pub port: &'static str,
    /// The value, encoded.
    pub bytes: &'a [u8],
}

/// Sees each sample before its module gets it, and may change it.
type Meddler = dyn FnMut(&Sample, &mut Vec<u8>);

/// A sample that is about to be delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The time of its delivery.
    pub at: Time,
    /// The module that gets the sample.
    pub module: ModuleId,
    /// The input.
    pub port: &'static str,
    /// The type of the input's messages.
    pub type_name: &'static str,
}

struct Slot {
    module: Box<dyn Module>,
    state: State,
    /// Only the calculation with this number, which was armed last, is valid.
    token: u64,
    deadline: Time,
    held: (Time, Time),
    arrived_last: Time,
}

enum State {
    Idle,
    Running,
    Stopping { ending: Ending, until: Time },
}

enum HarnessEvent {
    Calculate {
        slot: usize,
        token: u64,
    },
    Deliver {
        slot: usize,
        port: &'static str,
        bytes: Vec<u8>,
    },
    /// A call has come to its server.
    Serve {
        call: u64,
    },
    /// The answer to a call has come back, or its time is over.
    Answer {
        call: u64,
        result: Result<Vec<u8>, ObjectError>,
    },
}

impl std::fmt::Debug for Harness {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Harness").field("now", &self.now).field("modules", &self.slots.len()).finish_non_exhaustive()
    }
}

impl Harness {
    /// Returns an empty harness at the origin of time.
    pub fn new(disturbance: Disturbance) -> Self {
        Self {
            now: Time::ZERO,
            slots: Vec::new(),
            lines: Lines::default(),
            queue: BTreeMap::new(),
            reports: Vec::new(),
            numbered: 0,
            sent: 0,
            random: Random::new(disturbance.seed),
            disturbance,
            meddler: None,
            listener: None,
        }
    }

    /// Returns the present time.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Returns how many samples have been sent over open wires and to devices.
    pub fn samples_sent(&self) -> u64 {
        self.sent
    }

    /// Adds a module that is not active.
    pub fn add(&mut self, module: Box<dyn Module>) -> ModuleId {
        self.slots.push(Slot {
            module,
            state: State::Idle,
            token: 0,
            deadline: Time::ZERO,
            held: (Time::ZERO, Time::ZERO),
            arrived_last: Time::ZERO,
        });
        ModuleId(self.slots.len() - 1)
    }

    /// Returns a module.
    pub fn module(&self, module: ModuleId) -> &dyn Module {
        &*self.slots[module.0].module
    }

    /// Returns the present signals of a module.
    pub fn signals(&self, module: ModuleId) -> Vec<Signal> {
        self.slots[module.0].module.signals()
    }

    /// Returns whether a module is neither idle nor stopping.
    pub fn is_running(&self, module: ModuleId) -> bool {
        matches!(self.slots[module.0].state, State::Running)
    }

    /// Returns whether a module is running or stopping.
    pub fn is_active(&self, module: ModuleId) -> bool {
        !matches!(self.slots[module.0].state, State::Idle)
    }

    /// Makes a closed wire.
    ///
    /// # Errors
    /// If a port does not exist or the types differ.
    pub fn connect(&mut self, from: (ModuleId, &str), to: (ModuleId, &str)) -> Result<WireId, ConnectError> {
        let (from_port, from_type) = self.port(from.0, from.1, Direction::Out)?;
        let (to_port, to_type) = self.port(to.0, to.1, Direction::In)?;
        if from_type != to_type {
            return Err(ConnectError::Types { from: from_type, to: to_type });
        }
        let wire = Wire { from: (from.0.0, from_port), to: (to.0.0, to_port), is_call: false, open: 0 };
        self.lines.wires.push(wire);
        Ok(WireId(self.lines.wires.len() - 1))
    }

    fn port(
        &self,
        module: ModuleId,
        name: &str,
        direction: Direction,
    ) -> Result<(&'static str, &'static str), ConnectError> {
        let interface = self.module(module).interface();
        let fits = |port: &&super::PortInterface| port.direction == direction && port.binding == Binding::Wire;
        interface.port(name).filter(fits).map(|port| (port.name, port.type_name)).ok_or_else(|| ConnectError::NoPort {
            module: interface.type_name,
            direction: match direction {
                Direction::In => "input",
                Direction::Out => "output",
            },
            port: name.to_owned(),
        })
    }

    /// Opens a wire. It stays open until it has been closed as often as it was opened.
    pub fn open(&mut self, wire: WireId) {
        self.lines.wires[wire.0].open += 1;
    }

    /// Closes a wire once.
    pub fn close(&mut self, wire: WireId) {
        let open = &mut self.lines.wires[wire.0].open;
        *open = open.saturating_sub(1);
    }

    /// Initialises and runs a module. If the module is not idle, nothing happens, and a report says so.
    pub fn activate(&mut self, module: ModuleId, value: &[u8]) {
        let (now, slot) = (self.now, &mut self.slots[module.0]);
        if !matches!(slot.state, State::Idle) {
            self.reports.push(Report { at: now, module, ending: Ending::Aborted("it is busy".to_owned()) });
            return;
        }
        match slot.module.init_with(&self.lines.connected(module.0), value, now) {
            Ok(()) => {
                slot.state = State::Running;
                slot.deadline = now;
                self.send(module.0);
                self.arm(module.0, now);
            }
            Err(reason) => self.reports.push(Report { at: now, module, ending: Ending::Aborted(reason) }),
        }
    }

    /// Gives a module new parameters, like a node.
    ///
    /// # Errors
    /// The reason why the module refuses them.
    pub fn configure(&mut self, module: ModuleId, arguments: Arguments) -> Result<(), String> {
        let running = self.is_active(module);
        self.slots[module.0].module.configure(arguments, running).map(drop)
    }

    /// Asks a module to stop, if it is running.
    pub fn stop(&mut self, module: ModuleId) {
        if self.is_running(module) {
            self.begin_stop(module.0, Ending::Stopped);
        }
    }

    /// Kills an active module like `kill -9`: it does not run any more, its devices receive nothing, and a report says
    /// so.
    pub fn crash(&mut self, module: ModuleId) {
        let (now, slot) = (self.now, &mut self.slots[module.0]);
        if !matches!(slot.state, State::Idle) {
            slot.state = State::Idle;
            slot.token += 1;
            self.lines.end_all(module.0);
            self.reports.push(Report { at: now, module, ending: Ending::Aborted("SIGKILL".to_owned()) });
        }
    }

    /// Replaces an active module by a new program, like a node that starts a dead program again. The module calculates again
    /// once it is activated; no report tells of its death.
    pub fn replace(&mut self, module: ModuleId, made: Box<dyn Module>) {
        let slot = &mut self.slots[module.0];
        (slot.module, slot.state) = (made, State::Idle);
        slot.token += 1;
        self.lines.end_all(module.0);
    }

    /// Cuts the network between these modules and all others, until the next cut: values, calls and answers are lost. An
    /// empty list heals the cut.
    pub fn cut(&mut self, modules: &[ModuleId]) {
        self.lines.cut(modules);
    }

    /// Sends an encoded value through an output, as if the module had sent it.
    ///
    /// # Errors
    /// If there is no such output.
    pub fn send_from(&mut self, module: ModuleId, port: &str, bytes: &[u8]) -> Result<(), ConnectError> {
        let (port, _) = self.port(module, port, Direction::Out)?;
        for (to, input) in self.receivers(module.0, port) {
            if !self.lines.is_cut(module.0, to) {
                self.transfer(to, input, bytes.to_vec());
            }
        }
        Ok(())
    }

    /// Takes the messages for the node of a module with the ports of an activity.
    pub fn take_messages(&mut self, module: ModuleId) -> Vec<PortMessage> {
        let mut messages = Vec::new();
        self.slots[module.0].module.drain_messages(self.now, &mut |message| messages.push(message));
        messages
    }

    /// Hands over the fate of a message of [`Harness::take_messages`].
    pub fn received(&mut self, module: ModuleId, number: u64, fate: MessageFate) {
        self.slots[module.0].module.received(number, fate);
    }

    /// Restarts an active module without its memory, like a supervisor that restarts only this module.
    pub fn restart(&mut self, module: ModuleId, value: &[u8]) {
        if self.is_active(module) {
            let slot = &mut self.slots[module.0];
            slot.state = State::Idle;
            slot.token += 1;
            self.lines.end_all(module.0);
            self.activate(module, value);
        }
    }

    /// Replaces the disturbance of the machine and the network from now on; the seed does not change.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        self.disturbance = disturbance;
    }

    /// Lets `meddler` see and change the encoded samples that modules get from now on.
    pub fn meddle(&mut self, meddler: impl FnMut(&Sample, &mut Vec<u8>) + 'static) {
        self.meddler = Some(Box::new(meddler));
    }

    /// Lets `listener` see the values that leave outputs from now on.
    pub fn listen(&mut self, listener: impl FnMut(&Sent<'_>) + 'static) {
        self.listener = Some(Box::new(listener));
    }

    /// Sends an encoded value to an input, as if over a wire.
    ///
    /// # Errors
    /// If there is no such input.
    pub fn send_to(&mut self, module: ModuleId, port: &str, bytes: Vec<u8>) -> Result<(), ConnectError> {
        let (port, _) = self.port(module, port, Direction::In)?;
        self.transfer(module.0, port, bytes);
        Ok(())
    }

    /// Lets time pass until an activation ends, or until the time `until`.
    pub fn run(&mut self, until: Time) -> Option<Report> {
        loop {
            if !self.reports.is_empty() {
                return Some(self.reports.remove(0));
            }
            self.take_answers();
            match self.queue.first_key_value() {
                Some((&(at, _), _)) if at <= until => {}
                _ => {
                    self.now = self.now.max(until);
                    return None;
                }
            }
            let ((at, _), happening) = self.queue.pop_first()?;
            self.now = at;
            match happening {
                HarnessEvent::Calculate { slot, token } => self.calculate(slot, token),
                HarnessEvent::Deliver { slot, port, bytes } => self.deliver(slot, port, bytes),
                HarnessEvent::Serve { call } => self.serve(call),
                HarnessEvent::Answer { call, result } => self.answer(call, result),
            }
        }
    }

    fn put(&mut self, at: Time, happening: HarnessEvent) {
        self.numbered += 1;
        self.queue.insert((at, self.numbered), happening);
    }

    /// Arms the next calculation of a slot; the machine may delay it.
    fn arm(&mut self, slot: usize, due: Time) {
        let hold = if self.random.unit() < self.disturbance.hold_chance {
            self.disturbance.hold_max.mul_f64(self.random.between(1.0 / 3.0, 1.0))
        } else {
            Duration::ZERO
        };
        let armed = &mut self.slots[slot];
        armed.token += 1;
        armed.held = (due, due + hold);
        let token = armed.token;
        self.put(due + hold, HarnessEvent::Calculate { slot, token });
    }

    fn calculate(&mut self, slot: usize, token: u64) {
        let (now, armed) = (self.now, &mut self.slots[slot]);
        if armed.token != token {
            return;
        }
        match armed.state {
            State::Idle => {}
            State::Running => {
                let progress = armed.module.calculate(now);
                self.send(slot);
                match progress {
                    Progress::Continue => self.arm_period(slot),
                    Progress::Done(value) => self.begin_stop(slot, Ending::Done(value)),
                    Progress::Aborted(reason) => self.begin_stop(slot, Ending::Aborted(reason)),
                }
            }
            State::Stopping { .. } => self.stop_once(slot),
        }
    }

    fn arm_period(&mut self, slot: usize) {
        let (now, armed) = (self.now, &mut self.slots[slot]);
        let schedule = armed.module.interface().about.schedule;
        let next = armed.deadline + schedule.period;
        // A trigger restarts the wait, except the trigger of a member of a group. A deadline that has passed is
        // skipped, not caught up.
        if schedule.trigger.is_some() || armed.deadline <= now {
            armed.deadline = if schedule.trigger.is_some() || next <= now { now + schedule.period } else { next };
        }
        let due = armed.deadline;
        self.arm(slot, due);
    }

    fn deliver(&mut self, slot: usize, port: &'static str, mut bytes: Vec<u8>) {
        let (now, receiver) = (self.now, &mut self.slots[slot]);
        if matches!(receiver.state, State::Idle) && !receiver.module.hears_idle() {
            return;
        }
        if let Some(meddler) = &mut self.meddler {
            let type_name = receiver.module.interface().port(port).map_or("", |port| port.type_name);
            meddler(&Sample { at: now, module: ModuleId(slot), port, type_name }, &mut bytes);
        }
        let held = receiver.held.0 <= now && now < receiver.held.1;
        let delivery = match receiver.module.deliver(port, &bytes, now) {
            Err(DeliveryError::NotFinite { .. }) => return,
            // The ports of an activity count a value that they cannot read.
            Err(_) if receiver.module.hears_idle() => return,
            taken => taken.expect("connect has compared the types"),
        };
        if delivery == Delivery::Triggers && !held && matches!(receiver.state, State::Running) {
            self.arm(slot, now);
        }
    }

    fn begin_stop(&mut self, slot: usize, ending: Ending) {
        let (now, stopped) = (self.now, &mut self.slots[slot]);
        let until = now + stopped.module.interface().about.stop_within;
        stopped.state = State::Stopping { ending, until };
        stopped.deadline = now;
        self.stop_once(slot);
    }

    fn stop_once(&mut self, slot: usize) {
        let now = self.now;
        let stopping = self.slots[slot].module.stop(now);
        self.send(slot);
        let stopped = &mut self.slots[slot];
        let State::Stopping { ending, until } = &mut stopped.state else { return };
        if stopping == Stopping::Again && now < *until {
            self.arm_period(slot);
            return;
        }
        let ending = std::mem::replace(ending, Ending::Stopped);
        let failed = match stopping {
            Stopping::Finished => None,
            Stopping::Again => {
                let within = span(stopped.module.interface().about.stop_within);
                Some(format!("did not stop within {within}"))
            }
            Stopping::Failed(why) => Some(format!("its stop failed: {why}")),
        };
        let unconfirmed = stopped.module.unconfirmed();
        let ending = match (ending, failed, unconfirmed) {
            (ending, None, None) => ending,
            (Ending::Stopped, None, Some(why)) => Ending::Unconfirmed(why),
            (Ending::Aborted(first), failed, unconfirmed) => {
                let all: Vec<String> = [Some(first), failed, unconfirmed].into_iter().flatten().collect();
                Ending::Aborted(all.join("; "))
            }
            (Ending::Done(_) | Ending::Stopped | Ending::Unconfirmed(_), failed, unconfirmed) => {
                let all: Vec<String> = [failed, unconfirmed].into_iter().flatten().collect();
                Ending::Aborted(all.join("; "))
            }
        };
        stopped.state = State::Idle;
        stopped.token += 1;
        self.lines.end_all(slot);
        self.reports.push(Report { at: now, module: ModuleId(slot), ending });
    }

    /// Starts the transfer of all values that a module has sent.
    fn send(&mut self, slot: usize) {
        let mut samples = Vec::new();
        self.slots[slot].module.drain(&mut |port, bytes| samples.push((port, bytes)));
        for (port, bytes) in samples {
            if let Some(listener) = &mut self.listener {
                listener(&Sent { at: self.now, module: ModuleId(slot), port, bytes: &bytes });
            }
            for receiver in self.receivers(slot, port) {
                if !self.lines.is_cut(slot, receiver.0) {
                    self.transfer(receiver.0, receiver.1, bytes.clone());
                }
            }
        }
        self.send_calls(slot);
    }

    /// Starts the transfer of a sample to an input; the network may lose it.
    fn transfer(&mut self, to: usize, input: &'static str, bytes: Vec<u8>) {
        self.sent += 1;
        if self.random.unit() < self.disturbance.drop_chance {
            return;
        }
        let jitter = self.disturbance.transfer_jitter.mul_f64(self.random.unit());
        // Samples to one receiver never overtake each other.
        let at = (self.now + self.disturbance.transfer + jitter).max(self.slots[to].arrived_last);
        self.slots[to].arrived_last = at;
        self.put(at, HarnessEvent::Deliver { slot: to, port: input, bytes });
    }

    fn receivers(&self, slot: usize, port: &'static str) -> Vec<(usize, &'static str)> {
        let binding = self.slots[slot].module.interface().port(port).map_or(Binding::Wire, |port| port.binding);
        let other = match binding {
            Binding::Wire => {
                let open =
                    self.lines.wires.iter().filter(|wire| !wire.is_call && wire.open > 0 && wire.from == (slot, port));
                return open.map(|wire| wire.to).collect();
            }
            Binding::Client => Binding::Owner,
            Binding::Owner => Binding::Client,
        };
        let hears = |interface: &super::Interface| {
            interface.ports.iter().any(|p| p.name == port && p.direction == Direction::In && p.binding == other)
        };
        let hearing = self.slots.iter().enumerate().filter(|(_, listener)| hears(listener.module.interface()));
        hearing.map(|(listener, _)| (listener, port)).collect()
    }
}
