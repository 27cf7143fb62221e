//! Any controller behind one object-safe trait, which both harnesses use.

use super::arguments::Arguments;
use super::calls::CallOrder;
use super::controller::{Configured, Controller, Progress, Stopping, Tick};
use super::database::{DATABASE, Database, DatabaseOrder, Unknown};
use super::export::{Activity, Exports, RawReply};
use super::interface::{Direction, Interface};
use super::key_ports::KeyPorts;
use super::port::{AnyIn, InputSet, OutputSet, Unfit};
use comms::io::direct::Filler;
use comms::logic::control::{KeyPort, MessageFate, PortMessage};
use comms::logic::database::DatabaseAnswer;
use comms::logic::decode::Source;
use comms::logic::object::ObjectError;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use thiserror::Error;

/// A controller instance whose ports take and give bytes.
///
/// The harness calls `init`, and then `calculate` until it does not return [`Progress::Continue`] or a stop is wanted.
/// Then it calls `stop` as long as it returns [`Stopping::Again`], also if the controller is done or aborted. After each
/// of these calls it calls `drain`.
pub trait Module: Send {
    /// Describes the type.
    fn interface(&self) -> &Interface;

    /// Hands a sample to an input; returns whether a calculation is due at once.
    ///
    /// # Errors
    /// If there is no such input, the bytes are not of its type, or a number in them is not finite. Then the input
    /// keeps its older value.
    fn deliver(&mut self, port: &str, bytes: &[u8], arrived: Time) -> Result<Delivery, DeliveryError>;

    /// Hands over a sample like [`Module::deliver`], from bytes that can only be copied.
    ///
    /// # Errors
    /// As in [`Module::deliver`].
    fn deliver_from(&mut self, port: &str, source: &mut dyn Source, arrived: Time) -> Result<Delivery, DeliveryError> {
        let mut bytes = Vec::new();
        source.append(source.left(), &mut bytes);
        self.deliver(port, &bytes, arrived)
    }

    /// Records that `count` values were sent to an input, but will not arrive.
    fn lose(&mut self, port: &str, count: u64) {
        let _ = (port, count);
    }

    /// Calls `Init(value)` and `Run()`.
    ///
    /// # Errors
    /// The reason why the controller does not run.
    fn init(&mut self, value: &[u8], now: Time) -> Result<(), String>;

