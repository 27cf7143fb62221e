//! Named numbers that a program publishes for people and recorders, never for another controller.
//!
//! A program publishes its signals on `key::signals(robot, instance)` at any time, also while its
//! wires are closed. They describe themselves, so a recorder does not have to know the program.

use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The most values in one sample.
pub const VALUES_MAX: usize = 256;

/// The signal that counts missed deadlines of an activation.
pub const OVERRUNS: &str = "overruns";
/// The signal that counts values that were sent to inputs in an activation and did not arrive.
pub const LOST_VALUES: &str = "lost values";
/// The signal that counts values that were sent while their consumers were not connected. A consumer that is connected
/// again counts them itself, and then this number is 0.
pub const UNDELIVERED_VALUES: &str = "undelivered values";
/// The signal that counts the values that inputs have refused in an activation.
pub const REFUSED_VALUES: &str = "refused values";
/// The counts that every program with signals shows.
pub const COUNTS: [&str; 4] = [OVERRUNS, LOST_VALUES, REFUSED_VALUES, UNDELIVERED_VALUES];

/// One sample of a program's signals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Signals {
    /// On the publishing host's clock.
    pub stamp: Time,
    /// In a fixed order.
    pub values: Vec<Signal>,
}

/// The largest values since the previous sample, if no sample shows them. Published after the sample on the same key.
/// They are for summaries of how large a signal was, which must not miss a value between two samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Peaks {
    /// When the sample was taken, on the publishing host's clock.
    pub stamp: Time,
    /// For each such signal, the value of largest magnitude.
    pub values: Vec<Peak>,
}

/// A value that no sample shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Peak {
    /// The value.
    pub signal: Signal,
    /// How long before the sample the value occurred.
    pub age: Duration,
}

/// One named number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// The name for people: `door angle`.
    pub name: String,
    /// The unit: `deg`, `N`, `rad/s`; empty for none.
    pub unit: String,
    /// The value in that unit.
    pub value: f64,
    /// Whether the one-line progress display shows it.
    pub headline: bool,
}
