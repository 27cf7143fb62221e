//! An instance of a Python class, as a module of the kit.
//!
//! The interpreter is attached only for `init`, calculations, `stop`, calls and signals; values arrive and leave without it.
//! Each activation begins with a new object of the class.

use crate::calls::{CallState, Calls};
use crate::database::{DatabaseOf, DatabaseState};
use crate::declaration::Class;
use crate::encoded::Encoded;
use crate::ending::{Abort, Done, Tick};
use crate::failure::told;
use crate::forked;
use crate::input::{EveryInput, Input, InputState, Refused};
use crate::keys::KeysState;
use crate::messaging::Stations;
use crate::output::{Output, OutputState};
use crate::quantity::seconds;
use comms::logic::database::DatabaseAnswer;
use comms::logic::decode::Source;
use comms::logic::object::ObjectError;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use controllers::sdk::{
    Activity, Arguments, CallOrder, Configured, DatabaseOrder, Delivery, DeliveryError, Interface, KeyPort, KeyPorts,
    Kind, Module, Outlets, Parameter, Progress, RawReply, Stopping, Unknown,
};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::Arc;
use std::time::Duration;

/// The most signals of a controller, the same as in Rust.
const SIGNALS_MAX: usize = comms::logic::signals::VALUES_MAX;

/// The trigger name for answers of the database.
const DATABASE: &str = "database";

/// An instance of a class.
#[derive(Debug)]
pub(crate) struct Instance {
    class: Arc<Class>,
    ends: Ends,
    key_ports: KeyPorts,
    /// The calls that the spec connects.
    connected: Vec<&'static str>,
    arguments: Arguments,
    object: Py<PyAny>,
    /// Whether an activation has already used the object.
    is_used: bool,
    last: Option<Time>,
}

/// The ports and calls of an instance, which its object has as attributes. They are in the order of the class.
#[derive(Debug)]
struct Ends {
    inputs: Vec<Arc<InputState>>,
    outputs: Vec<Arc<OutputState>>,
    calls: Vec<Arc<CallState>>,
    stations: Stations,
    keys: Vec<Arc<KeysState>>,
    database: Arc<DatabaseState>,
}

/// A signal in the form that Python returns.
#[derive(FromPyObject)]
struct GivenSignal {
    name: String,
    value: f64,
    unit: String,
    headline: bool,
}

impl Instance {
    /// Makes an idle instance.
    ///
    /// # Errors
    /// The last line of the exception, if `__init__` raises one.
    pub(crate) fn new(class: &Arc<Class>, arguments: &Arguments) -> Result<Self, String> {
        forked::call(|py| {
            let ends = Ends::new(py, class, arguments).map_err(|error| told(py, error))?;
            let object = make(py, class, &ends, arguments).map_err(|error| told(py, error))?;
            Ok(Self {
                class: Arc::clone(class),
                ends,
                key_ports: KeyPorts::default(),
                connected: Vec::new(),
                arguments: arguments.clone(),
                object,
                is_used: false,
                last: None,
            })
        })
    }

    fn find(&self, port: &str) -> Option<usize> {
        let inputs = self.class.interface.ports.iter().take(self.ends.inputs.len());
        inputs.enumerate().find(|(_, declared)| declared.name == port).map(|(at, _)| at)
    }

    /// Takes a value for an input.
    fn take(&self, port: &str, bytes: Vec<u8>, arrived: Time) -> Result<Delivery, DeliveryError> {
        let interface = &self.class.interface;
        let Some(at) = self.find(port) else {
            return Err(DeliveryError::NoInput { type_name: interface.type_name, port: port.to_owned() });
        };
        let declared = &interface.ports[at];
        self.ends.inputs[at].deliver(bytes, arrived).map_err(|refused| match refused {
            Refused::Malformed => DeliveryError::malformed(declared.name, declared.type_name),
            Refused::NotFinite => DeliveryError::NotFinite { port: declared.name },
        })?;
        let triggers = interface.about.schedule.trigger == Some(declared.name);
        Ok(if triggers { Delivery::Triggers } else { Delivery::Stored })
    }

    fn tick(&mut self, now: Time) -> Tick {
        let period = self.class.interface.about.schedule.period;
        let elapsed: Duration = self.last.map_or(period, |last| now.since(last));
        self.last = Some(now);
        Tick { now: seconds(now), elapsed: elapsed.as_secs_f64() }
    }

