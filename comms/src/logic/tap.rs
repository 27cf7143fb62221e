//! Values of an output as people look at them while a robot works: `dca echo`, `dca hz`.
//!
//! A program publishes each value that leaves an output on `key::tap(robot, instance, output)`, whether wires are open or not, and
//! only while somebody listens. On `key::outputs(robot, instance)` it answers which outputs it has.

use crate::logic::time::Time;
use serde::{Deserialize, Serialize};

/// A value as it left its output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tapped {
    /// How many values have left this output since the program's start, this one included. A gap means values that were lost on
    /// the way to the listener.
    pub number: u64,
    /// When it left, on the clock of the program's host.
    pub stamp: Time,
    /// The value, as it goes over wires.
    pub bytes: Vec<u8>,
}

/// The outputs of a program.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outputs {
    /// In order of declaration; those to devices, too.
    pub outputs: Vec<OutputType>,
}

/// An output and the type of its values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputType {
    /// The output: `Out`, or a device key as `arm/state`.
    pub name: String,
    /// The type of the values: `Wrench`.
    pub type_name: String,
    /// The fields of that type, as a spec spells them; empty if it does not name them.
    pub fields: String,
}