    /// Like [`Module::init`], in a spec that connects these calls to others.
    ///
    /// # Errors
    /// As in [`Module::init`].
    fn init_with(&mut self, calls: &[&'static str], value: &[u8], now: Time) -> Result<(), String> {
        self.connect_calls(calls);
        self.init(value, now)
    }

    /// Continues with other parameters: a running controller is asked, and an idle controller is made again.
    ///
    /// # Errors
    /// The error in the parameters; the old ones stay.
    fn configure(&mut self, arguments: Arguments, running: bool) -> Result<Configured, String>;

    /// Calls `MainCalc()`.
    fn calculate(&mut self, now: Time) -> Progress;

    /// Calls `Stop()` once.
    fn stop(&mut self, now: Time) -> Stopping;

    /// Returns, for a person, the work outside of the program that may continue; none if the stop is confirmed. Called
    /// once when the stop has finished or has taken too long.
    fn unconfirmed(&mut self) -> Option<String> {
        None
    }

    /// Takes the values that the last call has sent, as (port, bytes), in order of declaration.
    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>));

    /// Takes the values that the last call has sent, like [`Module::drain`]. If the consumers of a value share memory,
    /// the value is encoded directly into this memory.
    fn drain_to(&mut self, outlets: &mut dyn Outlets) {
        self.drain(&mut |port, bytes| outlets.send(port, bytes));
    }

    /// Returns the values that a recorder may want to see.
    fn signals(&self) -> Vec<Signal>;

    /// Executes a call of an export; the answer may come later.
    fn serve(&mut self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        let _ = (argument, activity);
        reply.answer(Err(ObjectError::NoSuchProcedure { name: name.to_owned(), known: Vec::new() }));
    }

    /// Takes the calls to others that the spec connects. Called before an activation.
    fn connect_calls(&mut self, calls: &[&'static str]) {
        let _ = calls;
    }

    /// Takes the orders of the last call about calls to others, as (call, order), in order of declaration.
    fn drain_calls(&mut self, _: &mut dyn FnMut(&'static str, CallOrder)) {}

    /// Hands over the answer to a call of this controller; returns whether a calculation is due at once.
    fn answered(&mut self, call: &str, number: u64, result: Result<Vec<u8>, ObjectError>) -> Delivery {
        let _ = (call, number);
        drop(result);
        Delivery::Stored
    }

    /// Takes the ports that are connected with keys of the database. Called before an activation.
    fn connect_keys(&mut self, ports: Vec<KeyPort>) {
        drop(ports);
    }

    /// Takes the function that wakes the loop when something other than a port value arrives. Called before an
    /// activation.
    fn take_waker(&mut self, waker: Waker) {
        drop(waker);
    }

    /// Returns whether the controller takes samples while it does not run.
    fn hears_idle(&self) -> bool {
        false
    }

    /// Takes the messages for the node of its activity, in order. Only a program with the ports of an activity has such messages.
    fn drain_messages(&mut self, _: Time, _: &mut dyn FnMut(PortMessage)) {}

    /// Hands over the fate of a message of [`Module::drain_messages`].
    fn received(&mut self, number: u64, fate: MessageFate) {
        let _ = (number, fate);
    }

    /// Takes the requests of the last call to the database, in order.
    fn drain_database(&mut self, _: &mut dyn FnMut(DatabaseOrder)) {}

    /// Hands over an answer of the database; returns whether a calculation is due at once.
    fn database_answered(&mut self, number: u64, answer: Result<DatabaseAnswer, Unknown>) -> Delivery {
        let _ = number;
        drop(answer);
        Delivery::Stored
    }
}

/// Calls a controller. A panic in its code becomes a reason.
pub(super) fn guarded<T>(call: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(call)).map_err(|panic| {
        let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        format!("the controller panicked: {}", text.unwrap_or("no message"))
    })
}

/// Makes the loop of a controller calculate at once.
#[derive(Clone)]
pub struct Waker(Arc<dyn Fn() + Send + Sync>);

impl Waker {
    /// Returns a handle that calls `wake`.
    pub fn new(wake: impl Fn() + Send + Sync + 'static) -> Self {
        Self(Arc::new(wake))
    }

    /// Wakes the loop. While the controller does not run, nothing happens.
    pub fn wake(&self) {
        (self.0)();
    }
}

impl std::fmt::Debug for Waker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Waker")
    }
}

/// The destinations of outputs.
pub trait Outlets {
    /// Sends an encoded value.
    fn send(&mut self, port: &'static str, bytes: Vec<u8>);

    /// Skips the numbers of `count` values that were lost before they came to the output. Its consumers count them as
    /// lost.
    fn skip(&mut self, port: &'static str, count: u32) {
        let _ = (port, count);
    }

    /// Shows the values of outputs inside a group to people, and removes them from `values`. `heard` has an element for
    /// each of [`Interface::inner`](super::interface::Interface::inner), in that order. The call sets it to whether the
    /// output is watched from now on.
    fn show_inner(&mut self, values: &mut Vec<InnerValue>, heard: &mut [bool]) {
        values.clear();
        heard.fill(false);
    }

    /// Sends a value that `fill` encodes, if all its receivers share memory; returns whether it was sent. `fill`
    /// returns whether there was enough room.
    fn send_filled(&mut self, port: &'static str, fill: &mut dyn FnMut(&mut Filler<'_>) -> bool) -> bool;
}

/// A value of an output inside a group, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InnerValue {
    /// The index of its output in [`Interface::inner`](super::interface::Interface::inner).
    pub at: usize,
    /// How many values have left that output, including this one.
    pub number: u64,
    /// The value, encoded.
    pub bytes: Vec<u8>,
}

