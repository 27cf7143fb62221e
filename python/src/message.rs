//! A message type: its name, its fields as a spec spells them, and its form.

use crate::encoded::Encoded;
use crate::form::{Form, Look};
use crate::piece::Arrived;
use crate::standard::Standard;
use comms::logic::layout::Reader;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::sync::Arc;

/// The type of values that are sent: `@dca.message` makes it from a dataclass.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct MessageType {
    /// The name of the type in interfaces.
    #[pyo3(get)]
    pub(crate) name: String,
    /// The fields, as a spec spells them.
    #[pyo3(get)]
    pub(crate) fields: String,
    /// The message types of list elements: their names and fields.
    #[pyo3(get)]
    pub(crate) inner: Vec<(String, String)>,
    form: Form,
    /// The place of the field `stamp`.
    stamp: Option<usize>,
    pub(crate) allows_nan: bool,
}

/// The description, with the fields of `_message.py`.
#[derive(FromPyObject)]
struct Described {
    name: String,
    fields: String,
    stamp: Option<usize>,
    allow_nan: bool,
    inner: Vec<(String, String)>,
}

#[pymethods]
impl MessageType {
    #[new]
    fn new(described: Described, form: &Bound<'_, PyAny>) -> PyResult<Self> {
        let Described { name, fields, stamp, allow_nan: allows_nan, inner } = described;
        Ok(Self { name, fields, inner, form: Form::of(form, 0)?, stamp, allows_nan })
    }

    /// Returns the type of a standard ROS 2 message. `classes` are the Python classes of its structs.
    #[staticmethod]
    fn of_ros(py: Python<'_>, name: String, classes: Vec<Py<PyAny>>, allow_nan: bool) -> PyResult<Self> {
        let form = Form::Standard(Arc::new(Standard::new(py, &name, classes)?));
        Ok(Self { name, fields: String::new(), inner: Vec::new(), form, stamp: None, allows_nan: allow_nan })
    }

    /// Whether the type is a standard ROS 2 message.
    #[getter]
    fn is_standard(&self) -> bool {
        matches!(self.form, Form::Standard(_))
    }

    /// Returns the CDR of a value, as ROS 2 sends it. Numbers that are not finite are accepted; only ports refuse
    /// them.
    fn encode_cdr<'py>(&self, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(value.py(), &self.standard()?.write(value, true)?))
    }

    /// Returns the value in the CDR that ROS 2 has sent.
    fn decode_cdr<'py>(&self, py: Python<'py>, bytes: &[u8]) -> PyResult<Bound<'py, PyAny>> {
        let standard = self.standard()?;
        // Checks all bytes before any value is made; checks of single values could not refuse some of them.
        if standard.is_finite(bytes).is_none() {
            return Err(self.wrong());
        }
        let whole = Arrived::new(bytes.to_vec());
        standard.read(py, &whole, &whole)
    }

    /// Returns the bytes of a value.
    pub(crate) fn encode<'py>(&self, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(value.py(), &self.bytes(value)?))
    }

    /// Returns the value of bytes.
    pub(crate) fn decode<'py>(&self, py: Python<'py>, bytes: &[u8]) -> PyResult<Bound<'py, PyAny>> {
        // Checks all bytes before any value is made; checks of single values could not refuse some of them.
        if self.look(bytes).is_none() {
            return Err(self.wrong());
        }
        self.value(py, &Arrived::new(bytes.to_vec()))
    }
}

impl MessageType {
    /// Returns the standard message of this type.
    pub(crate) fn standard(&self) -> PyResult<Arc<Standard>> {
        let Form::Standard(standard) = &self.form else {
            return Err(PyTypeError::new_err(format!("`{}` is not a message of ROS 2", self.name)));
        };
        Ok(Arc::clone(standard))
    }

    fn wrong(&self) -> PyErr {
        PyValueError::new_err(format!("the bytes are not of the message type `{}`", self.name))
    }

    /// Returns the bytes of a value.
    pub(crate) fn bytes(&self, value: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
        self.encoded(value).map(Encoded::whole)
    }

    /// Returns a value in its encoded form, ready to be sent.
    pub(crate) fn encoded(&self, value: &Bound<'_, PyAny>) -> PyResult<Encoded> {
        let mut encoded = Encoded::new(self.allows_nan);
        self.form.write(value, &mut encoded)?;
        Ok(encoded)
    }

    /// Checks the bytes of a value; none if they do not have this type.
    pub(crate) fn look(&self, bytes: &[u8]) -> Option<Look> {
        self.form.look(bytes, self.stamp)
    }

    /// Returns the value of bytes that were checked.
    pub(crate) fn value<'py>(&self, py: Python<'py>, bytes: &Arc<Arrived>) -> PyResult<Bound<'py, PyAny>> {
        self.form.read(py, &mut Reader::new(bytes), bytes)
    }
}
