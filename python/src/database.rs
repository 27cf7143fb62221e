//! The robot's database. Requests are sent after a calculation, and answered before a later one.

use crate::quantity::span;
use crate::stored::{EntryOf, value, version};
use comms::logic::database::DatabaseAnswer;
use comms::logic::time::Time;
use controllers::sdk::{
    Database, DatabaseError, DatabaseOrder, Entry, Expected, Transaction, TxnId, Unknown, WatchEvent,
};
use pyo3::exceptions::{PyException, PyRuntimeError};
use pyo3::prelude::*;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pyo3::create_exception!(dca, DatabaseFailure, PyException, "A request to the database that has no result, and why.");
pyo3::create_exception!(
    dca,
    DatabaseUnknown,
    DatabaseFailure,
    "The result is unknown: the write may have been committed."
);

/// The answer to a request.
#[derive(Clone, Debug)]
enum Answer {
    Value(Option<Entry>),
    Committed(TxnId),
    Failed(DatabaseError),
}

/// The database of one instance.
#[derive(Debug, Default)]
pub(crate) struct DatabaseState {
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    database: Database,
    /// The number of activations that have begun. A request of an earlier activation has no answer.
    activation: u64,
    /// The answer of each request that the controller still holds.
    answers: BTreeMap<u64, Option<Answer>>,
    /// The events of each watch.
    events: BTreeMap<u64, VecDeque<WatchEvent>>,
}

impl Held {
    /// Assigns the answers and events that have arrived to their requests and watches.
    fn sort(&mut self) {
        while let Some((number, result)) = self.database.value() {
            self.answer(number, result.map_or_else(Answer::Failed, Answer::Value));
        }
        while let Some((number, result)) = self.database.committed() {
            self.answer(number, result.map_or_else(Answer::Failed, Answer::Committed));
        }
    }

    fn answer(&mut self, number: u64, answer: Answer) {
        if let Some(waiting) = self.answers.get_mut(&number) {
            *waiting = Some(answer);
        }
    }
}

impl DatabaseState {
    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins an activation.
    pub(crate) fn renew(&self) {
        let mut held = self.held();
        *held = Held { activation: held.activation + 1, ..Held::default() };
    }

    /// Begins a calculation.
    pub(crate) fn begin(&self, now: Time) {
        let mut held = self.held();
        held.database.begin(now);
        held.sort();
    }

    pub(crate) fn take(&self) -> Vec<DatabaseOrder> {
        self.held().database.take()
    }

    pub(crate) fn deliver(&self, number: u64, answer: Result<DatabaseAnswer, Unknown>) {
        let mut held = self.held();
        held.database.deliver(number, answer);
        held.sort();
    }
}

/// The database of the robot.
#[pyclass(frozen, module = "dca", name = "Database")]
#[derive(Debug)]
pub(crate) struct DatabaseOf(pub(crate) Arc<DatabaseState>);

#[pymethods]
impl DatabaseOf {
    /// Asks for the value of a key.
    #[pyo3(signature = (key, *, within))]
    fn get(&self, key: String, within: &Bound<'_, PyAny>) -> PyResult<Request> {
        let within = span(within)?;
        Ok(self.request(|database| database.get(key, within)))
    }

    /// Writes one key. With `expected`, only if the key is in this state: `dca.ABSENT`, `dca.EXISTS`, or the version of an entry.
    #[pyo3(signature = (key, value, *, within, expected = None))]
    fn put(
        &self,
        key: String,
        value: &Bound<'_, PyAny>,
        within: &Bound<'_, PyAny>,
        expected: Option<String>,
    ) -> PyResult<Request> {
        let (value, within) = (crate::stored::value(value, 0)?, span(within)?);
        let expected = expected.map(|word| expectation(&word)).transpose()?;
        Ok(self.request(|database| database.put(key, value, expected, within)))
    }

    /// Changes several keys, all or none. `writes` has new values by key, `None` to delete; `requires` has expected states by key.
    #[pyo3(signature = (reason, writes, *, within, requires = None))]
    fn transact(
        &self,
        reason: String,
        writes: BTreeMap<String, Bound<'_, PyAny>>,
        within: &Bound<'_, PyAny>,
        requires: Option<BTreeMap<String, String>>,
    ) -> PyResult<Request> {
        let (mut transaction, within) = (Transaction::new(reason), span(within)?);
        for (key, word) in requires.unwrap_or_default() {
            transaction = transaction.require(key, expectation(&word)?);
        }
        for (key, given) in writes {
            transaction =
                if given.is_none() { transaction.delete(key) } else { transaction.put(key, value(&given, 0)?) };
        }
        Ok(self.request(|database| database.transact(transaction, within)))
    }

    /// Watches a key, or the keys below a prefix that ends with `/`, until the activation ends.
    fn watch(&self, prefix: String) -> Watch {
        let mut held = self.0.held();
        let number = held.database.watch(prefix);
        held.events.insert(number, VecDeque::new());
        Watch { number, activation: held.activation, of: Arc::clone(&self.0) }
    }

