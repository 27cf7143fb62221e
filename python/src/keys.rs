//! Ports that a spec connects to keys of the database.

use crate::database::{WatchChange, change};
use crate::quantity::span;
use crate::stored::value;
use comms::logic::database::Stored;
use controllers::sdk::{Direction, Expected, KeyAnswer, KeyNews, KeyPut, KeyResult, Message, PortInterface};
use pyo3::prelude::*;
use pyo3::types::PyList;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The most values that wait at a port. For a further one, the oldest is dropped.
const WAITING_MAX: usize = 8192;

/// The declaration, with the fields of `_messaging.py`.
#[derive(FromPyObject)]
pub(crate) struct DeclaredKeys {
    name: String,
    pub(crate) attribute: String,
    kind: String,
    is_optional: bool,
    doc: String,
}

/// A port of keys that a class declares.
#[derive(Debug)]
pub(crate) struct KeysOf {
    pub(crate) attribute: String,
    pub(crate) interface: PortInterface,
}

impl DeclaredKeys {
    /// Returns the port; `for_ever` makes its texts live as long as the process.
    pub(crate) fn keys(self, for_ever: fn(String) -> &'static str) -> KeysOf {
        let (direction, type_name) = match self.kind.as_str() {
            "news" => (Direction::In, KeyNews::TYPE),
            "answers" => (Direction::In, KeyAnswer::TYPE),
            _ => (Direction::Out, KeyPut::TYPE),
        };
        let wire = PortInterface::wire(for_ever(self.name), direction, type_name).documented(for_ever(self.doc));
        KeysOf { attribute: self.attribute, interface: PortInterface { required: !self.is_optional, ..wire } }
    }
}

/// The values that wait at a port of keys.
#[derive(Debug, Default)]
pub(crate) struct KeysState {
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    news: VecDeque<KeyNews>,
    answers: VecDeque<KeyAnswer>,
    puts: Vec<KeyPut>,
    /// How many puts there were.
    number: u64,
}

impl KeysState {
    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins an activation.
    pub(crate) fn begin(&self) {
        *self.held() = Held::default();
    }

    /// Takes a value for an input.
    pub(crate) fn deliver(&self, type_name: &str, bytes: &[u8]) {
        let mut held = self.held();
        if type_name == KeyNews::TYPE {
            held.news.extend(postcard::from_bytes::<KeyNews>(bytes).ok());
        } else {
            held.answers.extend(postcard::from_bytes::<KeyAnswer>(bytes).ok());
        }
        let (news, answers) = (held.news.len(), held.answers.len());
        held.news.drain(..news.saturating_sub(WAITING_MAX));
        held.answers.drain(..answers.saturating_sub(WAITING_MAX));
    }

    /// Takes the encoded values that an output writes.
    pub(crate) fn take(&self) -> Vec<Vec<u8>> {
        let puts = std::mem::take(&mut self.held().puts);
        puts.iter().filter_map(|put| postcard::to_stdvec(put).ok()).collect()
    }

    /// Returns the Python object for the port.
    pub(crate) fn object(self: &Arc<Self>, py: Python<'_>, type_name: &str) -> PyResult<Py<PyAny>> {
        let state = Arc::clone(self);
        Ok(match type_name {
            KeyNews::TYPE => Py::new(py, KeyNewsOf(state))?.into_any(),
            KeyAnswer::TYPE => Py::new(py, KeyAnswersOf(state))?.into_any(),
            _ => Py::new(py, KeyWriterOf(state))?.into_any(),
        })
    }
}

/// An input that receives the changes of the keys that it is connected to.
#[pyclass(frozen, module = "dca", name = "KeyNews")]
#[derive(Debug)]
pub(crate) struct KeyNewsOf(Arc<KeysState>);

#[pymethods]
impl KeyNewsOf {
    /// Iterates over the events since the last iteration, in order, like a watch. Raises `dca.DatabaseFailure` if the watch has
    /// failed.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let news = std::mem::take(&mut self.0.held().news);
        let events: Vec<Py<WatchChange>> =
            news.into_iter().map(|news| Py::new(py, change(py, news.event)?)).collect::<PyResult<_>>()?;
        Ok(PyList::new(py, events)?.try_iter()?.into_any())
    }
}

/// An input that receives whether the writes of an output were committed.
#[pyclass(frozen, module = "dca", name = "KeyAnswers")]
#[derive(Debug)]
pub(crate) struct KeyAnswersOf(Arc<KeysState>);

#[pymethods]
impl KeyAnswersOf {
    /// Iterates over the answers since the last iteration. Each answer has the number of the write,
    /// and `None` if the write was committed. Otherwise it has the reason why the write failed, or
    /// may have failed.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let answers = std::mem::take(&mut self.0.held().answers);
        let told = answers.into_iter().map(|KeyAnswer { number, result }| match result {
            KeyResult::Committed(_) => (number, None),
            KeyResult::Refused(why) => (number, Some(why.to_string())),
            KeyResult::Unknown(why) => (number, Some(why)),
        });
        Ok(PyList::new(py, told.collect::<Vec<_>>())?.try_iter()?.into_any())
    }
}

/// An output that writes values at the keys that it is connected to.
#[pyclass(frozen, module = "dca", name = "KeyWriter")]
#[derive(Debug)]
pub(crate) struct KeyWriterOf(Arc<KeysState>);

#[pymethods]
impl KeyWriterOf {
    /// Writes a value at a key after this calculation; `None` deletes the key. Returns the number of the write, which its answer
    /// repeats.
    #[pyo3(signature = (key, value, *, within, expected = None))]
    fn put(
        &self,
        key: String,
        value: &Bound<'_, PyAny>,
        within: &Bound<'_, PyAny>,
        expected: Option<String>,
    ) -> PyResult<u64> {
        let value = if value.is_none() { None } else { Some(Stored::from(&self::value(value, 0)?)) };
        let expected: Option<Expected> = expected.map(|word| crate::database::expectation(&word)).transpose()?;
        let within = span(within)?;
        let mut held = self.0.held();
        held.number += 1;
        let number = held.number;
        held.puts.push(KeyPut { number, key, value, expected, within });
        Ok(number)
    }
}
