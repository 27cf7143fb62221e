//! Values of types that are known only at run time.

use super::{CdrError, Reader, Writer};
use crate::logic::definition::{Count, Element, Field, Primitive};
use crate::logic::schema::{Schema, Struct};

/// A value of any type.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `bool`.
    Truth(bool),
    /// A whole number with a sign.
    Signed(i64),
    /// A whole number without a sign, such as a `byte`.
    Unsigned(u64),
    /// `float32`.
    Single(f32),
    /// `float64`.
    Double(f64),
    /// `string`.
    Text(String),
    /// A list of `uint8` or `byte`, which is often long.
    Bytes(Vec<u8>),
    /// Any other list.
    List(Vec<Self>),
    /// The values of the fields of a message, in their order.
    Record(Vec<Self>),
}

/// Returns the value in `bytes`.
///
/// # Errors
/// If the bytes are not a value of this type, or more bytes follow than padding.
pub fn read(schema: &Schema, bytes: &[u8]) -> Result<Value, CdrError> {
    let mut reader = Reader::new(bytes)?;
    let value = record(schema, schema.root(), &mut reader)?;
    reader.end()?;
    Ok(value)
}

/// Returns the bytes of a value, with their header.
///
/// # Errors
/// If the value is not of this type.
pub fn write(schema: &Schema, value: &Value) -> Result<Vec<u8>, CdrError> {
    let mut writer = Writer::default();
    write_record(schema, schema.root(), value, &mut writer)?;
    Ok(writer.finish())
}

fn record(schema: &Schema, of: &Struct, reader: &mut Reader<'_>) -> Result<Value, CdrError> {
    if of.fields.is_empty() {
        // The message has one byte, which has no meaning.
        reader.number::<1>()?;
    }
    let values = of.fields.iter().map(|one| field(schema, one, reader));
    Ok(Value::Record(values.collect::<Result<_, _>>()?))
}

fn field(schema: &Schema, of: &Field<usize>, reader: &mut Reader<'_>) -> Result<Value, CdrError> {
    let size_min = schema.size_min(&of.element);
    let count = match of.count {
        Count::One => return element(schema, &of.element, reader),
        Count::Array(size) => {
            reader.fits(size, size_min)?;
            size
        }
        Count::Any => reader.count(size_min)?,
        Count::Max(max) => Some(reader.count(size_min)?).filter(|count| *count <= max).ok_or(CdrError::Long(max))?,
    };
    if let Element::Primitive(Primitive::U8 | Primitive::Byte) = of.element {
        return Ok(Value::Bytes(reader.bytes(count)?.to_vec()));
    }
    let values = (0..count).map(|_| element(schema, &of.element, reader));
    Ok(Value::List(values.collect::<Result<_, _>>()?))
}

fn element(schema: &Schema, of: &Element<usize>, reader: &mut Reader<'_>) -> Result<Value, CdrError> {
    match of {
        Element::Primitive(of) => primitive(*of, reader),
        Element::Text { max } => {
            let text = reader.text()?;
            if max.is_some_and(|max| text.len() > max) {
                return Err(CdrError::Long(text.len()));
            }
            Ok(Value::Text(text.to_owned()))
        }
        Element::Message(index) => record(schema, schema.at(*index), reader),
    }
}

fn primitive(of: Primitive, reader: &mut Reader<'_>) -> Result<Value, CdrError> {
    Ok(match of {
        Primitive::Bool => Value::Truth(reader.truth()?),
        Primitive::Byte | Primitive::U8 => Value::Unsigned(u8::from_le_bytes(reader.number()?).into()),
        Primitive::I8 => Value::Signed(i8::from_le_bytes(reader.number()?).into()),
        Primitive::I16 => Value::Signed(i16::from_le_bytes(reader.number()?).into()),
        Primitive::U16 => Value::Unsigned(u16::from_le_bytes(reader.number()?).into()),
        Primitive::I32 => Value::Signed(i32::from_le_bytes(reader.number()?).into()),
        Primitive::U32 => Value::Unsigned(u32::from_le_bytes(reader.number()?).into()),
        Primitive::I64 => Value::Signed(i64::from_le_bytes(reader.number()?)),
        Primitive::U64 => Value::Unsigned(u64::from_le_bytes(reader.number()?)),
        Primitive::F32 => Value::Single(f32::from_le_bytes(reader.number()?)),
        Primitive::F64 => Value::Double(f64::from_le_bytes(reader.number()?)),
    })
}

