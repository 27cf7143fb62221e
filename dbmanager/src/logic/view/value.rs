//! Typed values: the meaning of the bytes at a key.
//!
//! A stored [`Value`] consists of a *tag*, the number of its type, and bytes. A [`Datum`] is the same in readable form.
//! No bytes are refused and none are lost: values of a newer program under an unknown tag, and malformed ones, are
//! shown as [`Datum::Opaque`] and written back unchanged, even inside lists and tables. So reading a stored value and
//! writing it back does not change it, and equal data have equal bytes.
//!
//! | tag | meaning | bytes |
//! |---|---|---|
//! | 0 | bytes | the bytes themselves |
//! | 1 | text | UTF-8 |
//! | 2 | bool | `0` or `1` |
//! | 3 | integer | 64 bits, little-endian, two's complement |
//! | 4 | sealed for some readers | an envelope, which only these readers can open |
//! | 5 | float | IEEE 754 binary64, little-endian; only one of the NaNs |
//! | 6 | list | count, then each value with its tag and length (postcard) |
//! | 7 | table | count, then each name and value, by name (postcard) |
//!
//! **A table, or a key for each field?** The database merges keys, not the fields of their values. If two robots change
//! two fields of one table at the same time, this is a conflict, and one of the tables is shown. Give each field a
//! separate key (`team/camera/gain`, `team/camera/exposure`) and write them in one transaction: then only changes of
//! the same field conflict. A table is right for values that only make sense as a whole, like a pose or the
//! coefficients of a calibration.

mod json;
pub(in crate::logic::view) mod text;

pub use text::{TextError, quote};

use crate::logic::txn::{Encoding, VALUE_SIZE_MAX, Value};
pub use comms::logic::database::DEPTH_MAX;
use comms::logic::database::{Stored, Value as Typed};
use std::collections::BTreeMap;
use std::fmt;
use thiserror::Error;

/// The tag of an envelope. `comms::logic::database::value` has all other tags, and writes and reads them.
const SEALED: u8 = 4;

/// A typed value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Datum {
    /// Yes or no.
    Bool(bool),
    /// A whole number. It is never equal to a float.
    Integer(i64),
    /// A number.
    Float(Float),
    /// A text, UTF-8.
    Text(String),
    /// Bytes without a type of their own.
    Bytes(Vec<u8>),
    /// Values in order.
    List(Vec<Self>),
    /// Values by name.
    Table(BTreeMap<String, Self>),
    /// An envelope that only some readers can open.
    Sealed(Vec<u8>),
    /// A value that this program cannot read.
    Opaque {
        /// The type of the bytes.
        tag: u8,
        /// The stored bytes.
        bytes: Vec<u8>,
    },
}

/// A 64-bit float that equals itself, NaN included; `-0` and `0` are different.
#[derive(Clone, Copy)]
pub struct Float(f64);

/// Why a value cannot be stored.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum DatumError {
    /// More bytes than a key holds.
    #[error("the value takes {size} bytes, more than {VALUE_SIZE_MAX}; write its parts to separate keys")]
    Long {
        /// The size of the value as stored.
        size: usize,
    },
    /// Nested too deeply.
    #[error("lists and tables are nested more than {DEPTH_MAX} levels deep; write the parts to separate keys")]
    Deep,
}

impl Float {
    /// Returns the float. All NaNs become the same one.
    pub const fn new(number: f64) -> Self {
        Self(if number.is_nan() { f64::NAN } else { number })
    }

    /// Returns the number.
    pub const fn get(self) -> f64 {
        self.0
    }
}

impl PartialEq for Float {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

impl Eq for Float {}

impl fmt::Debug for Float {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl Datum {
    /// Returns a float.
    pub const fn float(number: f64) -> Self {
        Self::Float(Float::new(number))
    }

    /// Reads a stored value.
    pub fn of(value: &Value) -> Self {
        let (tag, bytes) = (value.encoding.0, value.bytes.to_vec());
        let datum = Self::from(Stored { tag, bytes: bytes.into() }.value());
        // There is more than one way to encode a length. Reading must not change bytes that `encode` would write
        // differently.
        if datum.to_value() == *value {
            return datum;
        }
        Self::Opaque { tag: value.encoding.0, bytes: value.bytes.to_vec() }
    }

