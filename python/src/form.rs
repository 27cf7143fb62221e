//! The form of a message type: how its bytes become Python values, and Python values become bytes.
//!
//! Python describes a form with nested tuples. The first item is the kind: `("number", "Length")`, `("list", ELEMENT,
//! 3, False)`, `("record", CLASS, [("x", FORM), ...])`. The bytes are the same as of a Rust type with the same fields. An
//! optional value has the bytes of a list with at most one element.

use crate::encoded::Encoded;
use crate::message::MessageType;
use crate::piece::{Arrived, Piece};
use crate::standard::Standard;
use comms::logic::layout::Reader;
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes, PyList, PyString, PyTuple};
use std::sync::Arc;

/// The deepest nesting of a type.
const DEPTH_MAX: usize = 64;
/// Whole numbers up to this absolute value have exact floats.
const WHOLE_MAX: u64 = 1 << 53;

/// A type, as a tree.
#[derive(Debug)]
pub(crate) enum Form {
    /// A float in SI units.
    Number,
    /// A whole number, which is sent as a float.
    Whole,
    /// A whole number of a device, which must not be negative.
    Natural,
    /// A time of a device: nanoseconds in the bytes, seconds in Python.
    Stamp,
    Truth,
    Text,
    /// Bytes: a read-only `memoryview` in Python; any buffer can be sent.
    Bytes,
    /// An enumeration: words, each with its Python value.
    Words(Vec<(String, Py<PyAny>)>),
    Optional(Box<Self>),
    List {
        of: Box<Self>,
        count: Option<usize>,
        is_tuple: bool,
    },
    Record {
        class: Py<PyAny>,
        fields: Vec<(Py<PyString>, Self)>,
    },
    /// A standard ROS 2 message. Its bytes are its CDR, with their length.
    Standard(Arc<Standard>),
}

/// The result of checking the bytes of a value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// Whether all numbers are finite.
    pub(crate) is_finite: bool,
    /// The field `stamp` of the outermost record, in seconds.
    pub(crate) stamp: Option<f64>,
}

impl Form {
    /// Reads the description of a form.
    pub(crate) fn of(described: &Bound<'_, PyAny>, depth: usize) -> PyResult<Self> {
        if depth > DEPTH_MAX {
            return Err(PyTypeError::new_err(format!("a message type is nested deeper than {DEPTH_MAX} levels")));
        }
        let inner = |at| Self::of(&described.get_item(at)?, depth + 1).map(Box::new);
        let word: String = described.get_item(0)?.extract()?;
        Ok(match word.as_str() {
            "number" => Self::Number,
            "whole" => Self::Whole,
            "natural" => Self::Natural,
            "stamp" => Self::Stamp,
            "truth" => Self::Truth,
            "text" => Self::Text,
            "bytes" => Self::Bytes,
            "words" => Self::Words(described.get_item(1)?.extract()?),
            "optional" => Self::Optional(inner(1)?),
            "list" => {
                let (count, is_tuple) = (described.get_item(2)?.extract()?, described.get_item(3)?.extract()?);
                Self::List { of: inner(1)?, count, is_tuple }
            }
            "standard" => {
                let message = described.get_item(1)?.cast_into::<MessageType>()?;
                Self::Standard(message.get().standard()?)
            }
            "record" => {
                let mut fields = Vec::new();
                for field in described.get_item(2)?.try_iter()? {
                    let field = field?;
                    let name = field.get_item(0)?.cast_into::<PyString>()?.unbind();
                    fields.push((name, Self::of(&field.get_item(1)?, depth + 1)?));
                }
                Self::Record { class: described.get_item(1)?.unbind(), fields }
            }
            other => return Err(PyTypeError::new_err(format!("`{other}` is not a form of messages"))),
        })
    }

    /// Checks the bytes of a record without the interpreter; none if they do not have exactly this type.
    pub(crate) fn look(&self, bytes: &[u8], stamp: Option<usize>) -> Option<Look> {
        let (mut reader, mut look) = (Reader::new(bytes), Look { is_finite: true, stamp: None });
        let fields = if let Self::Record { fields, .. } = self {
            fields.as_slice()
        } else {
            self.skip(&mut reader, &mut look.is_finite)?;
            &[]
        };
        for (at, (_, form)) in fields.iter().enumerate() {
            let before = reader.rest();
            form.skip(&mut reader, &mut look.is_finite)?;
            if Some(at) == stamp {
                // The number of an optional stamp follows the byte that marks its presence.
                let taken = before.get(..before.len() - reader.rest().len()).unwrap_or_default();
                look.stamp = if matches!(form, Self::Stamp) {
                    Reader::new(taken).natural().map(from_nanos)
                } else {
                    taken.last_chunk().map(|number| f64::from_le_bytes(*number))
                };
            }
        }
        reader.rest().is_empty().then_some(look)
    }