fn write_record(schema: &Schema, of: &Struct, value: &Value, writer: &mut Writer) -> Result<(), CdrError> {
    let Value::Record(values) = value else { return Err(CdrError::Type) };
    if values.len() != of.fields.len() {
        return Err(CdrError::Type);
    }
    if of.fields.is_empty() {
        writer.number([0]);
    }
    std::iter::zip(&of.fields, values).try_for_each(|(one, value)| write_field(schema, one, value, writer))
}

fn write_field(schema: &Schema, of: &Field<usize>, value: &Value, writer: &mut Writer) -> Result<(), CdrError> {
    let is_bytes = matches!(of.element, Element::Primitive(Primitive::U8 | Primitive::Byte));
    if of.count == Count::One {
        return write_element(schema, &of.element, value, writer);
    }
    if let (Value::Bytes(bytes), true) = (value, is_bytes) {
        write_count(of.count, bytes.len(), writer)?;
        writer.bytes(bytes);
        return Ok(());
    }
    let Value::List(values) = value else { return Err(CdrError::Type) };
    write_count(of.count, values.len(), writer)?;
    values.iter().try_for_each(|value| write_element(schema, &of.element, value, writer))
}

/// Writes the number of elements, unless the type fixes it.
fn write_count(of: Count, count: usize, writer: &mut Writer) -> Result<(), CdrError> {
    match of {
        Count::Array(size) if size != count => Err(CdrError::Type),
        Count::Max(max) if count > max => Err(CdrError::Long(count)),
        Count::Any | Count::Max(_) => writer.count(count),
        Count::Array(_) | Count::One => Ok(()),
    }
}

fn write_element(schema: &Schema, of: &Element<usize>, value: &Value, writer: &mut Writer) -> Result<(), CdrError> {
    match (of, value) {
        (Element::Primitive(of), value) => write_primitive(*of, value, writer),
        (Element::Text { max }, Value::Text(text)) if max.is_none_or(|max| text.len() <= max) => writer.text(text),
        (Element::Text { .. }, Value::Text(text)) => Err(CdrError::Long(text.len())),
        (Element::Message(index), value) => write_record(schema, schema.at(*index), value, writer),
        (Element::Text { .. }, _) => Err(CdrError::Type),
    }
}

/// Writes a whole number with another size.
macro_rules! whole {
    ($writer:ident, $number:ident as $of:ty) => {
        $writer.number(<$of>::try_from(*$number).map_err(|_large| CdrError::Type)?.to_le_bytes())
    };
}

fn write_primitive(of: Primitive, value: &Value, writer: &mut Writer) -> Result<(), CdrError> {
    match (of, value) {
        (Primitive::Bool, Value::Truth(truth)) => writer.number([u8::from(*truth)]),
        (Primitive::Byte | Primitive::U8, Value::Unsigned(number)) => whole!(writer, number as u8),
        (Primitive::I8, Value::Signed(number)) => whole!(writer, number as i8),
        (Primitive::I16, Value::Signed(number)) => whole!(writer, number as i16),
        (Primitive::U16, Value::Unsigned(number)) => whole!(writer, number as u16),
        (Primitive::I32, Value::Signed(number)) => whole!(writer, number as i32),
        (Primitive::U32, Value::Unsigned(number)) => whole!(writer, number as u32),
        (Primitive::I64, Value::Signed(number)) => writer.number(number.to_le_bytes()),
        (Primitive::U64, Value::Unsigned(number)) => writer.number(number.to_le_bytes()),
        (Primitive::F32, Value::Single(number)) => writer.number(number.to_le_bytes()),
        (Primitive::F64, Value::Double(number)) => writer.number(number.to_le_bytes()),
        _ => return Err(CdrError::Type),
    }
    Ok(())
}
