//! Turns the declaration of a decorated class into the interface of a controller type.

use crate::calls::{CallsOf, DeclaredCalls};
use crate::exports::{DeclaredExport, Export};
use crate::keys::{DeclaredKeys, KeysOf};
use crate::message::MessageType;
use crate::messaging::StationOf;
use crate::quantity::{si, span};
use controllers::sdk::{
    About, Arguments, Binding, Direction, Interface, Kind, Outcome, Parameter, PortInterface, Quantity, StartValue,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Arc;

/// A declared class, with the properties that are known without an instance.
#[derive(Debug)]
pub(crate) struct Class {
    /// The Python object that makes instances.
    pub(crate) declaration: Py<PyAny>,
    pub(crate) interface: Interface,
    /// The ports in the order of the interface: inputs, then outputs.
    pub(crate) ports: Vec<Port>,
    pub(crate) exports: Vec<Export>,
    /// The calls in the order of the interface.
    pub(crate) calls: Vec<CallsOf>,
    /// Queues, locks, routers, and clients for these. In the interface, their calls come after `calls`.
    pub(crate) stations: Vec<StationOf>,
    /// Behind the ports of `ports`.
    pub(crate) keys: Vec<KeysOf>,
    /// The attribute of the database.
    pub(crate) database: Option<String>,
}

/// The part of a port that its interface does not have.
#[derive(Debug)]
pub(crate) struct Port {
    /// The attribute of the class that declares it.
    pub(crate) attribute: String,
    pub(crate) message: Arc<Py<MessageType>>,
    pub(crate) keeps_all: bool,
}

/// The declaration, with the fields of `_controller.py`.
#[derive(FromPyObject)]
struct Declaration {
    name: String,
    doc: String,
    is_service: bool,
    every: Option<Py<PyAny>>,
    triggered_by: Option<String>,
    stop_within: Option<Py<PyAny>>,
    remembers: bool,
    signals_every: Option<Py<PyAny>>,
    members: DeclaredMembers,
    values: DeclaredValues,
}

/// The attributes of the class that are declarations.
#[derive(FromPyObject)]
struct DeclaredMembers {
    ports: Vec<DeclaredPort>,
    exports: Vec<DeclaredExport>,
    calls: Vec<DeclaredCalls>,
    stations: Vec<Py<PyAny>>,
    keys: Vec<DeclaredKeys>,
    database: Option<String>,
    parameters: Vec<DeclaredParameter>,
}

/// The message type that an activation begins with, and its normal ends, each with the name of its message type.
#[derive(FromPyObject)]
struct DeclaredValues(Option<Py<MessageType>>, Vec<(String, Option<String>)>);

#[derive(FromPyObject)]
struct DeclaredPort {
    name: String,
    attribute: String,
    is_input: bool,
    keeps_all: bool,
    is_optional: bool,
    /// `client` or `owner` of a device; none for a port of a wire.
    device: Option<String>,
    message: Py<MessageType>,
    doc: String,
}

#[derive(FromPyObject)]
struct DeclaredParameter {
    name: String,
    type_name: String,
    is_whole: bool,
    words: Vec<String>,
    low: Option<Py<PyAny>>,
    high: Option<Py<PyAny>>,
    default: Option<Py<PyAny>>,
}

impl Class {
    /// Returns the class that a Python object declares.
    pub(crate) fn of(declaration: &Bound<'_, PyAny>) -> PyResult<Arc<Self>> {
        let py = declaration.py();
        let declared: Declaration = declaration.extract()?;
        let members = declared.members;
        let (inputs, outputs): (Vec<_>, Vec<_>) = members.ports.into_iter().partition(|port| port.is_input);
        let (mut ports, mut interfaces) = (Vec::new(), Vec::new());
        for port in inputs.into_iter().chain(outputs) {
            interfaces.push(port.interface(py));
            let DeclaredPort { attribute, message, keeps_all, .. } = port;
            ports.push(Port { attribute, message: Arc::new(message), keeps_all });
        }
        let parameters = members.parameters.iter().map(|one| one.parameter(py)).collect::<PyResult<Vec<_>>>()?;
        let DeclaredValues(start, outcomes) = declared.values;
        let outcomes = outcomes
            .into_iter()
            .map(|(tag, type_name)| Outcome { tag: for_ever(tag), type_name: type_name.map(for_ever) });
        let doc = for_ever(declared.doc);
        let mut about = if declared.is_service { About::service(doc) } else { About::task(doc) };
        about.remembers = declared.remembers;
        about.parameters = Box::leak(parameters.into_boxed_slice());
        about.start = start.map(|message| {
            let message = message.bind(py).get();
            StartValue { type_name: for_ever(message.name.clone()), fields: for_ever(message.fields.clone()) }
        });
        about.outcomes = Box::leak(outcomes.collect::<Vec<_>>().into_boxed_slice());
        let given = |value: Option<Py<PyAny>>| value.map(|value| span(value.bind(py))).transpose();
        about.schedule.period = given(declared.every)?.unwrap_or(about.schedule.period);
        about.schedule.trigger = declared.triggered_by.map(for_ever);
        about.stop_within = given(declared.stop_within)?.unwrap_or(about.stop_within);
        about.signals_every = given(declared.signals_every)?;
        if about.schedule.period.is_zero() {
            return Err(PyValueError::new_err("`every` is 0 s: a controller has a period"));
        }
        let exports: Vec<Export> = members.exports.into_iter().map(|one| one.export(for_ever)).collect();
        let (calls, mut call_interfaces): (Vec<_>, Vec<_>) =
            members.calls.into_iter().map(|one| one.calls(for_ever)).unzip();
        let stations = members.stations.iter().map(|one| StationOf::of(one.bind(py), for_ever));
        let stations = stations.collect::<PyResult<Vec<StationOf>>>()?;
        call_interfaces.extend(stations.iter().filter_map(StationOf::calls));
        let keys: Vec<KeysOf> = members.keys.into_iter().map(|one| one.keys(for_ever)).collect();
        interfaces.extend(keys.iter().map(|keys| keys.interface.clone()));
        let of_stations = stations.iter().flat_map(StationOf::exports);
        let interface = Interface {
            type_name: for_ever(declared.name),
            about,
            ports: interfaces,
            exports: exports.iter().map(|export| export.interface.clone()).chain(of_stations).collect(),
            calls: call_interfaces,
            inner: Vec::new(),
        };
        let (declaration, database) = (declaration.clone().unbind(), members.database);
        Ok(Arc::new(Self { declaration, interface, ports, exports, calls, stations, keys, database }))
    }

    /// Returns the record types that are list elements in messages of the class's ports, calls and exports: their
    /// names and fields.
    pub(crate) fn inner_types(&self, py: Python<'_>) -> Vec<(String, String)> {
        let ports = self.ports.iter().map(|port| &port.message);
        let calls = self.calls.iter().flat_map(|calls| calls.messages());
        let exports = self.exports.iter().flat_map(|export| export.messages());
        ports.chain(calls).chain(exports).flat_map(|message| message.bind(py).get().inner.clone()).collect()
    }

    /// Returns the inputs, in order.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Port> {
        self.of_direction(Direction::In)
    }

    /// Returns the outputs, in order.
    pub(crate) fn outputs(&self) -> impl Iterator<Item = &Port> {
        self.of_direction(Direction::Out)
    }

    fn of_direction(&self, direction: Direction) -> impl Iterator<Item = &Port> {
        let ports = self.ports.iter().zip(&self.interface.ports);
        ports.filter(move |(_, declared)| declared.direction == direction).map(|(port, _)| port)
    }
}

