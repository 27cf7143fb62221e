//! The layout of the messages on a wire, as far as the interface of the sender declares it, and which senders have to be asked.

use crate::plan::Environment;

/// A message that an output sends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its type: `Wrench`.
    pub name: String,
    /// The layout of its bytes.
    pub layout: Layout,
}

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
    /// A message of ROS 2, as the bytes of its CDR with their length.
    Ros {
        /// Its type: `ros.sensor.LaserScan`.
        of: String,
    },
    /// Fields with their names.
    Record(Vec<(String, Self)>),
    /// Elements of one type.
    List {
        /// Of which.
        of: Box<Self>,
        /// The number of elements; none for any number, which is then sent with them.
        count: Option<usize>,
    },
}

/// A module whose interface comes from its program, which is in Python.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AskedModule {
    /// Its name: `Keep`.
    pub name: String,
    /// The program and its arguments, as [`words`](crate::plan::words) reads them; the last one is the name.
    pub exec: String,
    /// The variables and the folder of the program.
    pub environment: Environment,
}

/// A record type that the texts declare, for programs in other languages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordType {
    /// Its name: `Wrench`.
    pub name: String,
    /// The text of its doc comments.
    pub doc: String,
    /// Its fields in order.
    pub fields: Vec<(String, FieldType)>,
}

/// The type of a field, in which record types keep their names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// `Number`, `Force`, `Truth`, `Text`, `Bytes`, or a type of programs.
    Plain(String),
    /// A record type, by its name.
    Named(String),
    /// A record that is written out.
    Record(Vec<(String, Self)>),
    /// Elements of one type.
    List {
        /// Of which.
        of: Box<Self>,
        /// How many; any number if that is not said.
        count: Option<usize>,
    },
}
