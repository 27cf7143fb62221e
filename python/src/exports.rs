//! The exports of a class: procedures that other processes call, and states that they read, between two calculations.

use crate::failure::told;
use crate::forked;
use crate::message::MessageType;
use crate::piece::Arrived;
use comms::logic::object::{Access, ExportKind, ObjectError, Signature, TypeForm};
use controllers::sdk::{Activity, ExportInterface, RawReply};
use pyo3::exceptions::{PyException, PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::sync::{Arc, Mutex, PoisonError};

pyo3::create_exception!(dca, Refused, PyException, "A procedure that is not carried out, and why, for its caller.");

/// An export of a class.
#[derive(Debug)]
pub(crate) struct Export {
    pub(crate) interface: ExportInterface,
    /// The method.
    attribute: String,
    argument: Option<Arc<Py<MessageType>>>,
    result: Option<Arc<Py<MessageType>>>,
    /// Whether the method gets a [`Reply`] and may answer later.
    is_later: bool,
}

/// The declaration, with the fields of `_controller.py`.
#[derive(FromPyObject)]
pub(crate) struct DeclaredExport {
    name: String,
    attribute: String,
    is_state: bool,
    argument: Option<Py<MessageType>>,
    result: Option<Py<MessageType>>,
    is_later: bool,
    is_answered_idle: bool,
    access: String,
    doc: String,
}

impl DeclaredExport {
    /// Returns the export; `for_ever` makes its texts live as long as the process.
    pub(crate) fn export(self, for_ever: fn(String) -> &'static str) -> Export {
        let (argument, result) = (self.argument.map(Arc::new), self.result.map(Arc::new));
        let interface = ExportInterface {
            name: for_ever(self.name),
            kind: if self.is_state { ExportKind::State } else { ExportKind::Procedure },
            signature: Signature { argument: type_form(argument.as_deref()), result: type_form(result.as_deref()) },
            doc: for_ever(self.doc),
            is_answered_idle: self.is_answered_idle,
            access: match self.access.as_str() {
                "look" => Access::Look,
                "deploy" => Access::Deploy,
                _ => Access::Operate,
            },
        };
        Export { interface, attribute: self.attribute, argument, result, is_later: self.is_later }
    }
}

/// Returns the description of a message type; an empty description without a type.
pub(crate) fn type_form(message: Option<&Py<MessageType>>) -> TypeForm {
    message.map_or_else(TypeForm::default, |message| TypeForm::new(&message.get().name, &message.get().fields))
}

impl Export {
    /// Returns the message types of the argument and the result.
    pub(crate) fn messages(&self) -> impl Iterator<Item = &Arc<Py<MessageType>>> {
        self.argument.iter().chain(&self.result)
    }

    /// Carries out a call.
    pub(crate) fn serve(&self, object: &Py<PyAny>, bytes: &[u8], activity: Activity, reply: RawReply) {
        let name = self.interface.name;
        if activity != Activity::Running && !self.interface.is_answered_idle {
            let does = if activity == Activity::Idle { "does not run" } else { "is stopping" };
            return reply.answer(Err(refused(format!("`{name}` cannot answer now: its process {does}"))));
        }
        if let Some(argument) = &self.argument {
            let (message, read) = (argument.get(), argument.get().look(bytes));
            let wrong = match read {
                None => Some(format!("the argument is not a `{}`", message.name)),
                Some(look) if !look.is_finite && !message.allows_nan => {
                    Some("a number of the argument is not finite".to_owned())
                }
                Some(_) => None,
            };
            if let Some(wrong) = wrong {
                return reply.answer(Err(refused(wrong)));
            }
        }
        let mut reply = Some(reply);
        let result = forked::call(|py| self.call(py, object, bytes, &mut reply).map_err(|error| cause(py, error)));
        // The method has kept the reply, or has returned a result.
        match (reply, result) {
            (Some(reply), Ok(bytes)) => reply.answer(Ok(bytes)),
            (Some(reply), Err(error)) => reply.answer(Err(error)),
            (None, Ok(_) | Err(_)) => {}
        }
    }

    fn call(
        &self,
        py: Python<'_>,
        object: &Py<PyAny>,
        bytes: &[u8],
        reply: &mut Option<RawReply>,
    ) -> PyResult<Vec<u8>> {
        let mut arguments = Vec::new();
        if let Some(argument) = &self.argument {
            arguments.push(argument.get().value(py, &Arrived::new(bytes.to_vec()))?);
        }
        if self.is_later {
            let waiting = Reply { raw: Mutex::new(reply.take()), result: self.result.clone() };
            arguments.push(Bound::new(py, waiting)?.into_any());
        }
        let returned = object.bind(py).call_method1(self.attribute.as_str(), PyTuple::new(py, arguments)?)?;
        if self.is_later { Ok(Vec::new()) } else { encoded(self.result.as_deref(), &returned) }
    }
}

fn encoded(message: Option<&Py<MessageType>>, value: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
    match message {
        Some(message) => message.get().bytes(value),
        None if value.is_none() => Ok(Vec::new()),
        None => Err(PyTypeError::new_err("a procedure without a result has returned one")),
    }
}

/// Returns why a call has no result. `dca.Refused` is only an answer; any other exception is also written to the log.
fn cause(py: Python<'_>, error: PyErr) -> ObjectError {
    let is_answer = error.is_instance_of::<Refused>(py);
    refused(if is_answer { error.value(py).to_string() } else { told(py, error) })
}

fn refused(reason: String) -> ObjectError {
    ObjectError::Refused { reason }
}

/// The way of the answer to one call. A method may keep it, and answer in a later calculation.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Reply {
    raw: Mutex<Option<RawReply>>,
    result: Option<Arc<Py<MessageType>>>,
}

#[pymethods]
impl Reply {
    /// Sends the answer. A value of another type raises an error here, and the call still waits.
    #[pyo3(signature = (value = None))]
    fn send(&self, py: Python<'_>, value: Option<Bound<'_, PyAny>>) -> PyResult<()> {
        let value = value.unwrap_or_else(|| py.None().into_bound(py));
        let bytes = encoded(self.result.as_deref(), &value)?;
        self.take()?.answer(Ok(bytes));
        Ok(())
    }

    /// Refuses the call, with a reason in one line.
    fn refuse(&self, reason: String) -> PyResult<()> {
        self.take()?.answer(Err(refused(reason)));
        Ok(())
    }

    /// Whether the caller still waits.
    #[getter]
    fn is_wanted(&self) -> bool {
        let raw = self.raw.lock().unwrap_or_else(PoisonError::into_inner);
        raw.as_ref().is_some_and(RawReply::is_wanted)
    }
}

impl Reply {
    fn take(&self) -> PyResult<RawReply> {
        let raw = self.raw.lock().unwrap_or_else(PoisonError::into_inner).take();
        raw.ok_or_else(|| PyRuntimeError::new_err("the call was answered before"))
    }
}