/// The answer of a module to a delivered sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// The sample waits for the next calculation.
    Stored,
    /// A calculation is due now: the sample came in on the trigger port.
    Triggers,
}

/// Why a sample was not taken.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum DeliveryError {
    /// The controller has no such input.
    #[error("`{type_name}` has no input `{port}`")]
    NoInput {
        /// The controller type.
        type_name: &'static str,
        /// The given name of the port.
        port: String,
    },
    /// The bytes are of another type or version.
    #[error("a sample for `{port}` is not a `{expected}`: {cause}")]
    Decode {
        /// The port.
        port: &'static str,
        /// The type of the port.
        expected: &'static str,
        /// The error of the decoder.
        cause: postcard::Error,
    },
    /// A number in the value is infinite or NaN, and its type does not allow that.
    #[error("a value for `{port}` was refused: a number in it is not finite")]
    NotFinite {
        /// The port.
        port: &'static str,
    },
}

impl DeliveryError {
    /// Returns the error for bytes that do not have the layout of an input's type.
    pub fn malformed(port: &'static str, expected: &'static str) -> Self {
        Self::Decode { port, expected, cause: postcard::Error::DeserializeBadEncoding }
    }
}

/// One instance of a controller with its ports.
pub(super) struct Instance<C: Controller> {
    controller: C,
    interface: Interface,
    inputs: C::Inputs,
    outputs: C::Outputs,
    exports: Exports<C>,
    key_ports: KeyPorts,
    /// The calls that the spec connects.
    connected: Vec<&'static str>,
    input_count: usize,
    last: Option<Time>,
    /// Parameters that wait for the next activation.
    next: Option<Arguments>,
}

/// Returns the interface of a controller type.
pub(super) fn interface<C: Controller>() -> Interface {
    let mut ports = C::Inputs::declared();
    ports.extend(C::Outputs::declared());
    let (exports, calls) = (exports::<C>().interfaces(), C::Outputs::declared_calls());
    Interface { type_name: C::TYPE, about: C::about(), ports, exports, calls, inner: Vec::new() }
}

fn exports<C: Controller>() -> Exports<C> {
    let mut exports = Exports::default();
    C::exports(&mut exports);
    exports
}

impl<C: Controller> Instance<C> {
    pub(super) fn new(controller: C) -> Self {
        let interface = interface::<C>();
        let input_count = interface.ports.iter().filter(|port| port.direction == Direction::In).count();
        Self {
            controller,
            interface,
            inputs: C::Inputs::unconnected(),
            outputs: C::Outputs::unconnected(),
            exports: exports(),
            key_ports: KeyPorts::default(),
            connected: Vec::new(),
            input_count,
            last: None,
            next: None,
        }
    }

    /// Delivers the news of the keys with which ports are connected.
    fn tell_news(&mut self, now: Time) {
        for (port, bytes) in self.key_ports.news(now) {
            // The spec was compared with the interface, and a port of another type gets nothing.
            drop(self.deliver(&port, &bytes, now));
        }
    }

    fn hand_over(
        &mut self,
        port: &str,
        mut deliver: impl FnMut(&mut dyn AnyIn) -> Result<(), Unfit>,
    ) -> Result<Delivery, DeliveryError> {
        let inputs = &self.interface.ports[..self.input_count];
        let Some((index, declared)) = inputs.iter().enumerate().find(|(_, declared)| declared.name == port) else {
            return Err(DeliveryError::NoInput { type_name: C::TYPE, port: port.to_owned() });
        };
        let mut result = Ok(());
        self.inputs.visit(&mut |at, input| {
            if at == index {
                result = deliver(input);
            }
        });
        let port = declared.name;
        result.map_err(|unfit| match unfit {
            Unfit::Encoding(cause) => DeliveryError::Decode { port, expected: declared.type_name, cause },
            Unfit::NotFinite => DeliveryError::NotFinite { port },
        })?;
        let trigger = self.interface.about.schedule.trigger;
        Ok(if trigger == Some(declared.name) { Delivery::Triggers } else { Delivery::Stored })
    }

