//! Checks bytes against a type without making a value.

use super::{CdrError, Reader};
use crate::logic::definition::{Count, Element, Field, Primitive};
use crate::logic::schema::{Schema, Struct};

/// Checks that the bytes are a value of this type. This needs no memory, and lists of numbers take no time.
///
/// # Errors
/// If the bytes are not a value of this type, or more bytes follow than padding.
pub fn check(schema: &Schema, bytes: &[u8]) -> Result<(), CdrError> {
    Walk { schema, is_finite: None }.whole(bytes).map(drop)
}

/// Checks that the bytes are a value of this type, and returns whether every number in it is finite.
///
/// # Errors
/// As in [`check`].
pub fn is_finite(schema: &Schema, bytes: &[u8]) -> Result<bool, CdrError> {
    Walk { schema, is_finite: Some(true) }.whole(bytes).map(|found| found == Some(true))
}

/// A pass over a value.
struct Walk<'a> {
    schema: &'a Schema,
    /// Whether all floats so far are finite; none if floats are not checked.
    is_finite: Option<bool>,
}

impl Walk<'_> {
    fn whole(mut self, bytes: &[u8]) -> Result<Option<bool>, CdrError> {
        let mut reader = Reader::new(bytes)?;
        self.record(self.schema.root(), &mut reader)?;
        reader.end()?;
        Ok(self.is_finite)
    }

    fn record(&mut self, of: &Struct, reader: &mut Reader<'_>) -> Result<(), CdrError> {
        if of.fields.is_empty() {
            // The message has one byte, which has no meaning.
            reader.number::<1>()?;
        }
        of.fields.iter().try_for_each(|one| self.field(one, reader))
    }

    fn field(&mut self, of: &Field<usize>, reader: &mut Reader<'_>) -> Result<(), CdrError> {
        let size_min = self.schema.size_min(&of.element);
        let count = match of.count {
            Count::One => 1,
            Count::Array(size) => {
                reader.fits(size, size_min)?;
                size
            }
            Count::Any => reader.count(size_min)?,
            Count::Max(max) => {
                Some(reader.count(size_min)?).filter(|count| *count <= max).ok_or(CdrError::Long(max))?
            }
        };
        match &of.element {
            Element::Primitive(Primitive::Bool) => (0..count).try_for_each(|_| reader.truth().map(drop)),
            // Any bytes are valid numbers.
            Element::Primitive(of) => {
                let bytes = reader.numbers(count, of.size())?;
                self.is_finite = self.is_finite.map(|is_finite| is_finite && are_finite(*of, bytes));
                Ok(())
            }
            Element::Text { max } => (0..count).try_for_each(|_| {
                let length = reader.text()?.len();
                if max.is_some_and(|max| length > max) { Err(CdrError::Long(length)) } else { Ok(()) }
            }),
            Element::Message(index) => {
                let of = self.schema.at(*index);
                (0..count).try_for_each(|_| self.record(of, reader))
            }
        }
    }
}

/// Returns whether the numbers of this type in `bytes` are finite.
pub fn are_finite(of: Primitive, bytes: &[u8]) -> bool {
    match of {
        Primitive::F32 => bytes.as_chunks().0.iter().all(|one| f32::from_le_bytes(*one).is_finite()),
        Primitive::F64 => bytes.as_chunks().0.iter().all(|one| f64::from_le_bytes(*one).is_finite()),
        Primitive::Bool
        | Primitive::Byte
        | Primitive::I8
        | Primitive::U8
        | Primitive::I16
        | Primitive::U16
        | Primitive::I32
        | Primitive::U32
        | Primitive::I64
        | Primitive::U64 => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::cdr::{Value, read, write};
    use crate::logic::library;
    use crate::logic::name::TypeName;
    use proptest::prelude::*;

    fn schema(at: usize) -> Schema {
        let names: Vec<TypeName> = library::messages().collect();
        library::schema(&names[at % names.len()]).unwrap()
    }

    proptest! {
        #[test]
        fn what_is_read_passes_and_nothing_else(at: usize, body in prop::collection::vec(0..6_u8, 0..200)) {
            let bytes = [&[0, 1, 0, 0][..], &body].concat();
            let schema = schema(at);
            prop_assert_eq!(check(&schema, &bytes), read(&schema, &bytes).map(drop));
            prop_assert_eq!(is_finite(&schema, &bytes).map(drop), check(&schema, &bytes));
        }
    }

    #[test]
    fn each_shortened_value_is_refused() {
        let name = TypeName::parse("sensor_msgs/LaserScan").unwrap();
        let schema = library::schema(&name).unwrap();
        // A header, seven numbers, and two empty lists.
        let whole =
            [&[0, 1, 0, 0][..], &[0; 8], &[2, 0, 0, 0, b'l', 0, 0, 0], &[0; 28], &[1, 0, 0, 0], &[7; 4], &[0; 4]]
                .concat();
        let value = read(&schema, &whole).unwrap();
        assert_eq!(write(&schema, &value).as_ref(), Ok(&whole));
        assert_eq!(check(&schema, &whole), Ok(()));
        for end in 0..whole.len() {
            assert!(check(&schema, &whole[..end]).is_err(), "{end} bytes");
        }
    }

    #[test]
    fn a_number_that_is_not_finite_is_found() {
        let finite = |name: &str, value: Value| {
            let schema = library::schema(&TypeName::parse(name).unwrap()).unwrap();
            is_finite(&schema, &write(&schema, &value).unwrap()).unwrap()
        };
        let vector = |x| Value::Record(vec![Value::Double(1.0), Value::Double(x), Value::Double(0.0)]);
        assert!(finite("geometry_msgs/Vector3", vector(f64::MAX)));
        assert!(!finite("geometry_msgs/Vector3", vector(f64::NAN)));
        let twist = |x| Value::Record(vec![vector(0.0), vector(x)]);
        assert!(!finite("geometry_msgs/Twist", twist(f64::INFINITY)));
        let floats = |x| {
            let layout = Value::Record(vec![Value::List(vec![]), Value::Unsigned(0)]);
            Value::Record(vec![layout, Value::List(vec![Value::Single(1.0), Value::Single(x)])])
        };
        assert!(finite("std_msgs/Float32MultiArray", floats(2.0)));
        assert!(!finite("std_msgs/Float32MultiArray", floats(f32::NEG_INFINITY)));
        // The bytes of an infinite float are a valid whole number.
        assert!(finite("std_msgs/UInt32", Value::Record(vec![Value::Unsigned(f32::INFINITY.to_bits().into())])));
    }
}
