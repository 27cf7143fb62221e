//! Checks bytes against a type without making a value of them.

use super::{CdrError, Reader};
use crate::logic::definition::{Count, Element, Field, Primitive};
use crate::logic::schema::{Schema, Struct};

/// Checks that the bytes are a value of this type. Needs no memory, and lists of numbers take no time.
///
/// # Errors
/// The bytes are not a value of this type, or more than padding follows.
pub fn check(schema: &Schema, bytes: &[u8]) -> Result<(), CdrError> {
    let mut reader = Reader::new(bytes)?;
    record(schema, schema.root(), &mut reader)?;
    reader.end()
}

fn record(schema: &Schema, of: &Struct, reader: &mut Reader<'_>) -> Result<(), CdrError> {
    if of.fields.is_empty() {
        // It has a byte, which means nothing.
        reader.number::<1>()?;
    }
    of.fields.iter().try_for_each(|one| field(schema, one, reader))
}

fn field(schema: &Schema, of: &Field<usize>, reader: &mut Reader<'_>) -> Result<(), CdrError> {
    let size_min = schema.size_min(&of.element);
    let count = match of.count {
        Count::One => 1,
        Count::Array(size) => {
            reader.fits(size, size_min)?;
            size
        }
        Count::Any => reader.count(size_min)?,
        Count::Max(max) => Some(reader.count(size_min)?).filter(|count| *count <= max).ok_or(CdrError::Long(max))?,
    };
    match &of.element {
        Element::Primitive(Primitive::Bool) => (0..count).try_for_each(|_| reader.truth().map(drop)),
        Element::Primitive(of) => numbers(*of, count, reader),
        Element::Text { max } => (0..count).try_for_each(|_| {
            let length = reader.text()?.len();
            if max.is_some_and(|max| length > max) { Err(CdrError::Long(length)) } else { Ok(()) }
        }),
        Element::Message(index) => (0..count).try_for_each(|_| record(schema, schema.at(*index), reader)),
    }
}

/// Goes over numbers, of which any bytes are some.
fn numbers(of: Primitive, count: usize, reader: &mut Reader<'_>) -> Result<(), CdrError> {
    if count == 0 {
        return Ok(());
    }
    // The first one finds its place, and the others follow it without a gap.
    let size = match of {
        Primitive::Bool | Primitive::Byte | Primitive::U8 | Primitive::I8 => reader.number::<1>()?.len(),
        Primitive::I16 | Primitive::U16 => reader.number::<2>()?.len(),
        Primitive::I32 | Primitive::U32 | Primitive::F32 => reader.number::<4>()?.len(),
        Primitive::I64 | Primitive::U64 | Primitive::F64 => reader.number::<8>()?.len(),
    };
    reader.bytes((count - 1).saturating_mul(size)).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::cdr::{read, write};
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
}