impl DeclaredPort {
    fn interface(&self, py: Python<'_>) -> PortInterface {
        let message = self.message.bind(py).get();
        let direction = if self.is_input { Direction::In } else { Direction::Out };
        let wire = PortInterface::wire(for_ever(self.name.clone()), direction, for_ever(message.name.clone()));
        let wire = wire.carrying(for_ever(message.fields.clone())).documented(for_ever(self.doc.clone()));
        let binding = match self.device.as_deref() {
            None => Binding::Wire,
            Some("owner") => Binding::Owner,
            Some(_) => Binding::Client,
        };
        PortInterface { required: !self.is_optional, binding, ..wire }
    }
}

impl DeclaredParameter {
    fn parameter(&self, py: Python<'_>) -> PyResult<Parameter> {
        let wrong = |error: PyErr| PyValueError::new_err(format!("parameter `{}`: {}", self.name, error.value(py)));
        let end = |end: &Option<Py<PyAny>>, unlimited| match end {
            Some(value) => si(value.bind(py), &self.type_name).map_err(wrong),
            None => Ok(unlimited),
        };
        let quantity = Quantity::ALL.into_iter().find(|quantity| quantity.name() == self.type_name);
        let kind = match (self.type_name.as_str(), quantity) {
            ("Text", _) => {
                let words: Vec<&'static str> = self.words.iter().map(|word| for_ever(word.clone())).collect();
                Kind::Text(Box::leak(words.into_boxed_slice()))
            }
            ("Truth", _) => Kind::Truth,
            ("Secret", _) => Kind::Secret,
            ("Number", _) if self.is_whole => {
                Kind::Whole(end(&self.low, f64::NEG_INFINITY)?, end(&self.high, f64::INFINITY)?)
            }
            ("Number", _) => Kind::Number(end(&self.low, f64::NEG_INFINITY)?, end(&self.high, f64::INFINITY)?),
            (_, Some(quantity)) => {
                Kind::Quantity(quantity, end(&self.low, f64::NEG_INFINITY)?, end(&self.high, f64::INFINITY)?)
            }
            (other, None) => {
                return Err(PyValueError::new_err(format!("`{other}` is not a type of parameters")));
            }
        };
        let default = match (&self.default, kind) {
            (None, _) => None,
            (Some(value), Kind::Number(..) | Kind::Whole(..) | Kind::Quantity(..)) => {
                Some(si(value.bind(py), &self.type_name).map_err(wrong)?.to_string())
            }
            (Some(value), Kind::Truth) => Some(value.extract::<bool>(py).map_err(wrong)?.to_string()),
            (Some(value), Kind::Text(_) | Kind::Secret) => Some(value.extract::<String>(py).map_err(wrong)?),
        };
        let parameter = Parameter { name: for_ever(self.name.clone()), kind, default: default.map(for_ever) };
        if parameter.default.is_some() {
            // Checked here, since otherwise each process would be refused when it starts.
            Arguments::parse::<&str>(&[parameter], &[])
                .map_err(|why| PyValueError::new_err(format!("the default does not fit: {why}")))?;
        }
        Ok(parameter)
    }
}

/// Makes a text live as long as the process. An interface needs such texts, and a class is declared only once.
fn for_ever(text: String) -> &'static str {
    Box::leak(text.into_boxed_str())
}
