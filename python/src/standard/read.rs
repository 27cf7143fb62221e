//! Values of Python from CDR.

use super::{Standard, letter};
use crate::piece::{Arrived, Piece};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList, PyMemoryView, PyString, PyTuple};
use ros::logic::cdr::{CdrError, Reader};
use ros::logic::definition::{Count, Element, Field, Primitive};
use std::sync::Arc;

/// The bytes of a value, and the position of the reader.
struct Source<'a, 'py> {
    py: Python<'py>,
    reader: Reader<'a>,
    /// The bytes that contain the value.
    whole: &'a Arc<Arrived>,
}

impl Standard {
    /// Returns the value in `bytes`, which are a part of `whole`.
    pub(crate) fn read<'py>(&self, py: Python<'py>, bytes: &[u8], whole: &Arc<Arrived>) -> PyResult<Bound<'py, PyAny>> {
        let mut source = Source { py, reader: Reader::new(bytes).map_err(wrong)?, whole };
        let value = self.record(0, &mut source)?;
        source.reader.end().map_err(wrong)?;
        Ok(value)
    }

    fn record<'py>(&self, index: usize, source: &mut Source<'_, 'py>) -> PyResult<Bound<'py, PyAny>> {
        let fields = &self.schema.at(index).fields;
        if fields.is_empty() {
            // An empty struct has one byte without a meaning.
            source.reader.number::<1>().map_err(wrong)?;
        }
        let values = fields.iter().map(|field| self.field(field, source)).collect::<PyResult<Vec<_>>>()?;
        self.classes[index].class.bind(source.py).call1(PyTuple::new(source.py, values)?)
    }

    fn field<'py>(&self, field: &Field<usize>, source: &mut Source<'_, 'py>) -> PyResult<Bound<'py, PyAny>> {
        let size_min = self.schema.size_min(&field.element);
        let count = match field.count {
            Count::One => return self.element(&field.element, source),
            Count::Array(size) => size,
            Count::Any | Count::Max(_) => source.reader.count(size_min).map_err(wrong)?,
        };
        source.reader.fits(count, size_min).map_err(wrong)?;
        if let Element::Primitive(of) = &field.element
            && *of != Primitive::Bool
        {
            return numbers(*of, count, source);
        }
        let elements = (0..count).map(|_| self.element(&field.element, source)).collect::<PyResult<Vec<_>>>()?;
        Ok(PyList::new(source.py, elements)?.into_any())
    }

    fn element<'py>(&self, of: &Element<usize>, source: &mut Source<'_, 'py>) -> PyResult<Bound<'py, PyAny>> {
        match of {
            Element::Primitive(of) => number(*of, source),
            Element::Text { .. } => Ok(PyString::new(source.py, source.reader.text().map_err(wrong)?).into_any()),
            Element::Message(index) => self.record(*index, source),
        }
    }
}

/// Returns numbers as a view.
fn numbers<'py>(of: Primitive, count: usize, source: &mut Source<'_, 'py>) -> PyResult<Bound<'py, PyAny>> {
    let (py, letter) = (source.py, letter(of));
    let bytes = source.reader.numbers(count, of.size()).map_err(wrong)?;
    if count == 0 {
        // Python cannot cast an empty view to numbers of another size.
        let none = py.import("array")?.call_method1("array", (letter,))?;
        return PyMemoryView::from(&none)?.call_method0("toreadonly");
    }
    if of.size() > 1 {
        return PyMemoryView::from(PyBytes::new(py, bytes).as_any())?.call_method1("cast", (letter,));
    }
    let start = bytes.as_ptr().addr().saturating_sub(source.whole.as_ptr().addr());
    let view = Piece::view(py, source.whole, start..start + bytes.len())?;
    if letter == "B" { Ok(view.into_any()) } else { view.call_method1("cast", (letter,)) }
}

/// Returns a number, or a truth value.
fn number<'py>(of: Primitive, source: &mut Source<'_, 'py>) -> PyResult<Bound<'py, PyAny>> {
    let (py, reader) = (source.py, &mut source.reader);
    Ok(match of {
        Primitive::Bool => reader.truth().map_err(wrong)?.into_pyobject(py)?.to_owned().into_any(),
        Primitive::Byte | Primitive::U8 => u8::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::I8 => i8::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::I16 => i16::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::U16 => u16::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::I32 => i32::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::U32 => u32::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::I64 => i64::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::U64 => u64::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
        Primitive::F32 => f64::from(f32::from_le_bytes(take(reader)?)).into_pyobject(py)?.into_any(),
        Primitive::F64 => f64::from_le_bytes(take(reader)?).into_pyobject(py)?.into_any(),
    })
}

fn take<const N: usize>(reader: &mut Reader<'_>) -> PyResult<[u8; N]> {
    reader.number().map_err(wrong)
}

fn wrong(error: CdrError) -> PyErr {
    PyValueError::new_err(error.to_string())
}
