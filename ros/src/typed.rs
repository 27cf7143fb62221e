//! The standard messages, and the parts of services and actions, as structs of Rust.
//!
//! A test of this room writes the modules from the definitions: `tests/all/typed.rs`.

mod all;
mod at_most;
mod field;

pub mod action_msgs;
pub mod builtin_interfaces;
pub mod composition_interfaces;
pub mod diagnostic_msgs;
pub mod example_interfaces;
pub mod geometry_msgs;
pub mod lifecycle_msgs;
pub mod nav2_msgs;
pub mod nav_msgs;
pub mod rcl_interfaces;
pub mod rosgraph_msgs;
pub mod sensor_msgs;
pub mod service_msgs;
pub mod shape_msgs;
pub mod std_msgs;
pub mod std_srvs;
pub mod tf2_msgs;
pub mod trajectory_msgs;
pub mod unique_identifier_msgs;
pub mod visualization_msgs;

pub use at_most::AtMost;
pub use field::{Field, Shown};

use crate::logic::cdr::{CdrError, Reader, Writer};
use serde::de::{Deserializer, Error, Visitor};
use serde::ser::SerializeStruct;
use std::fmt;
use std::marker::PhantomData;

/// A message of ROS 2.
pub trait Message: Field {
    /// The name in ROS 2: `sensor_msgs/msg/LaserScan`.
    const NAME: &'static str;
    /// The name in a spec: `ros.sensor.LaserScan`.
    const SPEC: &'static str;

    /// Returns the message as CDR, with its header.
    ///
    /// # Errors
    /// If a text or a list is longer than CDR can express: 4 GiB.
    fn to_cdr(&self) -> Result<Vec<u8>, CdrError> {
        let mut writer = Writer::default();
        self.write(&mut writer)?;
        Ok(writer.finish())
    }

    /// Returns the message in `bytes`.
    ///
    /// # Errors
    /// If the bytes are not a message of this type.
    fn from_cdr(bytes: &[u8]) -> Result<Self, CdrError> {
        let mut reader = Reader::new(bytes)?;
        let message = Self::read(&mut reader)?;
        reader.end()?;
        Ok(message)
    }
}

/// Reads a message from its CDR bytes, which are its form on a wire.
pub(crate) fn from_bytes<'de, M: Message, D: Deserializer<'de>>(deserializer: D) -> Result<M, D::Error> {
    deserializer.deserialize_byte_buf(Bytes(PhantomData))
}

struct Bytes<M>(PhantomData<M>);

impl<M: Message> Visitor<'_> for Bytes<M> {
    type Value = M;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the bytes of a {}", M::NAME)
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<M, E> {
        M::from_cdr(bytes).map_err(E::custom)
    }
}

/// Shows a field of a message.
pub(crate) fn shown_field<S: SerializeStruct, T: Field>(
    mut shown: S,
    name: &'static str,
    value: &T,
) -> Result<S, S::Error> {
    shown.serialize_field(name.strip_prefix("r#").unwrap_or(name), &Shown(value))?;
    Ok(shown)
}

/// Declares a message as a struct. On a wire the message is its CDR bytes; people see its fields.
///
/// All functions are `inline`, so that only the functions of messages that a program uses are compiled. This saves 2 s
/// for this crate.
macro_rules! message {
    (
        $name:ident, $ros:literal, $spec:literal;
        $($field:ident: $type:ty $(= $default:expr)?,)*
        $(; $(const $constant:ident: $of:ty = $value:expr;)+)?
    ) => {
        #[doc = concat!("A message of the type `", $ros, "`.")]
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            $(#[doc = concat!("The field `", stringify!($field), "`.")] pub $field: $type,)*
        }

        $(impl $name {
            $(
                #[doc = concat!("The constant `", stringify!($constant), "`.")]
                pub const $constant: $of = $value;
            )+
        })?

        impl Default for $name {
            #[inline]
            fn default() -> Self {
                Self { $($field: $crate::typed::initial!($($default)?),)* }
            }
        }

        impl $crate::typed::Message for $name {
            const NAME: &'static str = $ros;
            const SPEC: &'static str = $spec;
        }

        impl $crate::typed::Field for $name {
            // A message without fields is one byte.
            const SIZE_MIN: usize = {
                let size: usize = 0 $(+ <$type as $crate::typed::Field>::SIZE_MIN)*;
                if size == 0 { 1 } else { size }
            };

            #[inline]
            fn zero() -> Self {
                Self::default()
            }

            #[inline]
            fn write(&self, writer: &mut $crate::logic::cdr::Writer) -> Result<(), $crate::logic::cdr::CdrError> {
                $crate::typed::placeholder!(writer; $($field)*);
                $(self.$field.write(writer)?;)*
                Ok(())
            }

            #[inline]
            fn read(reader: &mut $crate::logic::cdr::Reader<'_>) -> Result<Self, $crate::logic::cdr::CdrError> {
                $crate::typed::placeholder!(reader.read; $($field)*);
                Ok(Self { $($field: $crate::typed::Field::read(reader)?,)* })
            }

            #[inline]
            fn show<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let fields: &[&str] = &[$(stringify!($field),)*];
                let shown = serializer.serialize_struct(stringify!($name), fields.len())?;
                $(let shown = $crate::typed::shown_field(shown, stringify!($field), &self.$field)?;)*
                serde::ser::SerializeStruct::end(shown)
            }
        }

        impl serde::Serialize for $name {
            #[inline]
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                if serializer.is_human_readable() {
                    return $crate::typed::Field::show(self, serializer);
                }
                let bytes = $crate::typed::Message::to_cdr(self).map_err(serde::ser::Error::custom)?;
                serializer.serialize_bytes(&bytes)
            }
        }

        impl<'de> serde::Deserialize<'de> for $name {
            #[inline]
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                $crate::typed::from_bytes(deserializer)
            }
        }
    };
}

/// The value of a field that has not been set.
macro_rules! initial {
    () => {
        $crate::typed::Field::zero()
    };
    ($default:expr) => {
        $default
    };
}

/// Writes or reads the byte of a message without fields. The byte has no meaning.
macro_rules! placeholder {
    ($writer:ident;) => {
        $writer.number([0]);
    };
    ($reader:ident.read;) => {
        let [_] = $reader.number::<1>()?;
    };
    ($writer:ident; $($field:ident)+) => {};
    ($reader:ident.read; $($field:ident)+) => {};
}

pub(crate) use {initial, message, placeholder};
