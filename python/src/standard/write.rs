//! CDR from values of Python.

use super::Standard;
use crate::form::{expected, is_list, within};
use pyo3::buffer::PyBuffer;
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyMemoryView, PyString};
use ros::logic::cdr::{CdrError, Writer, are_finite};
use ros::logic::definition::{Count, Element, Field, Primitive};

/// The bytes of a value so far.
struct Sink {
    writer: Writer,
    /// Whether numbers may be infinite or NaN.
    allows_nan: bool,
}

impl Standard {
    /// Returns the bytes of a value.
    pub(crate) fn write(&self, value: &Bound<'_, PyAny>, allows_nan: bool) -> PyResult<Vec<u8>> {
        let mut sink = Sink { writer: Writer::default(), allows_nan };
        self.write_record(0, value, &mut sink)?;
        Ok(sink.writer.finish())
    }

    fn write_record(&self, index: usize, value: &Bound<'_, PyAny>, sink: &mut Sink) -> PyResult<()> {
        let (py, class) = (value.py(), &self.classes[index]);
        if !value.is_instance(class.class.bind(py))? {
            return Err(expected(&format!("a `{}`", self.schema.at(index).name.spec()), value));
        }
        if class.fields.is_empty() {
            sink.writer.number([0]);
        }
        for (name, field) in std::iter::zip(&class.fields, &self.schema.at(index).fields) {
            let name = name.bind(py);
            self.write_field(field, &value.getattr(name)?, sink).map_err(|error| within(py, name, &error))?;
        }
        Ok(())
    }

    fn write_field(&self, field: &Field<usize>, value: &Bound<'_, PyAny>, sink: &mut Sink) -> PyResult<()> {
        if field.count == Count::One {
            return self.write_element(&field.element, value, sink);
        }
        if let Element::Primitive(of) = &field.element
            && let Some(view) = buffer(*of, value)
        {
            check_shape(*of, field.count, &view)?;
            return write_buffer(*of, field.count, &view, sink);
        }
        if !is_list(value) {
            return Err(expected("a list", value));
        }
        let length = value.len().map_err(|_no_list| expected("a list", value))?;
        write_count(field.count, length, &mut sink.writer)?;
        let mut written = 0;
        // An iterator may be endless, so at most one element beyond the length is read.
        for element in value.try_iter()?.take(length.saturating_add(1)) {
            self.write_element(&field.element, &element?, sink)?;
            written += 1;
        }
        if written != length {
            return Err(PyValueError::new_err("the list has changed while it was written"));
        }
        Ok(())
    }

    fn write_element(&self, of: &Element<usize>, value: &Bound<'_, PyAny>, sink: &mut Sink) -> PyResult<()> {
        match of {
            Element::Primitive(of) => write_number(*of, value, sink),
            Element::Text { max } => {
                let text = value.cast::<PyString>().map_err(|_no_text| expected("a str", value))?;
                let text = text.to_cow()?;
                if text.contains('\0') {
                    let shown = value.repr()?;
                    return Err(PyValueError::new_err(format!(
                        "{shown} has a zero byte in it, where ROS 2 ends a text"
                    )));
                }
                if let Some(max) = max.filter(|max| text.len() > *max) {
                    return Err(PyValueError::new_err(format!("expected at most {max} bytes, got {}", text.len())));
                }
                sink.writer.text(&text).map_err(wrong)
            }
            Element::Message(index) => self.write_record(*index, value, sink),
        }
    }
}

/// Writes the number of elements, unless the type fixes it.
fn write_count(of: Count, count: usize, writer: &mut Writer) -> PyResult<()> {
    match of {
        Count::Array(size) if size != count => {
            Err(PyValueError::new_err(format!("expected {size} elements, got {count}")))
        }
        Count::Max(max) if count > max => {
            Err(PyValueError::new_err(format!("expected at most {max} elements, got {count}")))
        }
        Count::Any | Count::Max(_) => writer.count(count).map_err(wrong),
        Count::Array(_) | Count::One => Ok(()),
    }
}

/// Returns a view of a value, if the value is a buffer whose numbers have the type and size of the field.
fn buffer<'py>(of: Primitive, value: &Bound<'py, PyAny>) -> Option<Bound<'py, PyMemoryView>> {
    let view = PyMemoryView::from(value).ok()?;
    let format: String = view.getattr("format").ok()?.extract().ok()?;
    let size: usize = view.getattr("itemsize").ok()?.extract().ok()?;
    let kinds = match of {
        Primitive::Bool => "?",
        Primitive::Byte | Primitive::U8 => "Bc",
        Primitive::I8 => "b",
        Primitive::I16 | Primitive::I32 | Primitive::I64 => "hilqn",
        Primitive::U16 | Primitive::U32 | Primitive::U64 => "HILQN",
        Primitive::F32 | Primitive::F64 => "fd",
    };
    let letter = format.strip_prefix(['<', '@', '=']).unwrap_or(&format);
    (letter.len() == 1 && kinds.contains(letter) && size == of.size()).then_some(view)
}

