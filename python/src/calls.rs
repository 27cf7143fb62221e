//! Calls of procedures of other processes. Calls are sent after a calculation, and the answers are available in a later calculation.

use crate::exports::type_form;
use crate::message::MessageType;
use crate::piece::Arrived;
use crate::quantity::span;
use comms::logic::object::{ObjectError, Signature};
use controllers::sdk::{CallInterface, CallOrder, RawCalls};
use pyo3::exceptions::{PyException, PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pyo3::create_exception!(dca, CallError, PyException, "A call that has no result, and why.");

/// The declaration, with the fields of `_controller.py`.
#[derive(FromPyObject)]
pub(crate) struct DeclaredCalls {
    name: String,
    pub(crate) attribute: String,
    argument: Option<Py<MessageType>>,
    result: Option<Py<MessageType>>,
    is_optional: bool,
    doc: String,
}

/// The calls of one name that a class makes.
#[derive(Debug)]
pub(crate) struct CallsOf {
    pub(crate) attribute: String,
    argument: Option<Arc<Py<MessageType>>>,
    result: Option<Arc<Py<MessageType>>>,
}

impl DeclaredCalls {
    /// Returns the calls and their interface; `for_ever` makes its texts live as long as the process.
    pub(crate) fn calls(self, for_ever: fn(String) -> &'static str) -> (CallsOf, CallInterface) {
        let (argument, result) = (self.argument.map(Arc::new), self.result.map(Arc::new));
        let signature = Signature { argument: type_form(argument.as_deref()), result: type_form(result.as_deref()) };
        let (name, doc, required) = (for_ever(self.name), for_ever(self.doc), !self.is_optional);
        (CallsOf { attribute: self.attribute, argument, result }, CallInterface { name, signature, doc, required })
    }
}

impl CallsOf {
    /// Returns the message types of the argument and the result.
    pub(crate) fn messages(&self) -> impl Iterator<Item = &Arc<Py<MessageType>>> {
        self.argument.iter().chain(&self.result)
    }
}

/// The calls of one name by one instance.
#[derive(Debug)]
pub(crate) struct CallState {
    argument: Option<Arc<Py<MessageType>>>,
    result: Option<Arc<Py<MessageType>>>,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    raw: RawCalls,
    /// The number of activations that have begun. A call of an earlier activation has no answer, regardless of its number.
    activation: u64,
    /// The answer of each call that the controller still holds.
    answers: BTreeMap<u64, Option<Result<Vec<u8>, ObjectError>>>,
}

impl CallState {
    pub(crate) fn new(of: &CallsOf) -> Arc<Self> {
        Arc::new(Self { argument: of.argument.clone(), result: of.result.clone(), held: Mutex::default() })
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins an activation.
    pub(crate) fn begin(&self, is_connected: bool) {
        let mut held = self.held();
        *held = Held { activation: held.activation + 1, ..Held::default() };
        if is_connected {
            held.raw.connect();
        }
    }

    pub(crate) fn take(&self) -> Vec<CallOrder> {
        self.held().raw.take()
    }

    /// Takes the answer to a call. The answer to a cancelled call is dropped.
    pub(crate) fn deliver(&self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        let mut held = self.held();
        held.raw.deliver(number, result);
        while let Some((number, result)) = held.raw.answer() {
            if let Some(answer) = held.answers.get_mut(&number) {
                *answer = Some(result);
            }
        }
    }
}

/// Calls of one procedure of another process, which the spec connects.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Calls(pub(crate) Arc<CallState>);

#[pymethods]
impl Calls {
    /// Makes a call, which is sent after this calculation. If the spec connects several processes, `to` is the path
    /// of one.
    #[pyo3(signature = (argument = None, *, within, to = None))]
    fn call(
        &self,
        argument: Option<Bound<'_, PyAny>>,
        within: &Bound<'_, PyAny>,
        to: Option<String>,
    ) -> PyResult<Call> {
        let bytes = match (&self.0.argument, argument) {
            (Some(message), Some(value)) => message.get().bytes(&value)?,
            (None, None) => Vec::new(),
            (Some(_), None) => return Err(PyTypeError::new_err("the argument of the call is missing")),
            (None, Some(_)) => return Err(PyTypeError::new_err("it is called with nothing")),
        };
        let within = span(within)?;
        let mut held = self.0.held();
        let number = held.raw.call(to, Ok(bytes), within);
        let mut answer = None;
        while let Some((other, result)) = held.raw.answer() {
            if other == number {
                answer = Some(result);
            }
        }
        held.answers.insert(number, answer);
        Ok(Call { number, activation: held.activation, of: Arc::clone(&self.0) })
    }

    /// Whether the spec connects this call to a process.
    #[getter]
    fn is_connected(&self) -> bool {
        self.0.held().raw.is_connected()
    }

    /// The number of calls without an answer.
    #[getter]
    fn pending(&self) -> usize {
        self.0.held().raw.pending()
    }
}

/// A call whose result is expected.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Call {
    number: u64,
    activation: u64,
    of: Arc<CallState>,
}

impl Call {
    /// Returns the shared state of the calls, if this call belongs to the present activation.
    fn held(&self) -> Option<MutexGuard<'_, Held>> {
        Some(self.of.held()).filter(|held| held.activation == self.activation)
    }
}

#[pymethods]
impl Call {
    /// Whether the answer has arrived.
    #[getter]
    fn done(&self) -> bool {
        self.held().is_some_and(|held| held.answers.get(&self.number).is_some_and(Option::is_some))
    }

    /// Returns the result; raises `dca.CallError` if there is none.
    fn result<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let answer = self.held().and_then(|held| held.answers.get(&self.number).cloned().flatten());
        let answer = answer.ok_or_else(|| PyRuntimeError::new_err("the call has no answer yet: see `done`"))?;
        let bytes = answer.map_err(|error| CallError::new_err(error.to_string()))?;
        let Some(message) = self.of.result.as_deref() else { return Ok(py.None().into_bound(py)) };
        let message = message.get();
        match message.look(&bytes) {
            Some(look) if look.is_finite || message.allows_nan => message.value(py, &Arrived::new(bytes)),
            Some(_) => Err(CallError::new_err("a number of the answer is not finite")),
            None => Err(CallError::new_err(format!("the answer is not a `{}`", message.name))),
        }
    }

    /// Stops waiting for the answer. If the other end has not begun the call, it never will.
    fn cancel(&self) {
        if let Some(mut held) = self.held() {
            held.raw.cancel(self.number);
        }
    }
}

/// When the controller drops a call, its answer is dropped as well. The call itself continues.
impl Drop for Call {
    fn drop(&mut self) {
        if let Some(mut held) = self.held() {
            held.answers.remove(&self.number);
        }
    }
}