    /// Delivers the values of the keys that ports are connected to.
    fn tell_news(&mut self, now: Time) {
        for (port, bytes) in self.key_ports.news(now) {
            for (keys, declared) in
                self.ends.keys.iter().zip(&self.class.keys).filter(|(_, of)| of.interface.name == port)
            {
                keys.deliver(declared.interface.type_name, &bytes);
            }
        }
    }

    fn drain_encoded(&mut self, send: &mut dyn FnMut(&'static str, Encoded)) {
        let ports = self.class.interface.ports.iter().skip(self.ends.inputs.len());
        for (output, declared) in self.ends.outputs.iter().zip(ports) {
            if let Some(encoded) = output.take() {
                send(declared.name, encoded);
            }
        }
        self.put_keys();
    }

    /// Takes the values that outputs write to keys.
    fn put_keys(&mut self) {
        for (keys, declared) in self.ends.keys.iter().zip(&self.class.keys) {
            keys.take().iter().for_each(|bytes| self.key_ports.sent(declared.interface.name, bytes));
        }
    }

    /// Returns a reason for an abort, with the problems of the inputs added.
    fn explained(&self, mut reason: String) -> String {
        for (input, declared) in self.ends.inputs.iter().zip(&self.class.interface.ports) {
            if let Some(trouble) = input.trouble() {
                reason += &format!("; `{}` {trouble}", declared.name);
            }
        }
        reason
    }

    fn begin(&mut self, py: Python<'_>, value: &[u8]) -> PyResult<()> {
        if self.is_used {
            self.object = make(py, &self.class, &self.ends, &self.arguments)?;
        }
        self.is_used = true;
        let object = self.object.bind(py);
        if object.hasattr("init")? {
            object.call_method1("init", (PyBytes::new(py, value),))?;
        }
        Ok(())
    }

    /// Returns how a calculation ends, according to its returned value.
    fn progress(&self, returned: &Bound<'_, PyAny>) -> PyResult<Progress> {
        if returned.is_none() {
            return Ok(Progress::Continue);
        }
        if let Ok(done) = returned.cast::<Done>() {
            let interface = &self.class.interface;
            // Without declared outcomes, any value is a normal end, but a tag is not.
            let has_outcomes = !interface.about.outcomes.is_empty();
            let is_declared =
                |value: &[u8]| interface.may_end_with(value) && (has_outcomes || done.get().tag.is_none());
            return Ok(match done.get().progress() {
                Progress::Done(value) if !is_declared(&value) => {
                    Progress::Aborted("it is done with an outcome that its interface does not declare".to_owned())
                }
                progress @ (Progress::Continue | Progress::Done(_) | Progress::Aborted(_)) => progress,
            });
        }
        if let Ok(abort) = returned.cast::<Abort>() {
            return Ok(Progress::Aborted(abort.get().reason.clone()));
        }
        let kind = returned.get_type().name()?;
        Err(PyTypeError::new_err(format!(
            "`main_calc` returned a `{kind}`: expected None, dca.done(...) or dca.abort(...)"
        )))
    }
}

impl Module for Instance {
    fn interface(&self) -> &Interface {
        &self.class.interface
    }

    fn deliver(&mut self, port: &str, bytes: &[u8], arrived: Time) -> Result<Delivery, DeliveryError> {
        self.take(port, bytes.to_vec(), arrived)
    }

    /// The bytes are copied once, to their final place.
    fn deliver_from(&mut self, port: &str, source: &mut dyn Source, arrived: Time) -> Result<Delivery, DeliveryError> {
        let mut bytes = Vec::new();
        source.append(source.left(), &mut bytes);
        self.take(port, bytes, arrived)
    }

    fn lose(&mut self, port: &str, count: u64) {
        if let Some(at) = self.find(port) {
            self.ends.inputs[at].lose(count);
        }
    }

    fn init(&mut self, value: &[u8], now: Time) -> Result<(), String> {
        self.last = None;
        self.ends.database.renew();
        self.ends.database.begin(now);
        self.ends.outputs.iter().for_each(|output| drop(output.take()));
        for (calls, declared) in self.ends.calls.iter().zip(&self.class.interface.calls) {
            calls.begin(self.connected.contains(&declared.name));
        }
        self.ends.stations.begin(&self.connected);
        self.ends.stations.work(now);
        self.ends.keys.iter().for_each(|keys| keys.begin());
        self.key_ports.begin(&self.class.interface.ports, now);
        let begun = forked::call(|py| self.begin(py, value).map_err(|error| told(py, error)));
        self.ends.stations.work(now);
        begun
    }

