//! Typed values of the database, as programs use them. The database stores a tag and bytes, [`Stored`].
//! `dbmanager::logic::view::value` describes the tags and the bytes, which are the same in both rooms.

use super::Stored;
use crate::logic::bytes::Bytes;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// How deep lists and tables may be nested.
pub const DEPTH_MAX: usize = 32;

const BYTES: u8 = 0;
const TEXT: u8 = 1;
const BOOL: u8 = 2;
const INTEGER: u8 = 3;
const FLOAT: u8 = 5;
const LIST: u8 = 6;
const TABLE: u8 = 7;

/// A typed value.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Yes or no.
    Bool(bool),
    /// A whole number. It is never equal to a float.
    Integer(i64),
    /// A number.
    Float(f64),
    /// A text, UTF-8.
    Text(String),
    /// Bytes without a type.
    Bytes(Vec<u8>),
    /// Values in order.
    List(Vec<Self>),
    /// Values by name.
    Table(BTreeMap<String, Self>),
    /// A value that this program cannot read, such as a sealed secret. It is written back unchanged.
    Opaque {
        /// The type of the bytes.
        tag: u8,
        /// The bytes.
        bytes: Vec<u8>,
    },
}

/// A value is of another type than expected.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("it is of type {found}, not of type {expected}")]
pub struct ValueError {
    /// The expected type.
    pub expected: &'static str,
    /// The actual type.
    pub found: &'static str,
}

/// A value inside a list or table, in its encoded form.
#[derive(Serialize, Deserialize)]
struct Inner(u8, Bytes);

impl Value {
    /// Returns a table.
    pub fn table<const N: usize>(fields: [(&str, Self); N]) -> Self {
        Self::Table(fields.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
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
            Self::Opaque { .. } => "opaque",
        }
    }

    /// Returns the field of a table.
    pub fn field(&self, name: &str) -> Option<&Self> {
        if let Self::Table(fields) = self { fields.get(name) } else { None }
    }

    /// Returns whether lists and tables are nested at most [`DEPTH_MAX`] deep.
    pub fn is_shallow(&self) -> bool {
        self.fits(DEPTH_MAX)
    }

    fn fits(&self, depth: usize) -> bool {
        match (self, depth.checked_sub(1)) {
            (Self::List(items), Some(below)) => items.iter().all(|item| item.fits(below)),
            (Self::Table(fields), Some(below)) => fields.values().all(|field| field.fits(below)),
            (Self::List(_) | Self::Table(_), None) => false,
            (Self::Bool(_) | Self::Integer(_) | Self::Float(_) | Self::Text(_), _)
            | (Self::Bytes(_) | Self::Opaque { .. }, _) => true,
        }
    }
}

impl Stored {
    /// Decodes the stored bytes. The result for unreadable bytes is [`Value::Opaque`].
    pub fn value(&self) -> Value {
        read(self.tag, &self.bytes.0, DEPTH_MAX)
    }
}

impl From<&Value> for Stored {
    fn from(value: &Value) -> Self {
        // Encoding to memory fails only for lengths that are not known in advance, and these are known.
        let (tag, bytes) = match value {
            Value::Bool(yes) => (BOOL, vec![u8::from(*yes)]),
            Value::Integer(number) => (INTEGER, number.to_le_bytes().to_vec()),
            Value::Float(number) => {
                let number = if number.is_nan() { f64::NAN } else { *number };
                (FLOAT, number.to_bits().to_le_bytes().to_vec())
            }
            Value::Text(text) => (TEXT, text.as_bytes().to_vec()),
            Value::Bytes(bytes) => (BYTES, bytes.clone()),
            Value::Opaque { tag, bytes } => (*tag, bytes.clone()),
            Value::List(items) => {
                let items: Vec<Inner> = items.iter().map(inner).collect();
                (LIST, postcard::to_stdvec(&items).unwrap_or_default())
            }
            Value::Table(fields) => {
                let fields: BTreeMap<&str, Inner> =
                    fields.iter().map(|(name, field)| (name.as_str(), inner(field))).collect();
                (TABLE, postcard::to_stdvec(&fields).unwrap_or_default())
            }
        };
        Self { tag, bytes: bytes.into() }
    }
}

fn inner(value: &Value) -> Inner {
    let Stored { tag, bytes } = Stored::from(value);
    Inner(tag, bytes)
}

