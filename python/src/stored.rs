//! Conversion between values of the database and Python values.

use comms::logic::database::Stored;
use controllers::sdk::{Entry, TxnId, Value};
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use std::collections::BTreeMap;

/// The deepest nesting of lists and tables that is converted; the limit of the database itself is smaller.
const DEPTH_MAX: usize = 64;

/// A value that this program cannot read, such as a sealed secret. It is written back unchanged.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Opaque {
    tag: u8,
    bytes: Vec<u8>,
}

/// A key and its value at the time when it was read.
#[pyclass(frozen, module = "dca", name = "Entry")]
#[derive(Debug)]
pub(crate) struct EntryOf {
    /// The key.
    #[pyo3(get)]
    key: String,
    /// The value; `None` if it was deleted.
    #[pyo3(get)]
    value: Py<PyAny>,
    /// The transaction that has written the value.
    #[pyo3(get)]
    version: String,
    /// Whether another value was written concurrently, and the conflict is not resolved.
    #[pyo3(get)]
    is_conflict: bool,
}

#[pymethods]
impl EntryOf {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("Entry({} = {})", self.key, self.value.bind(py).repr()?))
    }
}

impl EntryOf {
    pub(crate) fn new(py: Python<'_>, entry: &Entry) -> PyResult<Py<Self>> {
        let value = entry.value.as_ref().map(Stored::value);
        let value = value.map_or_else(|| Ok(py.None()), |value| shown(py, &value).map(Bound::unbind))?;
        let (key, version, is_conflict) = (entry.key.clone(), entry.version.to_string(), entry.is_conflict);
        Py::new(py, Self { key, value, version, is_conflict })
    }
}

/// Reads the name of a transaction from the text in an entry.
pub(crate) fn version(text: &str) -> PyResult<TxnId> {
    let parts = text.split_once(':');
    let read = parts.and_then(|(origin, seq)| {
        Some(TxnId { origin: u64::from_str_radix(origin, 16).ok()?, seq: seq.parse().ok()? })
    });
    read.ok_or_else(|| PyValueError::new_err(format!("`{text}` is not the version of an entry")))
}

fn shown<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Bool(truth) => PyBool::new(py, *truth).to_owned().into_any(),
        Value::Integer(number) => number.into_pyobject(py)?.into_any(),
        Value::Float(number) => PyFloat::new(py, *number).into_any(),
        Value::Text(text) => PyString::new(py, text).into_any(),
        Value::Bytes(bytes) => PyBytes::new(py, bytes).into_any(),
        Value::List(items) => {
            let items = items.iter().map(|item| shown(py, item)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_any()
        }
        Value::Table(fields) => {
            let table = PyDict::new(py);
            fields.iter().try_for_each(|(name, field)| table.set_item(name, shown(py, field)?))?;
            table.into_any()
        }
        Value::Opaque { tag, bytes } => Bound::new(py, Opaque { tag: *tag, bytes: bytes.clone() })?.into_any(),
    })
}

/// Returns the value of the database for a Python value.
pub(crate) fn value(given: &Bound<'_, PyAny>, depth: usize) -> PyResult<Value> {
    if depth > DEPTH_MAX {
        return Err(PyValueError::new_err("lists and dicts lie too deep in each other"));
    }
    if let Ok(truth) = given.cast::<PyBool>() {
        return Ok(Value::Bool(truth.is_true()));
    }
    if given.is_instance_of::<PyInt>() {
        let beyond = |_too_large| PyOverflowError::new_err("a whole number in the database has 64 bits");
        return given.extract().map(Value::Integer).map_err(beyond);
    }
    if let Ok(number) = given.cast::<PyFloat>() {
        return Ok(Value::Float(number.value()));
    }
    if let Ok(text) = given.cast::<PyString>() {
        return Ok(Value::Text(text.to_cow()?.into_owned()));
    }
    if let Ok(bytes) = given.cast::<PyBytes>() {
        return Ok(Value::Bytes(bytes.as_bytes().to_vec()));
    }
    if let Ok(table) = given.cast::<PyDict>() {
        let field =
            |(name, field): (Bound<'_, PyAny>, Bound<'_, PyAny>)| Ok((name.extract()?, value(&field, depth + 1)?));
        return table.iter().map(field).collect::<PyResult<BTreeMap<String, Value>>>().map(Value::Table);
    }
    if given.is_instance_of::<PyList>() || given.is_instance_of::<PyTuple>() {
        let items = given.try_iter()?.map(|item| value(&item?, depth + 1));
        return items.collect::<PyResult<Vec<Value>>>().map(Value::List);
    }
    if let Ok(opaque) = given.cast::<Opaque>() {
        let Opaque { tag, bytes } = opaque.get();
        return Ok(Value::Opaque { tag: *tag, bytes: bytes.clone() });
    }
    let kind = given.get_type().name()?;
    Err(PyTypeError::new_err(format!(
        "a `{kind}` cannot be in the database: a bool, int, float, str, bytes, list or dict can"
    )))
}