    fn skip(&self, reader: &mut Reader<'_>, is_finite: &mut bool) -> Option<()> {
        match self {
            Self::Number => *is_finite &= reader.number()?.is_finite(),
            Self::Whole => {
                let number = reader.number()?;
                *is_finite &= number.is_finite();
                // If this fails, the other end has another type: whole numbers are within 2^53.
                if number.is_finite() && !is_whole(number) {
                    return None;
                }
            }
            Self::Natural | Self::Stamp => drop(reader.natural()?),
            Self::Truth => drop(reader.truth()?),
            Self::Text => drop(reader.text()?),
            Self::Bytes => drop(reader.piece()?),
            Self::Words(words) => {
                let text = reader.text()?;
                words.iter().find(|(word, _)| word == text)?;
            }
            Self::Optional(of) => {
                if reader.truth()? {
                    of.skip(reader, is_finite)?;
                }
            }
            Self::List { of, count, .. } => {
                for _ in 0..reader.count(*count)? {
                    of.skip(reader, is_finite)?;
                }
            }
            Self::Record { fields, .. } => {
                fields.iter().try_for_each(|(_, form)| form.skip(reader, is_finite))?;
            }
            Self::Standard(of) => *is_finite &= of.is_finite(reader.piece()?)?,
        }
        Some(())
    }

    /// Returns the value at the beginning of a reader of `whole`. Bytes in it are views of `whole`.
    pub(crate) fn read<'py>(
        &self,
        py: Python<'py>,
        reader: &mut Reader<'_>,
        whole: &Arc<Arrived>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let short = || PyValueError::new_err("the bytes are not of this message type");
        Ok(match self {
            Self::Number => reader.number().ok_or_else(short)?.into_pyobject(py)?.into_any(),
            Self::Whole => {
                let number = reader.number().filter(|number| is_whole(*number)).ok_or_else(short)?;
                #[expect(clippy::cast_possible_truncation, reason = "it is whole, and within 53 bits")]
                let whole = number as i64;
                whole.into_pyobject(py)?.into_any()
            }
            Self::Natural => reader.natural().ok_or_else(short)?.into_pyobject(py)?.into_any(),
            Self::Stamp => from_nanos(reader.natural().ok_or_else(short)?).into_pyobject(py)?.into_any(),
            Self::Truth => reader.truth().ok_or_else(short)?.into_pyobject(py)?.to_owned().into_any(),
            Self::Text => PyString::new(py, reader.text().ok_or_else(short)?).into_any(),
            Self::Bytes => {
                let length = reader.piece().ok_or_else(short)?.len();
                let end = whole.len().saturating_sub(reader.rest().len());
                Piece::view(py, whole, end.saturating_sub(length)..end)?.into_any()
            }
            Self::Words(words) => {
                let text = reader.text().ok_or_else(short)?;
                let (_, value) = words.iter().find(|(word, _)| word == text).ok_or_else(short)?;
                value.bind(py).clone()
            }
            Self::Optional(of) => {
                if reader.truth().ok_or_else(short)? {
                    of.read(py, reader, whole)?
                } else {
                    py.None().into_bound(py)
                }
            }
            Self::List { of, count, is_tuple } => {
                let count = reader.count(*count).ok_or_else(short)?;
                let elements = (0..count).map(|_| of.read(py, reader, whole)).collect::<PyResult<Vec<_>>>()?;
                if *is_tuple { PyTuple::new(py, elements)?.into_any() } else { PyList::new(py, elements)?.into_any() }
            }
            Self::Record { class, fields } => {
                let values =
                    fields.iter().map(|(_, form)| form.read(py, reader, whole)).collect::<PyResult<Vec<_>>>()?;
                class.bind(py).call1(PyTuple::new(py, values)?)?
            }
            Self::Standard(of) => of.read(py, reader.piece().ok_or_else(short)?, whole)?,
        })
    }

    /// Writes a value.
    pub(crate) fn write(&self, value: &Bound<'_, PyAny>, encoded: &mut Encoded) -> PyResult<()> {
        match self {
            Self::Number => {
                let number: f64 = value.extract().map_err(|_no_number| expected("a number", value))?;
                if !encoded.allows_nan && !number.is_finite() {
                    return Err(PyValueError::new_err(format!("{} is not a finite number", value.repr()?)));
                }
                encoded.writer().number(number);
            }
            Self::Whole => {
                let too_large =
                    || PyValueError::new_err(format!("{value} is beyond 2^53, which a message cannot hold"));
                let whole: i64 = value.extract().map_err(|error: PyErr| {
                    let is_number = error.is_instance_of::<PyOverflowError>(value.py());
                    if is_number { too_large() } else { expected("a whole number", value) }
                })?;
                // This is checked before the conversion, which would round 2^53 + 1 to 2^53.
                if whole.unsigned_abs() > WHOLE_MAX {
                    return Err(too_large());
                }
                #[expect(clippy::cast_precision_loss, reason = "whole numbers up to 2^53 are exact")]
                let number = whole as f64;
                encoded.writer().number(number);
            }
            Self::Natural => {
                let number = value.extract().map_err(|_no_number| expected("a whole number from 0 on", value))?;
                encoded.writer().natural(number);
            }
            Self::Stamp => {
                let seconds: f64 = value.extract().map_err(|_no_number| expected("a number", value))?;
                let since = std::time::Duration::try_from_secs_f64(seconds);
                let since = since.map_err(|_no_time| expected("a time in seconds", value))?;
                encoded.writer().natural(u64::try_from(since.as_nanos()).unwrap_or(u64::MAX));
            }
            Self::Truth => encoded.writer().truth(value.extract().map_err(|_no_truth| expected("a bool", value))?),
            Self::Text => {
                let text = value.cast::<PyString>().map_err(|_no_text| expected("a str", value))?;
                encoded.writer().text(&text.to_cow()?);
            }
            Self::Bytes => write_bytes(value, encoded)?,
            Self::Words(words) => {
                let found = words.iter().find(|(_, one)| value.eq(one).unwrap_or(false));
                let (word, _) = found.ok_or_else(|| {
                    let words: Vec<&str> = words.iter().map(|(word, _)| word.as_str()).collect();
                    expected(&format!("one of `{}`", words.join("`, `")), value)
                })?;
                encoded.writer().text(word);
            }
            Self::Optional(of) => {
                encoded.writer().truth(!value.is_none());
                if !value.is_none() {
                    of.write(value, encoded)?;
                }
            }
            Self::List { of, count, .. } => write_list(of, *count, value, encoded)?,
            Self::Record { class, fields } => write_record(class, fields, value, encoded)?,
            Self::Standard(of) => encoded.own(of.write(value, encoded.allows_nan)?),
        }
        Ok(())
    }
}