/// Decodes a value in which lists and tables are nested up to `depth` deep.
fn read(tag: u8, bytes: &[u8], depth: usize) -> Value {
    let number = <[u8; 8]>::try_from(bytes).map(u64::from_le_bytes).ok();
    let value = match (tag, depth.checked_sub(1)) {
        (BYTES, _) => Some(Value::Bytes(bytes.to_vec())),
        (TEXT, _) => std::str::from_utf8(bytes).ok().map(|text| Value::Text(text.to_owned())),
        (BOOL, _) => match bytes {
            [0] => Some(Value::Bool(false)),
            [1] => Some(Value::Bool(true)),
            _ => None,
        },
        (INTEGER, _) => number.map(|bits| Value::Integer(bits.cast_signed())),
        (FLOAT, _) => number.map(|bits| Value::Float(f64::from_bits(bits))),
        (LIST, Some(below)) => {
            let items = postcard::from_bytes::<Vec<Inner>>(bytes).ok();
            items.map(|items| Value::List(items.iter().map(|Inner(tag, bytes)| read(*tag, &bytes.0, below)).collect()))
        }
        (TABLE, Some(below)) => {
            let fields = postcard::from_bytes::<BTreeMap<String, Inner>>(bytes).ok();
            let read = |(name, Inner(tag, bytes)): (String, Inner)| (name, read(tag, &bytes.0, below));
            fields.map(|fields| Value::Table(fields.into_iter().map(read).collect()))
        }
        _ => None,
    };
    value.unwrap_or_else(|| Value::Opaque { tag, bytes: bytes.to_vec() })
}

/// Conversions between a type of Rust and its variant.
macro_rules! convert {
    ($($rust:ty, $variant:ident, $word:literal;)*) => {$(
        impl From<$rust> for Value {
            fn from(value: $rust) -> Self {
                Self::$variant(value)
            }
        }
        impl TryFrom<Value> for $rust {
            type Error = ValueError;
            fn try_from(value: Value) -> Result<Self, ValueError> {
                if let Value::$variant(value) = value {
                    return Ok(value);
                }
                Err(ValueError { expected: $word, found: value.kind() })
            }
        }
    )*};
}

convert! {
    bool, Bool, "bool";
    i64, Integer, "integer";
    f64, Float, "float";
    String, Text, "text";
    Vec<u8>, Bytes, "bytes";
    Vec<Value>, List, "list";
    BTreeMap<String, Value>, Table, "table";
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            any::<bool>().prop_map(Value::Bool),
            any::<i64>().prop_map(Value::Integer),
            any::<f64>().prop_filter("equal to itself", |number| !number.is_nan()).prop_map(Value::Float),
            ".*".prop_map(Value::Text),
            any::<Vec<u8>>().prop_map(Value::Bytes),
            any::<Vec<u8>>().prop_map(|bytes| Value::Opaque { tag: 4, bytes }),
        ];
        leaf.prop_recursive(4, 32, 4, |inner| {
            prop_oneof![
                prop::collection::vec(inner.clone(), 0..4).prop_map(Value::List),
                prop::collection::btree_map("[a-z]{1,3}", inner, 0..4).prop_map(Value::Table),
            ]
        })
    }

    proptest! {
        #[test]
        fn a_value_is_read_as_it_was_written(value in value()) {
            prop_assert_eq!(Stored::from(&value).value(), value);
        }

        #[test]
        fn any_bytes_are_a_value(tag: u8, bytes: Vec<u8>) {
            drop(Stored { tag, bytes: bytes.into() }.value());
        }
    }

    #[test]
    fn what_lies_too_deep_is_opaque_and_refused_before() {
        let deep = |depth| (0..depth).fold(Value::Bool(true), |inner, _| Value::List(vec![inner]));
        assert!(deep(DEPTH_MAX).is_shallow() && !deep(DEPTH_MAX + 1).is_shallow());
        assert_eq!(Stored::from(&deep(DEPTH_MAX)).value(), deep(DEPTH_MAX));
        assert_ne!(Stored::from(&deep(DEPTH_MAX + 1)).value(), deep(DEPTH_MAX + 1));
    }

    #[test]
    fn another_type_is_an_error_that_says_both() {
        assert_eq!(f64::try_from(Value::from(1.5)), Ok(1.5));
        let error = f64::try_from(Value::from(1)).unwrap_err();
        assert_eq!(error.to_string(), "it is of type integer, not of type float");
        assert_eq!(Value::table([("x", 1.0.into())]).field("x"), Some(&Value::Float(1.0)));
    }
}