    /// Parameters are attributes, which the next calculation reads.
    fn configure(&mut self, arguments: Arguments, running: bool) -> Result<Configured, String> {
        let set = |py: Python<'_>| -> PyResult<()> {
            let object = self.object.bind(py);
            let values = values(py, &self.class.interface, &arguments)?;
            self.class.declaration.bind(py).call_method1("set", (object, values))?;
            if running && object.hasattr("configure")? {
                object.call_method0("configure")?;
            }
            Ok(())
        };
        forked::call(|py| set(py).map_err(|error| told(py, error)))?;
        self.arguments = arguments;
        Ok(Configured::Now)
    }

    fn calculate(&mut self, now: Time) -> Progress {
        let tick = self.tick(now);
        self.ends.database.begin(now);
        self.ends.stations.work(now);
        self.tell_news(now);
        let progress = forked::call(|py| {
            let returned = self.object.bind(py).call_method1("main_calc", (tick,));
            returned.and_then(|returned| self.progress(&returned)).map_err(|error| told(py, error))
        });
        self.ends.inputs.iter().for_each(|input| input.mark_seen());
        self.ends.stations.work(now);
        match progress {
            Ok(Progress::Aborted(reason)) | Err(reason) => Progress::Aborted(self.explained(reason)),
            Ok(progress @ (Progress::Continue | Progress::Done(_))) => progress,
        }
    }

    fn stop(&mut self, now: Time) -> Stopping {
        let tick = self.tick(now);
        self.ends.database.begin(now);
        self.ends.stations.work(now);
        let call = |py: Python<'_>| -> PyResult<bool> {
            let object = self.object.bind(py);
            if !object.hasattr("stop")? {
                return Ok(true);
            }
            // A method without a `return` counts as finished.
            let returned = object.call_method1("stop", (tick,))?;
            Ok(returned.is_none() || returned.is_truthy()?)
        };
        let is_finished = forked::call(|py| call(py).map_err(|error| told(py, error)));
        self.ends.stations.work(now);
        let stopping = match is_finished {
            Ok(true) => Stopping::Finished,
            Ok(false) => {
                self.ends.inputs.iter().for_each(|input| input.mark_seen());
                return Stopping::Again;
            }
            Err(why) => Stopping::Failed(why),
        };
        self.ends.inputs.iter().for_each(|input| input.clear());
        stopping
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        self.drain_encoded(&mut |port, encoded| send(port, encoded.whole()));
    }

    fn drain_to(&mut self, outlets: &mut dyn Outlets) {
        self.drain_encoded(&mut |port, encoded| {
            if !outlets.send_filled(port, &mut |filler| encoded.each(&mut |bytes| filler.put(bytes))) {
                outlets.send(port, encoded.whole());
            }
        });
    }

    fn serve(&mut self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        if let Some(station) = self.ends.stations.server(name) {
            return station.serve(name, argument, activity, reply);
        }
        match self.class.exports.iter().find(|export| export.interface.name == name) {
            Some(export) => export.serve(&self.object, argument, activity, reply),
            None => {
                let known = self.class.exports.iter().map(|export| export.interface.name.to_owned()).collect();
                reply.answer(Err(ObjectError::NoSuchProcedure { name: name.to_owned(), known }));
            }
        }
    }

    fn connect_keys(&mut self, ports: Vec<KeyPort>) {
        self.key_ports.connect(ports);
    }

    fn connect_calls(&mut self, calls: &[&'static str]) {
        self.connected = calls.to_vec();
    }

    fn drain_calls(&mut self, order: &mut dyn FnMut(&'static str, CallOrder)) {
        for (calls, declared) in self.ends.calls.iter().zip(&self.class.interface.calls) {
            calls.take().into_iter().for_each(|one| order(declared.name, one));
        }
        self.ends.stations.take(order);
    }

    fn answered(&mut self, call: &str, number: u64, result: Result<Vec<u8>, ObjectError>) -> Delivery {
        let interface = &self.class.interface;
        let Some(at) = interface.calls.iter().position(|declared| declared.name == call) else {
            return Delivery::Stored;
        };
        match self.ends.calls.get(at) {
            Some(calls) => calls.deliver(number, result),
            None => {
                if let Some(station) = self.ends.stations.caller(call) {
                    station.deliver(number, result);
                }
            }
        }
        if interface.about.schedule.trigger == Some(call) { Delivery::Triggers } else { Delivery::Stored }
    }

    fn drain_database(&mut self, order: &mut dyn FnMut(DatabaseOrder)) {
        self.ends.database.take().into_iter().chain(self.key_ports.orders()).for_each(order);
    }

    fn database_answered(&mut self, number: u64, answer: Result<DatabaseAnswer, Unknown>) -> Delivery {
        let trigger = self.class.interface.about.schedule.trigger;
        let triggers = match self.key_ports.deliver(number, answer) {
            Ok(()) => trigger.is_some_and(|port| self.key_ports.feeds(port)),
            Err(answer) => {
                self.ends.database.deliver(number, answer);
                trigger == Some(DATABASE)
            }
        };
        if triggers { Delivery::Triggers } else { Delivery::Stored }
    }

    fn signals(&self) -> Vec<Signal> {
        let read = |py: Python<'_>| -> PyResult<Vec<Signal>> {
            let given: Vec<GivenSignal> = self.object.bind(py).call_method0("signals")?.extract()?;
            let signal = |GivenSignal { name, value, unit, headline }| Signal { name, unit, value, headline };
            Ok(given.into_iter().take(SIGNALS_MAX).map(signal).collect())
        };
        forked::call(|py| {
            read(py).unwrap_or_else(|error| {
                told(py, error);
                Vec::new()
            })
        })
    }
}

