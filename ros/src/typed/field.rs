//! The values of fields: numbers, texts, lists, other messages.

use crate::logic::cdr::{CdrError, Reader, Writer};
use serde::{Serialize, Serializer};
use std::fmt::Debug;

/// A value in a message.
pub trait Field: Clone + Debug + PartialEq + Sized {
    /// The fewest bytes of a value, without padding.
    const SIZE_MIN: usize;

    /// Returns the value of a field before it is set.
    fn zero() -> Self;

    /// Writes the value.
    ///
    /// # Errors
    /// If a text or a list is longer than CDR can express.
    fn write(&self, writer: &mut Writer) -> Result<(), CdrError>;

    /// Reads a value.
    ///
    /// # Errors
    /// If the bytes are not such a value.
    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError>;

    /// Shows the value as the names and values of its fields.
    ///
    /// # Errors
    /// If the serializer fails.
    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error>;

    /// Writes values one after the other.
    ///
    /// # Errors
    /// As in [`Field::write`].
    fn write_all(values: &[Self], writer: &mut Writer) -> Result<(), CdrError> {
        values.iter().try_for_each(|value| value.write(writer))
    }

    /// Reads `count` values, which are known to fit into the bytes.
    ///
    /// # Errors
    /// As in [`Field::read`].
    fn read_all(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>, CdrError> {
        (0..count).map(|_| Self::read(reader)).collect()
    }

    /// Shows values as a list.
    ///
    /// # Errors
    /// If the serializer fails.
    fn show_all<S: Serializer>(values: &[Self], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(values.iter().map(Shown))
    }
}

/// A value that is shown with the names of its fields.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a, T>(pub &'a T);

impl<T: Field> Serialize for Shown<'_, T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.show(serializer)
    }
}

macro_rules! numbers {
    ($($number:ident $show:ident),+) => {
        $(
            impl Field for $number {
                const SIZE_MIN: usize = size_of::<Self>();

                fn zero() -> Self {
                    Self::default()
                }

                fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
                    writer.number(self.to_le_bytes());
                    Ok(())
                }

                fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
                    Ok(Self::from_le_bytes(reader.number()?))
                }

                fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                    serializer.$show(*self)
                }
            }
        )+
    };
}

numbers! {
    i8 serialize_i8, i16 serialize_i16, u16 serialize_u16, i32 serialize_i32, u32 serialize_u32, i64 serialize_i64,
    u64 serialize_u64, f32 serialize_f32, f64 serialize_f64
}

/// Many bytes are copied at once, for an image or a cloud of points.
impl Field for u8 {
    const SIZE_MIN: usize = 1;

    fn zero() -> Self {
        0
    }

    fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
        writer.bytes(&[*self]);
        Ok(())
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        let [byte] = reader.number()?;
        Ok(byte)
    }

    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(*self)
    }

    fn write_all(values: &[Self], writer: &mut Writer) -> Result<(), CdrError> {
        writer.bytes(values);
        Ok(())
    }

    fn read_all(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>, CdrError> {
        Ok(reader.bytes(count)?.to_vec())
    }

    fn show_all<S: Serializer>(values: &[Self], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(values)
    }
}

impl Field for bool {
    const SIZE_MIN: usize = 1;

    fn zero() -> Self {
        false
    }

    fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
        writer.bytes(&[u8::from(*self)]);
        Ok(())
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        reader.truth()
    }

    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bool(*self)
    }
}

/// A text ends at its first zero byte, in the same way as a text of C++ that is sent.
impl Field for String {
    const SIZE_MIN: usize = 4;

    fn zero() -> Self {
        Self::new()
    }

    fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
        let end = self.find('\0').unwrap_or(self.len());
        writer.text(&self[..end])
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        reader.text().map(str::to_owned)
    }

    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self)
    }
}

impl<T: Field> Field for Vec<T> {
    const SIZE_MIN: usize = 4;

    fn zero() -> Self {
        Self::new()
    }

    fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
        writer.count(self.len())?;
        T::write_all(self, writer)
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        let count = reader.count(T::SIZE_MIN)?;
        T::read_all(count, reader)
    }

    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        T::show_all(self, serializer)
    }
}

impl<T: Field, const N: usize> Field for [T; N] {
    const SIZE_MIN: usize = T::SIZE_MIN * N;

    fn zero() -> Self {
        std::array::from_fn(|_| T::zero())
    }

    fn write(&self, writer: &mut Writer) -> Result<(), CdrError> {
        T::write_all(self, writer)
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, CdrError> {
        reader.fits(N, T::SIZE_MIN)?;
        T::read_all(N, reader)?.try_into().map_err(|_other: Vec<T>| CdrError::End)
    }

    fn show<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        T::show_all(self, serializer)
    }
}
