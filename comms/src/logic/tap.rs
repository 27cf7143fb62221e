//! Values of an output for people who watch a running robot: `dca echo`, `dca hz`.
//!
//! A program publishes each value that leaves an output on `key::tap(robot, instance, output)`. It does so whether
//! wires are open or not, but only while there is a subscriber. On `key::outputs(robot, instance)` it lists its
//! outputs. An in-process group also publishes the outputs of its members that lead to other members.

use crate::logic::time::Time;
use serde::{Deserialize, Serialize};

/// A value at the time when it left its output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tapped {
    /// How many values have left this output since the program's start, including this one. A gap means that values
    /// were lost on the way to the listener.
    pub number: u64,
    /// When the value left, on the clock of the program's host.
    pub stamp: Time,
    /// The encoded value, as on wires.
    pub bytes: Vec<u8>,
}

/// The outputs of a program.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outputs {
    /// The outputs in order of declaration, including those to devices.
    pub outputs: Vec<OutputType>,
    /// In an in-process group: the outputs of members that lead to other members.
    pub inner: Vec<InnerOutput>,
}

impl Outputs {
    /// Returns all outputs that can be watched: first the outputs of the program, then the outputs of its members.
    pub fn all(&self) -> impl Iterator<Item = &OutputType> {
        self.outputs.iter().chain(self.inner.iter().map(|inner| &inner.output))
    }
}

/// An output of a member of an in-process group, and where its values go inside.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct InnerOutput {
    /// The output. Its name begins with the member: `smooth.Out`.
    pub output: OutputType,
    /// The inputs that receive its values, in the order of the wires: `limit.In`.
    pub inputs: Vec<String>,
}

/// An output and the type of its values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputType {
    /// The output: `Out`, a device key such as `arm/state`, or `member.Out` inside an in-process group.
    pub name: String,
    /// The type of the values: `Wrench`.
    pub type_name: String,
    /// The fields of that type, as a spec spells them; empty if the output does not name them.
    pub fields: String,
}