    /// Drops waiting values of outputs that are not finite; returns the last port with such a value.
    fn refuse_outputs(&mut self) -> Option<&'static str> {
        let (ports, mut refused) = (&self.interface.ports[self.input_count..], None);
        self.outputs.visit(&mut |at, output| {
            if output.refuse() {
                refused = ports.get(at).map(|port| port.name);
            }
        });
        refused
    }

    /// Returns a reason to abort, extended by the problems of the inputs. So a reader whose sensor seems to be silent
    /// reports why.
    fn explained(&mut self, mut reason: String) -> String {
        let ports = &self.interface.ports;
        self.inputs.visit(&mut |at, input| {
            if let (Some(trouble), Some(port)) = (input.trouble(), ports.get(at)) {
                reason += &format!("; `{}` {trouble}", port.name);
            }
        });
        reason
    }

    fn tick(&mut self, now: Time) -> Tick {
        let elapsed = self.last.map_or(self.interface.about.schedule.period, |last| now.since(last));
        self.last = Some(now);
        Tick { now, elapsed }
    }
}

impl<C: Controller> Module for Instance<C> {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, bytes: &[u8], arrived: Time) -> Result<Delivery, DeliveryError> {
        self.hand_over(port, |input| input.deliver(bytes, arrived))
    }

    fn deliver_from(&mut self, port: &str, source: &mut dyn Source, arrived: Time) -> Result<Delivery, DeliveryError> {
        self.hand_over(port, |input| input.deliver_from(source, arrived))
    }

    fn lose(&mut self, port: &str, count: u64) {
        let inputs = &self.interface.ports[..self.input_count];
        let index = inputs.iter().position(|declared| declared.name == port);
        self.inputs.visit(&mut |at, input| {
            if Some(at) == index {
                input.lose(count);
            }
        });
    }

    fn init(&mut self, value: &[u8], now: Time) -> Result<(), String> {
        self.outputs = C::Outputs::unconnected();
        let (declared, connected) = (&self.interface.calls, &self.connected);
        self.outputs.visit_calls(&mut |at, calls| {
            if declared.get(at).is_some_and(|call| connected.contains(&call.name)) {
                calls.connect();
            }
        });
        self.key_ports.begin(&self.interface.ports, now);
        self.last = None;
        match self.next.take().map(|arguments| C::new(&arguments)) {
            Some(Ok(renewed)) => self.controller = renewed,
            Some(Err(why)) => tracing::warn!(why, "parameters of the database are ignored"),
            None => {}
        }
        self.outputs.database().into_iter().for_each(|database| database.begin(now));
        self.controller.init(value)?;
        self.controller.run(now);
        Ok(())
    }

    fn configure(&mut self, arguments: Arguments, running: bool) -> Result<Configured, String> {
        if running {
            let configured = self.controller.configure(&arguments)?;
            self.next = (configured == Configured::Later).then_some(arguments);
            return Ok(configured);
        }
        // The controller has already forgotten its last activation.
        self.controller = C::new(&arguments)?;
        self.next = None;
        Ok(Configured::Now)
    }

    fn calculate(&mut self, now: Time) -> Progress {
        let tick = self.tick(now);
        self.outputs.database().into_iter().for_each(|database| database.begin(now));
        self.tell_news(now);
        let progress = self.controller.main_calc(tick, &self.inputs, &mut self.outputs);
        self.inputs.visit(&mut |_, input| input.mark_seen());
        if let Some(port) = self.refuse_outputs() {
            return Progress::Aborted(self.explained(format!("a number of output `{port}` is not finite")));
        }
        match progress {
            Progress::Aborted(reason) => Progress::Aborted(self.explained(reason)),
            Progress::Done(value) if !self.interface.may_end_with(&value) => {
                Progress::Aborted("it is done with an outcome that its interface does not declare".to_owned())
            }
            Progress::Continue | Progress::Done(_) => progress,
        }
    }

    fn stop(&mut self, now: Time) -> Stopping {
        let tick = self.tick(now);
        self.outputs.database().into_iter().for_each(|database| database.begin(now));
        let stopping = self.controller.stop(tick, &self.inputs, &mut self.outputs);
        if let Some(port) = self.refuse_outputs() {
            tracing::warn!(port, "a number of an output is not finite while the controller stops");
        }
        match stopping {
            Stopping::Again => self.inputs.visit(&mut |_, input| input.mark_seen()),
            Stopping::Finished | Stopping::Failed(_) => self.inputs.visit(&mut |_, input| input.clear()),
        }
        stopping
    }

    fn unconfirmed(&mut self) -> Option<String> {
        self.controller.unconfirmed()
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        let (ports, key_ports) = (&self.interface.ports[self.input_count..], &mut self.key_ports);
        self.outputs.visit(&mut |at, output| {
            if let (Some(bytes), Some(port)) = (output.take(), ports.get(at)) {
                key_ports.sent(port.name, &bytes);
                send(port.name, bytes);
            }
        });
    }

    fn drain_to(&mut self, outlets: &mut dyn Outlets) {
        let (ports, key_ports) = (&self.interface.ports[self.input_count..], &mut self.key_ports);
        self.outputs.visit(&mut |at, output| {
            let Some(port) = ports.get(at).filter(|_| output.is_pending()) else { return };
            if !key_ports.writes(port.name) && outlets.send_filled(port.name, &mut |filler| output.fill(filler)) {
                return;
            }
            if let Some(bytes) = output.take() {
                key_ports.sent(port.name, &bytes);
                outlets.send(port.name, bytes);
            }
        });
    }

    fn signals(&self) -> Vec<Signal> {
        self.controller.signals()
    }

    fn serve(&mut self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        self.exports.serve(&mut self.controller, name, argument, activity, reply);
    }

    fn connect_calls(&mut self, calls: &[&'static str]) {
        self.connected = calls.to_vec();
    }

    fn drain_calls(&mut self, order: &mut dyn FnMut(&'static str, CallOrder)) {
        let declared = &self.interface.calls;
        self.outputs.visit_calls(&mut |at, calls| {
            if let Some(call) = declared.get(at) {
                calls.take().into_iter().for_each(|one| order(call.name, one));
            }
        });
    }

    fn answered(&mut self, call: &str, number: u64, result: Result<Vec<u8>, ObjectError>) -> Delivery {
        let Some(index) = self.interface.calls.iter().position(|declared| declared.name == call) else {
            return Delivery::Stored;
        };
        let mut result = Some(result);
        self.outputs.visit_calls(&mut |at, calls| {
            if at == index {
                result.take().into_iter().for_each(|result| calls.deliver(number, result));
            }
        });
        let trigger = self.interface.about.schedule.trigger;
        if trigger == Some(call) { Delivery::Triggers } else { Delivery::Stored }
    }

    fn connect_keys(&mut self, ports: Vec<KeyPort>) {
        self.key_ports.connect(ports);
    }

    fn drain_database(&mut self, order: &mut dyn FnMut(DatabaseOrder)) {
        self.outputs.database().into_iter().flat_map(Database::take).chain(self.key_ports.orders()).for_each(order);
    }

    fn database_answered(&mut self, number: u64, answer: Result<DatabaseAnswer, Unknown>) -> Delivery {
        let trigger = self.interface.about.schedule.trigger;
        let Err(answer) = self.key_ports.deliver(number, answer) else {
            let is_due = trigger.is_some_and(|port| self.key_ports.feeds(port));
            return if is_due { Delivery::Triggers } else { Delivery::Stored };
        };
        if let Some(database) = self.outputs.database() {
            database.deliver(number, answer);
        }
        if trigger == Some(DATABASE) { Delivery::Triggers } else { Delivery::Stored }
    }
}