    /// The number of requests without an answer.
    #[getter]
    fn pending(&self) -> usize {
        self.0.held().database.pending()
    }
}

impl DatabaseOf {
    fn request(&self, ask: impl FnOnce(&mut Database) -> u64) -> Request {
        let mut held = self.0.held();
        let number = ask(&mut held.database);
        held.answers.insert(number, None);
        held.sort();
        Request { number, activation: held.activation, of: Arc::clone(&self.0) }
    }
}

/// Parses the expected state of a key.
pub(crate) fn expectation(word: &str) -> PyResult<Expected> {
    Ok(match word {
        "absent" => Expected::Absent,
        "exists" => Expected::Exists,
        other => Expected::Version(version(other)?),
    })
}

/// A request to the database.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Request {
    number: u64,
    activation: u64,
    of: Arc<DatabaseState>,
}

impl Request {
    fn answer(&self) -> Option<Answer> {
        let held = self.of.held();
        (held.activation == self.activation).then(|| held.answers.get(&self.number).cloned().flatten()).flatten()
    }
}

#[pymethods]
impl Request {
    /// Whether the answer has arrived.
    #[getter]
    fn done(&self) -> bool {
        self.answer().is_some()
    }

    /// Returns the entry that was read, or the version that was committed. Raises `dca.DatabaseFailure` if nothing was done, and
    /// `dca.DatabaseUnknown` if it is unknown whether the request was carried out.
    fn result(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        match self.answer() {
            None => Err(PyRuntimeError::new_err("the request has no answer yet: see `done`")),
            Some(Answer::Value(None)) => Ok(py.None()),
            Some(Answer::Value(Some(entry))) => Ok(EntryOf::new(py, &entry)?.into_any()),
            Some(Answer::Committed(version)) => Ok(version.to_string().into_pyobject(py)?.into_any().unbind()),
            Some(Answer::Failed(error @ DatabaseError::Unknown(_))) => Err(DatabaseUnknown::new_err(error.to_string())),
            Some(Answer::Failed(error @ DatabaseError::Refused(_))) => Err(DatabaseFailure::new_err(error.to_string())),
        }
    }
}

impl Drop for Request {
    fn drop(&mut self) {
        let mut held = self.of.held();
        if held.activation == self.activation {
            held.answers.remove(&self.number);
        }
    }
}

/// A watch of keys.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Watch {
    number: u64,
    activation: u64,
    of: Arc<DatabaseState>,
}

/// An event of a watch: its kind (`begin`, `present`, `complete` or `changed`), the entries, and the author and the reason of the change.
#[pyclass(frozen, get_all, module = "dca")]
#[derive(Debug)]
pub(crate) struct WatchChange {
    kind: &'static str,
    entries: Vec<Py<EntryOf>>,
    by: String,
    reason: String,
}

#[pymethods]
impl Watch {
    /// Iterates over the events since the last iteration, in order. Raises `dca.DatabaseFailure` if the watch has failed.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let mut events = Vec::new();
        for event in self.take() {
            events.push(Py::new(py, change(py, event)?)?);
        }
        events.into_pyobject(py)?.try_iter().map(Bound::into_any)
    }

    /// Ends the watch.
    fn stop(&self) {
        let mut held = self.of.held();
        if held.activation == self.activation {
            held.database.unwatch(self.number);
            held.events.remove(&self.number);
        }
    }
}

impl Watch {
    /// Takes the events of this watch, and leaves the events of other watches. For each taken
    /// event, tells the node that there is room for another event.
    fn take(&self) -> VecDeque<WatchEvent> {
        let mut held = self.of.held();
        if held.activation != self.activation {
            return VecDeque::new();
        }
        while let Some((number, event)) = held.database.event() {
            if let Some(events) = held.events.get_mut(&number) {
                events.push_back(event);
            }
        }
        held.events.get_mut(&self.number).map(std::mem::take).unwrap_or_default()
    }
}

pub(crate) fn change(py: Python<'_>, event: WatchEvent) -> PyResult<WatchChange> {
    let entries = |all: &[Entry]| all.iter().map(|entry| EntryOf::new(py, entry)).collect::<PyResult<Vec<_>>>();
    let plain = |kind, entries| WatchChange { kind, entries, by: String::new(), reason: String::new() };
    Ok(match event {
        WatchEvent::Begin => plain("begin", Vec::new()),
        WatchEvent::Present(present) => plain("present", entries(&present)?),
        WatchEvent::Complete => plain("complete", Vec::new()),
        WatchEvent::Changed(change) => {
            WatchChange { kind: "changed", entries: entries(&change.entries)?, by: change.by, reason: change.reason }
        }
        WatchEvent::Refused(why) => return Err(DatabaseFailure::new_err(why.to_string())),
    })
}
