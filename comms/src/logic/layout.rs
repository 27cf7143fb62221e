//! The layout of a message that is known only at run time, and its bytes read and written by it.
//!
//! Values of wires are encoded with postcard, which does not describe itself. The fields that an interface declares, `force: Force[3], who: Text`,
//! give the layout of the bytes. Records, `dca echo`, `dca call` and programs that are not written in Rust read and write values by it.
//! The reader and the writer know no value type: [`Build`] makes the values that are read, and [`Part`] is a value that is written.
//! Source: <https://postcard.jamesmunns.com/wire-format>.

mod read;
mod write;

pub use read::{Build, Reader, read};
pub use write::{Part, Writer, write};

use std::fmt;

/// How many bytes the length of something takes at most.
const LENGTH_BYTES_MAX: usize = 10;

/// The layout of a message: its values one after the other, in the order of its type, as postcard encodes them.
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
    /// Bytes that are sent with their length, in a form that another description has.
    Piece {
        /// The type that the description has: `ros.sensor.LaserScan`.
        of: String,
    },
    /// Fields in order.
    Record(Vec<Field>),
    /// Elements of one type.
    List {
        /// The type of an element.
        of: Box<Self>,
        /// The number of elements; none if the type allows any number, which is then sent with them.
        count: Option<usize>,
    },
}

/// A field of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub layout: Layout,
}

/// A message type: its name and its layout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its name: `Wrench`.
    pub name: String,
    /// The layout of its bytes.
    pub layout: Layout,
}

impl Layout {
    /// Returns the fields of a record as an interface declares them: `force: Force[3], who: Text`. Empty for anything else.
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
