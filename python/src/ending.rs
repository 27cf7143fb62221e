//! The argument and the results of a calculation.

use controllers::sdk::{Progress, TAG_MAX};
use pyo3::prelude::*;

/// The moment of one calculation.
#[pyclass(frozen, module = "dca")]
pub(crate) struct Tick {
    /// The time on this host's clock, in seconds.
    #[pyo3(get)]
    pub(crate) now: f64,
    /// The seconds since the previous calculation of this activation. At the first calculation it is one period.
    #[pyo3(get)]
    pub(crate) elapsed: f64,
}

#[pymethods]
impl Tick {
    #[new]
    #[pyo3(signature = (now, elapsed = 0.0))]
    fn new(now: f64, elapsed: f64) -> Self {
        Self { now, elapsed }
    }

    fn __repr__(&self) -> String {
        format!("Tick(now={}, elapsed={})", self.now, self.elapsed)
    }
}

/// The normal end of an activation.
#[pyclass(frozen, module = "dca")]
pub(crate) struct Done {
    /// The encoded value for the next process; for an outcome, without its tag.
    pub(crate) bytes: Vec<u8>,
    /// The tag of the outcome; none if the class has no outcomes.
    #[pyo3(get)]
    pub(crate) tag: Option<String>,
}

impl Done {
    /// Returns the end of the activation. The bytes of an outcome are the length of its tag in one byte, the tag, and the
    /// value.
    pub(crate) fn progress(&self) -> Progress {
        let Some(tag) = &self.tag else { return Progress::Done(self.bytes.clone()) };
        match u8::try_from(tag.len()) {
            Ok(length) if (1..=TAG_MAX).contains(&tag.len()) => {
                Progress::Done([&[length], tag.as_bytes(), &self.bytes].concat())
            }
            Ok(_) | Err(_) => Progress::Aborted(format!("`{tag}` cannot be the tag of an outcome")),
        }
    }
}

#[pymethods]
impl Done {
    #[new]
    #[pyo3(signature = (bytes, tag = None))]
    fn new(bytes: Vec<u8>, tag: Option<String>) -> Self {
        Self { bytes, tag }
    }

    /// Returns the encoded value for the next process.
    #[getter]
    fn value(&self) -> &[u8] {
        &self.bytes
    }
}

/// The failed end of an activation.
#[pyclass(frozen, module = "dca")]
pub(crate) struct Abort {
    /// Why, for a person.
    #[pyo3(get)]
    pub(crate) reason: String,
}

#[pymethods]
impl Abort {
    #[new]
    fn new(reason: String) -> Self {
        Self { reason }
    }
}
