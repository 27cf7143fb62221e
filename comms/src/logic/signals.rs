//! Named scalars that a program publishes for people and recorders, never for another controller.
//!
//! Published on `key::signals(robot, instance)` whenever the program wants to, open wires or not. Self-describing, so
//! that a recorder needs to know nothing of the program.

use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The most values in one sample.
pub const VALUES_MAX: usize = 256;

/// The signal that counts missed deadlines of an activation.
pub const OVERRUNS: &str = "overruns";
/// The signal that counts the values that were sent to inputs in an activation and have not come.
pub const LOST_VALUES: &str = "lost values";
/// The signal that counts the values that inputs have refused in an activation.
pub const REFUSED_VALUES: &str = "refused values";

/// One sample of a program's signals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Signals {
    /// On the publishing host's clock.
    pub stamp: Time,
    /// In a fixed order.
    pub values: Vec<Signal>,
}

/// The largest values since the sample before, where a sample does not show them. Published after the sample on the
/// same key, for summaries of how large something was, which no sampling must miss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Peaks {
    /// When the sample was taken, on the publishing host's clock.
    pub stamp: Time,
    /// Of each such signal the value of largest magnitude.
    pub values: Vec<Peak>,
}

/// A value that no sample shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Peak {
    /// The value.
    pub signal: Signal,
    /// How long that was before the sample.
    pub age: Duration,
}

/// One named scalar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// The name for people: `door angle`.
    pub name: String,
    /// Its unit: `deg`, `N`, `rad/s`; empty for none.
    pub unit: String,
    /// Its value in that unit.
    pub value: f64,
    /// Whether it belongs on the one-line progress display.
    pub headline: bool,
}