/// Refuses an array whose numbers would lose their places. A field with a fixed number of elements may be a matrix, such as a covariance.
/// A field of bytes has the bytes of any array, such as an image.
fn check_shape(of: Primitive, count: Count, view: &Bound<'_, PyMemoryView>) -> PyResult<()> {
    let dimensions: usize = view.getattr("ndim")?.extract()?;
    let is_fixed = matches!(count, Count::Array(_));
    if dimensions == 1 || dimensions > 1 && (is_fixed || matches!(of, Primitive::Byte | Primitive::U8)) {
        return Ok(());
    }
    let shape = view.getattr("shape")?;
    Err(PyTypeError::new_err(format!(
        "expected a list, got an array of the shape {shape}; write `.ravel()` for its numbers in a row"
    )))
}

/// Writes the numbers of a buffer, in the order of its elements.
fn write_buffer(of: Primitive, count: Count, view: &Bound<'_, PyMemoryView>, sink: &mut Sink) -> PyResult<()> {
    let py = view.py();
    let length = view.getattr("nbytes")?.extract::<usize>()? / of.size();
    write_count(count, length, &mut sink.writer)?;
    if length == 0 {
        return Ok(());
    }
    let bytes = if view.getattr("c_contiguous")?.extract()? {
        view.call_method1("cast", ("B",))?
    } else {
        view.call_method0("tobytes")?
    };
    let place = sink.writer.numbers(length, of.size());
    PyBuffer::<u8>::get(&bytes)?.copy_to_slice(py, place)?;
    if of == Primitive::Bool {
        // Truth values are only 0 and 1; all other bytes become 1.
        place.iter_mut().for_each(|byte| *byte = u8::from(*byte != 0));
    }
    if !sink.allows_nan && !are_finite(of, place) {
        return Err(PyValueError::new_err("a number in it is not finite"));
    }
    Ok(())
}

/// Writes a whole number of another size.
macro_rules! whole {
    ($sink:ident, $value:ident, $name:expr, $wide:ty as $of:ty) => {
        $sink.writer.number(narrow::<$wide, $of>($value, $value.extract(), $name)?.to_le_bytes())
    };
}

fn write_number(of: Primitive, value: &Bound<'_, PyAny>, sink: &mut Sink) -> PyResult<()> {
    let name = of.as_str();
    match of {
        Primitive::Bool => {
            let truth: bool = value.extract().map_err(|_no_truth| expected("a bool", value))?;
            sink.writer.number([u8::from(truth)]);
        }
        Primitive::Byte | Primitive::U8 => whole!(sink, value, name, u64 as u8),
        Primitive::U16 => whole!(sink, value, name, u64 as u16),
        Primitive::U32 => whole!(sink, value, name, u64 as u32),
        Primitive::U64 => whole!(sink, value, name, u64 as u64),
        Primitive::I8 => whole!(sink, value, name, i64 as i8),
        Primitive::I16 => whole!(sink, value, name, i64 as i16),
        Primitive::I32 => whole!(sink, value, name, i64 as i32),
        Primitive::I64 => whole!(sink, value, name, i64 as i64),
        Primitive::F32 => {
            let number = float(value, sink.allows_nan)?;
            #[expect(clippy::cast_possible_truncation, reason = "the next line refuses numbers that are too large")]
            let short = number as f32;
            if short.is_infinite() && number.is_finite() {
                return Err(PyValueError::new_err(format!("{} does not fit into {name}", value.repr()?)));
            }
            sink.writer.number(short.to_le_bytes());
        }
        Primitive::F64 => sink.writer.number(float(value, sink.allows_nan)?.to_le_bytes()),
    }
    Ok(())
}

fn float(value: &Bound<'_, PyAny>, allows_nan: bool) -> PyResult<f64> {
    let number: f64 = value.extract().map_err(|_no_number| expected("a number", value))?;
    if !allows_nan && !number.is_finite() {
        return Err(PyValueError::new_err(format!("{} is not a finite number", value.repr()?)));
    }
    Ok(number)
}

/// Converts a whole number that was read with 64 bits; `of` is the name of its type for people.
fn narrow<W, N: TryFrom<W>>(value: &Bound<'_, PyAny>, wide: PyResult<W>, of: &str) -> PyResult<N> {
    let beyond = || PyValueError::new_err(format!("{value} does not fit into {of}"));
    let wide = wide.map_err(|error| {
        if error.is_instance_of::<PyOverflowError>(value.py()) { beyond() } else { expected("a whole number", value) }
    })?;
    N::try_from(wide).map_err(|_large| beyond())
}

fn wrong(error: CdrError) -> PyErr {
    PyValueError::new_err(error.to_string())
}