    /// Returns the value in its stored form.
    ///
    /// # Errors
    /// If the value is too long, or nested too deeply.
    pub fn encode(&self) -> Result<Value, DatumError> {
        if self.depth(DEPTH_MAX + 1) > DEPTH_MAX {
            return Err(DatumError::Deep);
        }
        let value = self.to_value();
        let size = value.bytes.len();
        if size > VALUE_SIZE_MAX { Err(DatumError::Long { size }) } else { Ok(value) }
    }

    /// Returns the name of the value's type.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Bool(_) => "bool",
            Self::Integer(_) => "integer",
            Self::Float(_) => "float",
            Self::Text(_) => "text",
            Self::Bytes(_) => "bytes",
            Self::List(_) => "list",
            Self::Table(_) => "table",
            Self::Sealed(_) => "sealed",
            Self::Opaque { .. } => "opaque",
        }
    }

    /// Returns how deep lists and tables are nested, up to `limit`.
    fn depth(&self, limit: usize) -> usize {
        let Some(below) = limit.checked_sub(1) else { return 0 };
        match self {
            Self::List(items) => 1 + items.iter().map(|item| item.depth(below)).max().unwrap_or(0),
            Self::Table(fields) => 1 + fields.values().map(|field| field.depth(below)).max().unwrap_or(0),
            Self::Bool(_) | Self::Integer(_) | Self::Float(_) | Self::Text(_) => 0,
            Self::Bytes(_) | Self::Sealed(_) | Self::Opaque { .. } => 0,
        }
    }

    fn to_value(&self) -> Value {
        let Stored { tag, bytes } = Stored::from(&Typed::from(self));
        Value { encoding: Encoding(tag), bytes: bytes.0.into() }
    }
}

/// The same value in the form for programs: sealed values are opaque, and floats are plain Rust floats.
impl From<&Datum> for Typed {
    fn from(datum: &Datum) -> Self {
        match datum {
            Datum::Bool(yes) => Self::Bool(*yes),
            Datum::Integer(number) => Self::Integer(*number),
            Datum::Float(number) => Self::Float(number.0),
            Datum::Text(text) => Self::Text(text.clone()),
            Datum::Bytes(bytes) => Self::Bytes(bytes.clone()),
            Datum::Sealed(bytes) => Self::Opaque { tag: SEALED, bytes: bytes.clone() },
            Datum::Opaque { tag, bytes } => Self::Opaque { tag: *tag, bytes: bytes.clone() },
            Datum::List(items) => Self::List(items.iter().map(Self::from).collect()),
            Datum::Table(fields) => {
                Self::Table(fields.iter().map(|(name, field)| (name.clone(), Self::from(field))).collect())
            }
        }
    }
}

impl From<Typed> for Datum {
    fn from(value: Typed) -> Self {
        match value {
            Typed::Bool(yes) => Self::Bool(yes),
            Typed::Integer(number) => Self::Integer(number),
            Typed::Float(number) => Self::float(number),
            Typed::Text(text) => Self::Text(text),
            Typed::Bytes(bytes) => Self::Bytes(bytes),
            Typed::Opaque { tag: SEALED, bytes } => Self::Sealed(bytes),
            Typed::Opaque { tag, bytes } => Self::Opaque { tag, bytes },
            Typed::List(items) => Self::List(items.into_iter().map(Self::from).collect()),
            Typed::Table(fields) => {
                Self::Table(fields.into_iter().map(|(name, field)| (name, Self::from(field))).collect())
            }
        }
    }
}

impl From<&str> for Datum {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<i64> for Datum {
    fn from(number: i64) -> Self {
        Self::Integer(number)
    }
}

/// As TOML.
impl fmt::Display for Datum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.to_toml())
    }
}

#[cfg(test)]
pub(crate) mod tests;
