//! Inputs: values arrive as bytes on the control loop, and become Python values when the controller reads them.

use crate::message::MessageType;
use crate::piece::Arrived;
use crate::quantity::{seconds, span, time};
use comms::logic::time::Time;
use controllers::sdk::{Arrivals, EVERY_MAX};
use pyo3::prelude::*;
use pyo3::types::PyList;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The state of an input, shared between the control loop and the Python object.
#[derive(Debug)]
pub(crate) struct InputState {
    message: Arc<Py<MessageType>>,
    /// Whether it keeps every value since the last calculation, not only the newest one.
    keeps_all: bool,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    arrivals: Arrivals,
    /// The newest value, or all values in order.
    values: VecDeque<Arc<Arrived>>,
    /// The newest value in its Python form, once it was read.
    read: Option<Py<PyAny>>,
}

impl InputState {
    pub(crate) fn new(message: Arc<Py<MessageType>>, keeps_all: bool) -> Arc<Self> {
        Arc::new(Self { message, keeps_all, held: Mutex::default() })
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a value. This does not need the interpreter.
    pub(crate) fn deliver(&self, bytes: Vec<u8>, arrived: Time) -> Result<(), Refused> {
        let message = self.message.get();
        let Some(look) = message.look(&bytes) else { return Err(Refused::Malformed) };
        let mut held = self.held();
        if !look.is_finite && !message.allows_nan {
            held.arrivals.refuse();
            return Err(Refused::NotFinite);
        }
        held.arrivals.accept(look.stamp.and_then(time), arrived);
        held.read = None;
        let room = if self.keeps_all { EVERY_MAX } else { 1 };
        while held.values.len() >= room {
            held.values.pop_front();
            if self.keeps_all {
                held.arrivals.lose(1);
            }
        }
        held.values.push_back(Arrived::new(bytes));
        Ok(())
    }

    pub(crate) fn lose(&self, count: u64) {
        self.held().arrivals.lose(count);
    }

    pub(crate) fn mark_seen(&self) {
        let mut held = self.held();
        held.arrivals.mark_seen();
        if self.keeps_all {
            held.values.clear();
        }
    }

    pub(crate) fn clear(&self) {
        *self.held() = Held::default();
    }

    pub(crate) fn trouble(&self) -> Option<String> {
        self.held().arrivals.trouble()
    }

    fn arrivals(&self) -> Arrivals {
        self.held().arrivals
    }

    /// Returns the newest value. It is converted only once. The interpreter runs no other code while the state is
    /// locked.
    fn newest(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        let bytes = {
            let held = self.held();
            if let Some(read) = &held.read {
                return Ok(Some(read.clone_ref(py)));
            }
            held.values.back().map(Arc::clone)
        };
        let Some(bytes) = bytes else { return Ok(None) };
        let value = self.message.get().value(py, &bytes)?.unbind();
        let mut held = self.held();
        if held.values.back().is_some_and(|newest| Arc::ptr_eq(newest, &bytes)) {
            held.read = Some(value.clone_ref(py));
        }
        Ok(Some(value))
    }
}

/// Why a value was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refused {
    /// The bytes do not have the type of the input.
    Malformed,
    /// A number in the value is infinite or NaN.
    NotFinite,
}

/// An input of a controller. It holds the newest value that has arrived.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Input(pub(crate) Arc<InputState>);

#[pymethods]
impl Input {
    /// Returns the newest value of any age; `None` before the first one.
    fn latest(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        self.0.newest(py)
    }

    /// Returns the newest value if it arrived since the last calculation, otherwise `None`.
    fn fresh(&self, py: Python<'_>) -> PyResult<Option<Py<PyAny>>> {
        if self.0.arrivals().is_fresh() { self.0.newest(py) } else { Ok(None) }
    }

    /// Returns the newest value if it is at most `age_max` old at `now`, otherwise `None`.
    fn fresh_within(&self, py: Python<'_>, now: f64, age_max: &Bound<'_, PyAny>) -> PyResult<Option<Py<PyAny>>> {
        if self.stale(now, age_max)? { Ok(None) } else { self.0.newest(py) }
    }

    /// Returns whether no value is at most `age_max` old at `now`.
    fn stale(&self, now: f64, age_max: &Bound<'_, PyAny>) -> PyResult<bool> {
        let (now, age_max) = (time(now).unwrap_or(Time::ZERO), span(age_max)?);
        Ok(!self.0.arrivals().is_fresh_within(now, age_max))
    }

    /// Returns the age of the newest value at `now`, in seconds; `None` before the first one.
    fn age(&self, now: f64) -> Option<f64> {
        self.0.arrivals().age(time(now)?).map(|age| age.as_secs_f64())
    }

    /// The time when the newest value was measured, or when it arrived if it has no time of measurement; seconds on
    /// this host's clock.
    #[getter]
    fn measured(&self) -> Option<f64> {
        self.0.arrivals().measured().map(seconds)
    }

    /// The time when the newest value arrived, in seconds on this host's clock.
    #[getter]
    fn arrived(&self) -> Option<f64> {
        self.0.arrivals().arrived().map(seconds)
    }

    /// The number of values that have arrived in this activation.
    #[getter]
    fn received(&self) -> u64 {
        self.0.arrivals().received()
    }

    /// The number of values that were sent to this input in this activation but did not arrive.
    #[getter]
    fn lost(&self) -> u64 {
        self.0.arrivals().lost()
    }

    /// The number of values that were refused in this activation because a number in them was not finite.
    #[getter]
    fn refused(&self) -> u64 {
        self.0.arrivals().refused()
    }
}

/// An input that keeps every value since the last calculation.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct EveryInput(pub(crate) Arc<InputState>);

#[pymethods]
impl EveryInput {
    /// Iterates over the values since the last calculation, the oldest first.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let waiting: Vec<Arc<Arrived>> = self.0.held().values.iter().map(Arc::clone).collect();
        let message = self.0.message.get();
        let values = waiting.iter().map(|bytes| message.value(py, bytes)).collect::<PyResult<Vec<_>>>()?;
        Ok(PyList::new(py, values)?.try_iter()?.into_any())
    }

    fn __len__(&self) -> usize {
        self.0.held().values.len()
    }

    /// The number of values that have arrived in this activation.
    #[getter]
    fn received(&self) -> u64 {
        self.0.arrivals().received()
    }

    /// The number of values that were sent to this input in this activation but did not arrive.
    #[getter]
    fn lost(&self) -> u64 {
        self.0.arrivals().lost()
    }

    /// The number of values that were refused in this activation because a number in them was not finite.
    #[getter]
    fn refused(&self) -> u64 {
        self.0.arrivals().refused()
    }
}
