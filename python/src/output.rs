//! Outputs: a value is encoded when the controller sends it, and leaves after the calculation.

use crate::encoded::Encoded;
use crate::message::MessageType;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The value of an output until the end of a calculation.
#[derive(Debug)]
pub(crate) struct OutputState {
    message: Arc<Py<MessageType>>,
    pending: Mutex<Option<Encoded>>,
}

impl OutputState {
    pub(crate) fn new(message: Arc<Py<MessageType>>) -> Arc<Self> {
        Arc::new(Self { message, pending: Mutex::default() })
    }

    fn pending(&self) -> MutexGuard<'_, Option<Encoded>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the waiting value.
    pub(crate) fn take(&self) -> Option<Encoded> {
        self.pending().take()
    }
}

/// An output of a controller.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Output(pub(crate) Arc<OutputState>);

#[pymethods]
impl Output {
    /// Sends a value after this calculation. If several are sent in one calculation, only the last one leaves.
    fn send(&self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let encoded = self.0.message.get().encoded(value)?;
        *self.0.pending() = Some(encoded);
        Ok(())
    }

    /// Whether a value waits to be sent.
    #[getter]
    fn pending(&self) -> bool {
        self.0.pending().is_some()
    }
}
