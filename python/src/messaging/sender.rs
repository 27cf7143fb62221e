//! The client of another process's queue.

use super::{Station, no_number};
use crate::message::MessageType;
use crate::quantity::span;
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use controllers::sdk::messaging::{EncodedMessage, QueueClient, QueueMessage, Receipt, SendEnd};
use controllers::sdk::{AnyCalls, CallOrder, Calls};
use pyo3::exceptions::{PyException, PyRuntimeError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pyo3::create_exception!(dca, SendError, PyException, "A message that is not in its queue, or may not be, and why.");

/// The client of a queue.
#[derive(Debug)]
pub(crate) struct SenderStation {
    path: String,
    message: Arc<Py<MessageType>>,
    held: Mutex<Held>,
}

#[derive(Debug)]
struct Held {
    client: QueueClient<()>,
    calls: Calls<QueueMessage, Receipt>,
    now: Time,
    activation: u64,
    /// The results of the messages that the class still holds; `Ok` if a message was accepted.
    ends: BTreeMap<u64, Option<Result<(), String>>>,
}

impl SenderStation {
    pub(super) fn new(message: &Arc<Py<MessageType>>, path: &str) -> PyResult<Arc<Self>> {
        let (client, calls) = (QueueClient::new(path).map_err(no_number)?, Calls::default());
        let held = Held { client, calls, now: Time::ZERO, activation: 0, ends: BTreeMap::new() };
        Ok(Arc::new(Self { path: path.to_owned(), message: Arc::clone(message), held: Mutex::new(held) }))
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Station for SenderStation {
    fn begin(&self, is_connected: bool) {
        let mut held = self.held();
        (held.calls, held.activation) = (Calls::default(), held.activation + 1);
        held.ends.clear();
        if is_connected {
            held.calls.connect();
        }
        if let Ok(client) = QueueClient::new(&self.path) {
            held.client = client;
        }
    }

    fn work(&self, now: Time) {
        let Held { client, calls, now: last, ends, .. } = &mut *self.held();
        *last = now;
        client.work(now, calls);
        while let Some((number, end)) = client.end_of() {
            if let Some(waiting) = ends.get_mut(&number) {
                *waiting = Some(told(end));
            }
        }
    }

    fn take(&self) -> Vec<CallOrder> {
        self.held().calls.take()
    }

    fn deliver(&self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        self.held().calls.deliver(number, result);
    }
}

/// Returns the result of a message; the error is the reason why it is not in its queue, or may not be.
fn told(end: SendEnd) -> Result<(), String> {
    match end {
        SendEnd::Accepted => Ok(()),
        SendEnd::Rejected(why) => Err(format!("the queue has rejected the message: {why}")),
        SendEnd::Unknown(why) => Err(format!("the queue cannot be reached: {why}")),
        SendEnd::Deadline => Err("the receipt did not come in time: the message may be in the queue".to_owned()),
        SendEnd::Gone => Err("the program of the queue is gone: the message may be in the queue".to_owned()),
    }
}

/// Another process's queue, as seen by its client.
#[pyclass(frozen, module = "dca", name = "Sender")]
#[derive(Debug)]
pub(crate) struct SenderOf(pub(crate) Arc<SenderStation>);

#[pymethods]
impl SenderOf {
    /// Sends a message after this calculation, and repeats it until its receipt comes. The queue takes it once.
    #[pyo3(signature = (value, *, within, category = String::new(), priority = 0, marker = 0, to = None, fence = None))]
    #[expect(clippy::too_many_arguments, reason = "all but the value are named at the call")]
    fn send(
        &self,
        value: &Bound<'_, PyAny>,
        within: &Bound<'_, PyAny>,
        category: String,
        priority: u8,
        marker: u64,
        to: Option<String>,
        fence: Option<u64>,
    ) -> PyResult<Sending> {
        let (message, within) = (self.0.message.get(), span(within)?);
        let (type_name, data, recipient) = (message.name.clone(), message.bytes(value)?, to.unwrap_or_default());
        let encoded = EncodedMessage { type_name, data, category, recipient, priority, marker, fence };
        let mut held = self.0.held();
        let now = held.now;
        let number = held.client.send_encoded(now, encoded, within).map_err(SendError::new_err)?;
        held.ends.insert(number, None);
        Ok(Sending { number, activation: held.activation, of: Arc::clone(&self.0) })
    }
}

/// A message that was sent.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Sending {
    number: u64,
    activation: u64,
    of: Arc<SenderStation>,
}

impl Sending {
    fn end(&self) -> Option<Result<(), String>> {
        let held = self.of.held();
        (held.activation == self.activation).then(|| held.ends.get(&self.number).cloned().flatten()).flatten()
    }
}

#[pymethods]
impl Sending {
    /// Whether the result of the message is known.
    #[getter]
    fn done(&self) -> bool {
        self.end().is_some()
    }

    /// Returns `None` if the queue has accepted the message. Raises `dca.SendError` if the queue has not accepted the
    /// message, or may not have accepted it.
    fn result(&self) -> PyResult<()> {
        let end = self.end().ok_or_else(|| PyRuntimeError::new_err("the receipt has not come yet: see `done`"))?;
        end.map_err(SendError::new_err)
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        let mut held = self.of.held();
        if held.activation == self.activation {
            held.ends.remove(&self.number);
        }
    }
}
