//! The layout of a message that is known only at run time, and reading and writing of its bytes.
//!
//! Values of wires are encoded with postcard, which does not describe itself. The fields that an interface declares, such as `force:
//! Force[3], who: Text`, give the layout of the bytes. Records, `dca echo`, `dca call` and programs in other languages than Rust read and
//! write values with a layout. Reader and writer work with any value type: [`Build`] makes the values that are read, and [`Part`] is a
//! value that is written. Source: <https://postcard.jamesmunns.com/wire-format>.

mod read;
mod write;

pub use read::{Build, Reader, read};
pub use write::{Part, Writer, write};

use std::fmt;

/// How many bytes an encoded length has at most.
const LENGTH_BYTES_MAX: usize = 10;

/// The layout of a message: its values one after the other, in the order of its type, encoded by postcard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A number of 64 bits, `f64`, in SI units.
    Number {
        /// The quantity of the number: `Force`, or `Number`.
        of: String,
    },
    /// `bool`.
    Truth,
    /// `String`.
    Text,
    /// Bytes with their length. Another description defines their form.
    Piece {
        /// The type in that description: `ros.sensor.LaserScan`.
        of: String,
    },
    /// Fields in order.
    Record(Vec<Field>),
    /// Elements of one type.
    List {
        /// The type of an element.
        of: Box<Self>,
        /// The number of elements. `None`: the type allows any number, and the number is sent before the elements.
        count: Option<usize>,
    },
}

/// A field of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// The name of the field.
    pub name: String,
    /// The type of the field.
    pub layout: Layout,
}

/// A message type: its name and its layout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The name of the message type: `Wrench`.
    pub name: String,
    /// The layout of its bytes.
    pub layout: Layout,
}

impl Layout {
    /// Returns the fields of a record as an interface declares them: `force: Force[3], who: Text`. Empty for any other layout.
    pub fn fields(&self) -> String {
        match self {
            Self::Record(fields) => {
                let fields = fields.iter().map(|Field { name, layout }| format!("{name}: {layout}"));
                fields.collect::<Vec<_>>().join(", ")
            }
            Self::Number { .. } | Self::Truth | Self::Text | Self::Piece { .. } | Self::List { .. } => String::new(),
        }
    }
}

/// The type as a spec spells it: `Force[3]`, `{ x: Length }`.
impl fmt::Display for Layout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number { of } | Self::Piece { of } => f.write_str(of),
            Self::Truth => f.write_str("Truth"),
            Self::Text => f.write_str("Text"),
            Self::Record(_) => write!(f, "{{ {} }}", self.fields()),
            Self::List { of, count } => {
                let count = count.map(|count| count.to_string()).unwrap_or_default();
                write!(f, "{of}[{count}]")
            }
        }
    }
}

#[cfg(test)]
mod tests;