impl Ends {
    fn new(py: Python<'_>, class: &Class, arguments: &Arguments) -> PyResult<Self> {
        Ok(Self {
            inputs: class.inputs().map(|port| InputState::new(Arc::clone(&port.message), port.keeps_all)).collect(),
            outputs: class.outputs().map(|port| OutputState::new(Arc::clone(&port.message))).collect(),
            calls: class.calls.iter().map(CallState::new).collect(),
            stations: Stations::make(py, &class.stations, arguments.instance())?,
            keys: class.keys.iter().map(|_| Arc::default()).collect(),
            database: Arc::default(),
        })
    }
}

/// Makes an object of the class, with ports and parameters as attributes.
fn make(py: Python<'_>, class: &Class, ends: &Ends, arguments: &Arguments) -> PyResult<Py<PyAny>> {
    let (attributes, values) = (PyDict::new(py), values(py, &class.interface, arguments)?);
    if let Some(attribute) = &class.database {
        attributes.set_item(attribute, DatabaseOf(Arc::clone(&ends.database)))?;
    }
    for (attribute, object) in &ends.stations.objects {
        attributes.set_item(attribute, object)?;
    }
    for (keys, declared) in ends.keys.iter().zip(&class.keys) {
        attributes.set_item(&declared.attribute, keys.object(py, declared.interface.type_name)?)?;
    }
    for (calls, declared) in ends.calls.iter().zip(&class.calls) {
        attributes.set_item(&declared.attribute, Calls(Arc::clone(calls)))?;
    }
    for (input, port) in ends.inputs.iter().zip(class.inputs()) {
        let state = Arc::clone(input);
        if port.keeps_all {
            attributes.set_item(&port.attribute, EveryInput(state))?;
        } else {
            attributes.set_item(&port.attribute, Input(state))?;
        }
    }
    for (output, port) in ends.outputs.iter().zip(class.outputs()) {
        attributes.set_item(&port.attribute, Output(Arc::clone(output)))?;
    }
    Ok(class.declaration.bind(py).call_method1("make", (attributes, values))?.unbind())
}

/// Returns the parameters as Python values, by name.
fn values<'py>(py: Python<'py>, interface: &Interface, arguments: &Arguments) -> PyResult<Bound<'py, PyDict>> {
    let values = PyDict::new(py);
    for &Parameter { name, kind, .. } in interface.about.parameters {
        match kind {
            Kind::Text(_) => values.set_item(name, arguments.text(name))?,
            Kind::Number(..) | Kind::Whole(..) | Kind::Quantity(..) => values.set_item(name, arguments.number(name))?,
            Kind::Truth => values.set_item(name, arguments.truth(name))?,
            Kind::Secret => {
                let secret = arguments.secret(name)?;
                values.set_item(name, PyBytes::new(py, &secret))?;
            }
        }
    }
    Ok(values)
}
