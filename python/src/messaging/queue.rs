//! A queue of a class: receives messages, and gives them out by priority.

use super::Station;
use super::lock::LockStation;
use crate::message::MessageType;
use crate::piece::Arrived;
use comms::logic::messaging::header::DATA_SIZE_MAX;
use comms::logic::messaging::queue::{MessageQueue, QueueSettings};
use comms::logic::time::Time;
use controllers::sdk::messaging::{Full, QueueMessage, QueueStatus, Receipt, Rejected};
use controllers::sdk::{Activity, Exports, RawReply};
use pyo3::prelude::*;
use pyo3::types::PyList;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Returns the exports of a queue: the procedure that takes messages, and its state for people.
pub(super) fn exports(name: &'static str, status: Option<&'static str>, doc: &'static str) -> Exports<Held> {
    let mut exports = Exports::default();
    exports.procedure(name, doc, |held: &mut Held, message: QueueMessage| Ok(held.receive(message)));
    if let Some(status) = status {
        exports.state(status, "The messages that wait.", Held::status);
    }
    exports
}

/// The messages of a queue.
#[derive(Debug)]
pub(super) struct Held {
    queue: MessageQueue,
    message: Arc<Py<MessageType>>,
    lock: Option<Arc<LockStation>>,
    now: Time,
}

impl Held {
    pub(super) fn new(message: &Arc<Py<MessageType>>, capacity: NonZeroUsize, full: Full) -> Self {
        let type_name = message.get().name.clone();
        let settings = QueueSettings { type_name, capacity, full, data_size_max: DATA_SIZE_MAX };
        Self { queue: MessageQueue::new(settings), message: Arc::clone(message), lock: None, now: Time::ZERO }
    }

    /// Accepts a message, or rejects it.
    pub(super) fn receive(&mut self, message: QueueMessage) -> Receipt {
        if let Some(Err(refusal)) = self.lock.as_ref().map(|lock| lock.admit(message.fence)) {
            return self.queue.turn_away(Rejected::Fenced(refusal));
        }
        let own = self.message.get();
        if message.type_name == own.name {
            let problem = match own.look(&message.data) {
                Some(look) if look.is_finite || own.allows_nan => None,
                Some(_) => Some("with a number that is not finite"),
                None => Some("of other fields"),
            };
            if let Some(problem) = problem {
                let (expected, found) = (own.name.clone(), format!("{} {problem}", own.name));
                return self.queue.turn_away(Rejected::WrongType { expected, found });
            }
        }
        self.queue.receive(self.now, message)
    }

    /// Takes the first message. A message whose grant has ended in the meantime is dropped.
    fn take(&mut self) -> Option<QueueMessage> {
        if let Some(lock) = &self.lock {
            self.queue.retain(|message| lock.admit(message.fence).is_ok());
        }
        self.queue.take()
    }

    pub(super) fn look_at(&mut self, now: Time) {
        self.now = now;
    }

    fn status(&self) -> QueueStatus {
        let settings = self.queue.settings();
        QueueStatus {
            type_name: settings.type_name.clone(),
            fields: self.message.get().fields.clone(),
            capacity: u64::try_from(settings.capacity.get()).unwrap_or(u64::MAX),
            full: settings.full,
            lock: String::new(),
            counters: self.queue.counters(),
            last_sender: self.queue.last_sender().to_owned(),
        }
    }
}

/// A queue of an instance.
#[derive(Debug)]
pub(crate) struct QueueStation {
    held: Mutex<(Held, Exports<Held>)>,
}

impl QueueStation {
    pub(super) fn new(
        message: &Arc<Py<MessageType>>,
        capacity: NonZeroUsize,
        full: Full,
        lock: Option<Arc<LockStation>>,
        exports: Exports<Held>,
    ) -> Arc<Self> {
        let held = Held { lock, ..Held::new(message, capacity, full) };
        Arc::new(Self { held: Mutex::new((held, exports)) })
    }

    fn held(&self) -> MutexGuard<'_, (Held, Exports<Held>)> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Station for QueueStation {
    fn begin(&self, _: bool) {}

    fn work(&self, now: Time) {
        self.held().0.look_at(now);
    }

    fn serve(&self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        let (held, exports) = &mut *self.held();
        exports.serve(held, name, argument, activity, reply);
    }
}

/// A source of messages: a queue, or a subscription.
pub(super) trait Source: std::fmt::Debug + Send + Sync {
    fn with(&self, run: &mut dyn FnMut(&mut Held));
}

impl Source for QueueStation {
    fn with(&self, run: &mut dyn FnMut(&mut Held)) {
        run(&mut self.held().0);
    }
}

/// A queue, as seen by a class.
#[pyclass(frozen, module = "dca", name = "Queue")]
#[derive(Debug)]
pub(crate) struct QueueOf {
    source: Arc<dyn Source>,
}

/// A message that was taken from a queue.
#[pyclass(frozen, get_all, module = "dca")]
#[derive(Debug)]
pub(crate) struct Taken {
    data: Py<PyAny>,
    category: String,
    sender: String,
    priority: u8,
    marker: u64,
    fence: Option<u64>,
}

impl QueueOf {
    pub(super) fn of(source: Arc<QueueStation>) -> Self {
        Self { source }
    }
}

#[pymethods]
impl QueueOf {
    /// Takes the message of the highest priority, the oldest among several; `None` if the queue is empty.
    fn take(&self, py: Python<'_>) -> PyResult<Option<Taken>> {
        take(py, &*self.source)
    }

    /// Takes all waiting messages.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        all(py, &*self.source)
    }

    /// How many messages wait.
    fn __len__(&self) -> usize {
        waiting(&*self.source)
    }
}

pub(super) fn take(py: Python<'_>, source: &dyn Source) -> PyResult<Option<Taken>> {
    let (mut message, mut of) = (None, None);
    source.with(&mut |held| (message, of) = (held.take(), Some(Arc::clone(&held.message))));
    let (Some(QueueMessage { header, fence, data, .. }), Some(of)) = (message, of) else { return Ok(None) };
    let data = of.get().value(py, &Arrived::new(data))?.unbind();
    let (category, sender) = (header.category, header.sender);
    Ok(Some(Taken { data, category, sender, priority: header.priority, marker: header.marker, fence }))
}

pub(super) fn all<'py>(py: Python<'py>, source: &dyn Source) -> PyResult<Bound<'py, PyAny>> {
    let mut taken = Vec::new();
    while let Some(one) = take(py, source)? {
        taken.push(Py::new(py, one)?);
    }
    Ok(PyList::new(py, taken)?.try_iter()?.into_any())
}

pub(super) fn waiting(source: &dyn Source) -> usize {
    let mut waiting = 0;
    source.with(&mut |held| waiting = held.queue.counters().depth);
    usize::try_from(waiting).unwrap_or(usize::MAX)
}