fn from_nanos(nanos: u64) -> f64 {
    std::time::Duration::from_nanos(nanos).as_secs_f64()
}

fn is_whole(number: f64) -> bool {
    #[expect(clippy::cast_precision_loss, reason = "2^53 is exact")]
    let max = WHOLE_MAX as f64;
    number.abs() <= max && number.fract().abs().to_bits() == 0
}

/// Returns whether a value can be a list in a message. The letters of a text and the numbers of bytes are not meant as elements.
pub(crate) fn is_list(value: &Bound<'_, PyAny>) -> bool {
    !(value.is_instance_of::<PyString>() || value.is_instance_of::<PyBytes>() || value.is_instance_of::<PyByteArray>())
}

fn write_list(of: &Form, count: Option<usize>, value: &Bound<'_, PyAny>, encoded: &mut Encoded) -> PyResult<()> {
    if !is_list(value) {
        return Err(expected("a list", value));
    }
    let length = value.len().map_err(|_no_list| expected("a list", value))?;
    match count {
        Some(count) if count != length => {
            return Err(PyValueError::new_err(format!("expected {count} elements, got {length}")));
        }
        Some(_) => {}
        None => encoded.writer().length(length),
    }
    let mut written = 0;
    // An iterator may be endless, so at most one element beyond the length is read.
    for element in value.try_iter()?.take(length.saturating_add(1)) {
        of.write(&element?, encoded)?;
        written += 1;
    }
    if written != length {
        return Err(PyValueError::new_err("the list has changed while it was written"));
    }
    Ok(())
}

fn write_record(
    class: &Py<PyAny>,
    fields: &[(Py<PyString>, Form)],
    value: &Bound<'_, PyAny>,
    encoded: &mut Encoded,
) -> PyResult<()> {
    let (py, class) = (value.py(), class.bind(value.py()));
    if !value.is_instance(class)? {
        let name: String = class.getattr("__name__")?.extract()?;
        return Err(expected(&format!("a `{name}`"), value));
    }
    for (name, form) in fields {
        let name = name.bind(py);
        form.write(&value.getattr(name)?, encoded).map_err(|error| within(py, name, &error))?;
    }
    Ok(())
}

/// Writes the content of any buffer.
fn write_bytes(value: &Bound<'_, PyAny>, encoded: &mut Encoded) -> PyResult<()> {
    if value.extract::<i64>().is_ok() {
        // A whole number is refused here, with its own message.
        return Err(expected("bytes", value));
    }
    encoded.buffer(value).map_err(|_no_buffer| expected("bytes, or another buffer", value))
}

pub(crate) fn expected(what: &str, value: &Bound<'_, PyAny>) -> PyErr {
    let shown = value.repr().map(|text| text.to_string()).unwrap_or_default();
    let shown: String = shown.chars().take(80).collect();
    PyTypeError::new_err(format!("expected {what}, got {shown}"))
}

/// Adds the field in which a value is wrong to the error: `at.x: expected a number, got None`.
pub(crate) fn within(py: Python<'_>, field: &Bound<'_, PyString>, error: &PyErr) -> PyErr {
    let text = error.value(py).to_string();
    let text = match text.split_once(": ") {
        Some((path, rest)) if path.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '.') => {
            format!("{field}.{path}: {rest}")
        }
        _ => format!("{field}: {text}"),
    };
    if error.is_instance_of::<PyTypeError>(py) { PyTypeError::new_err(text) } else { PyValueError::new_err(text) }
}
