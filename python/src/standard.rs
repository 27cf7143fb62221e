//! The standard messages of ROS 2: their definitions for Python, and their values as CDR.
//!
//! A received list of numbers is a read-only `memoryview`. Lists of bytes are viewed in place. Other numbers are copied once, because their
//! place in the bytes of a value is rarely a multiple of their size. When a buffer of such numbers is sent, it is copied once.

mod read;
mod write;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyString;
use ros::logic::cdr;
use ros::logic::definition::{Count, Element, Primitive};
use ros::logic::library;
use ros::logic::name::spec_package;
use ros::logic::schema::Schema;

/// A standard message with its Python classes.
#[derive(Debug)]
pub(crate) struct Standard {
    schema: Schema,
    /// Beside the structs of the schema.
    classes: Vec<Class>,
}

/// A Python class, and the names of its fields.
#[derive(Debug)]
struct Class {
    class: Py<PyAny>,
    fields: Vec<Py<PyString>>,
}

impl Standard {
    /// Returns the message with the name `spec`; `classes` are the Python classes of its structs.
    pub(crate) fn new(py: Python<'_>, spec: &str, classes: Vec<Py<PyAny>>) -> PyResult<Self> {
        let schema = schema(spec).ok_or_else(|| PyTypeError::new_err(format!("`{spec}` is not a message of ROS 2")))?;
        if classes.len() != schema.structs().len() {
            return Err(PyTypeError::new_err(format!("`{spec}` has {} structs", schema.structs().len())));
        }
        let names = schema.structs().iter().map(|one| &one.fields);
        let names = names.map(|fields| fields.iter().map(|field| PyString::intern(py, &field.name).unbind()).collect());
        let classes = std::iter::zip(classes, names).map(|(class, fields)| Class { class, fields }).collect();
        Ok(Self { schema, classes })
    }

    /// Returns whether every number in a value is finite; none if the bytes are not such a value.
    pub(crate) fn is_finite(&self, bytes: &[u8]) -> Option<bool> {
        cdr::is_finite(&self.schema, bytes).ok()
    }
}

/// Returns the schema of the message with a name from a spec.
fn schema(spec: &str) -> Option<Schema> {
    library::schema(&library::by_spec(spec)?).ok()
}

/// The definition of a message, from which Python makes a class.
#[pyclass(frozen, get_all, module = "dca")]
#[derive(Debug)]
pub(crate) struct RosDefinition {
    /// The name in ROS 2: `sensor_msgs/msg/LaserScan`.
    name: String,
    /// The name in a spec: `ros.sensor.LaserScan`.
    spec: String,
    fields: Vec<Py<RosField>>,
    constants: Vec<(String, Py<PyAny>)>,
    /// The messages in its fields, by their names in a spec.
    inner: Vec<String>,
    /// Whether its numbers may be infinite or NaN.
    allow_nan: bool,
}

/// A field of a definition.
#[pyclass(frozen, get_all, module = "dca")]
#[derive(Debug)]
pub(crate) struct RosField {
    name: String,
    /// The type of the value or of an element: `float32`, `string`, `ros.geometry.Point`.
    of: String,
    /// The number of elements of an array, 0 for a list of any length; none for a single value.
    count: Option<usize>,
    default: Option<String>,
}

/// Returns the definition of a standard message.
#[pyfunction]
pub(crate) fn ros_definition(py: Python<'_>, spec: &str) -> PyResult<Option<RosDefinition>> {
    let Some(schema) = schema(spec) else { return Ok(None) };
    let root = schema.root();
    let mut fields = Vec::new();
    for field in &root.fields {
        let of = match &field.element {
            Element::Primitive(of) => of.as_str().to_owned(),
            Element::Text { .. } => "string".to_owned(),
            Element::Message(index) => schema.at(*index).name.spec(),
        };
        let count = match field.count {
            Count::One => None,
            Count::Array(size) => Some(size),
            Count::Any | Count::Max(_) => Some(0),
        };
        fields.push(Py::new(py, RosField { name: field.name.clone(), of, count, default: field.default.clone() })?);
    }
    let constants = root.constants.iter().map(|one| Ok((one.name.clone(), constant(py, &one.of, &one.value)?)));
    Ok(Some(RosDefinition {
        name: root.name.to_string(),
        spec: root.name.spec(),
        fields,
        constants: constants.collect::<PyResult<_>>()?,
        inner: schema.structs().iter().skip(1).map(|one| one.name.spec()).collect(),
        allow_nan: controllers::sdk::allows_nan(root.name.package()),
    }))
}

/// Returns the names of the standard messages in a package. The package has its name from a spec: `sensor`.
#[pyfunction]
pub(crate) fn ros_names(package: &str) -> Vec<String> {
    let all = library::messages().chain(library::parts());
    all.filter(|name| spec_package(name.package()) == package).map(|name| name.name().to_owned()).collect()
}

fn constant<R>(py: Python<'_>, of: &Element<R>, text: &str) -> PyResult<Py<PyAny>> {
    let wrong = || PyTypeError::new_err(format!("`{text}` is not a constant"));
    Ok(match of {
        Element::Primitive(Primitive::Bool) => (text == "true").into_pyobject(py)?.to_owned().into_any().unbind(),
        Element::Primitive(Primitive::F32 | Primitive::F64) => {
            text.parse::<f64>().map_err(|_no_number| wrong())?.into_pyobject(py)?.into_any().unbind()
        }
        Element::Primitive(_) => {
            text.parse::<i64>().map_err(|_no_number| wrong())?.into_pyobject(py)?.into_any().unbind()
        }
        Element::Text { .. } | Element::Message(_) => PyString::new(py, text).into_any().unbind(),
    })
}

/// Returns the letter of Python's buffer format for numbers of this type.
fn letter(of: Primitive) -> &'static str {
    match of {
        Primitive::Bool => "?",
        Primitive::Byte | Primitive::U8 => "B",
        Primitive::I8 => "b",
        Primitive::I16 => "h",
        Primitive::U16 => "H",
        Primitive::I32 => "i",
        Primitive::U32 => "I",
        Primitive::I64 => "q",
        Primitive::U64 => "Q",
        Primitive::F32 => "f",
        Primitive::F64 => "d",
    }
}
