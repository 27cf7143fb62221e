//! The recorded values of wires, in the form that a replay reads.

use std::time::Duration;

/// A value of a wire, in the form of the record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordedValue {
    /// Path of the producer and its output: `main/force/Out`.
    pub from: String,
    /// Path of the consumer and its input.
    pub to: String,
    /// When the value came, since GO.
    pub at: Duration,
    /// The form of the data.
    pub form: ValueForm,
    /// The value.
    pub data: Vec<u8>,
}

/// The form of a recorded value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueForm {
    /// JSON: the fields of the value, or all its bytes.
    Json,
    /// The CDR of a message of ROS 2.
    Cdr,
}
