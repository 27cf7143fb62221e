//! The layout of the messages on a wire, if the interface of the sender declares it. Also the modules whose programs must be asked.

use crate::plan::Environment;
use serde::{Deserialize, Serialize};

/// A message that an output sends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// The type of the message: `Wrench`.
    pub name: String,
    /// The layout of its bytes.
    pub layout: Layout,
}

/// The layout of a message: its values one after the other, in the order of its type, in postcard encoding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(remote = "Self")] // `plan::nested` limits how deep the bytes nest.
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
    /// A message of ROS 2: the bytes of its CDR encoding, with their length before them.
    Ros {
        /// The type of the message: `ros.sensor.LaserScan`.
        of: String,
    },
    /// Fields with their names.
    Record(Vec<(String, Self)>),
    /// Elements of one type.
    List {
        /// The layout of an element.
        of: Box<Self>,
        /// The number of elements. Without a number, the list may have any length, and the length is sent before the elements.
        count: Option<usize>,
    },
}

/// A module whose interface comes from its Python program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AskedModule {
    /// The name of the module: `Keep`.
    pub name: String,
    /// The program and its arguments, in the form for [`words`](crate::plan::words). The last argument is the name of the module.
    pub exec: String,
    /// The variables and the folder of the program.
    pub environment: Environment,
}

impl AskedModule {
    /// Returns how the program is started, without the name of the module. It is the name of the source with the
    /// interfaces that the program prints.
    pub fn command(&self) -> &str {
        command_of(&self.exec, &self.name)
    }
}

/// Returns an `exec` without the name of its module, which is the last argument.
pub(crate) fn command_of<'a>(exec: &'a str, module: &str) -> &'a str {
    exec.strip_suffix(module).unwrap_or(exec).trim_end()
}

/// A record type that texts declare. Programs in other languages need it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordType {
    /// The name of the type: `Wrench`.
    pub name: String,
    /// The text of the doc comments of the type.
    pub doc: String,
    /// The fields in their order.
    pub fields: Vec<(String, FieldType)>,
}

/// The type of a field. Record types in it keep their names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FieldType {
    /// `Number`, `Force`, `Truth`, `Text`, `Bytes`, or a type of programs.
    Plain(String),
    /// A record type, by its name.
    Named(String),
    /// A record without a name.
    Record(Vec<(String, Self)>),
    /// Elements of one type.
    List {
        /// The type of an element.
        of: Box<Self>,
        /// The number of elements. Without a number, the list may have any length.
        count: Option<usize>,
    },
}
