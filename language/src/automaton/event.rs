//! The events and commands of an automaton.

use crate::algebra::{Activation, Outcome, Value};
use std::time::Duration;

/// An event of an activity: the input of [`step`](super::step()).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// The activity is started with a value.
    Start(Value),
    /// The activity is asked to stop.
    Stop,
    /// The run of a state has ended.
    Ended {
        /// The state whose run has ended.
        state: usize,
        /// The activation of the run that has ended.
        activation: Activation,
        /// The outcome of the run.
        outcome: Outcome,
    },
    /// The time of a timer has passed.
    Elapsed {
        /// The transition that the timer is for.
        transition: usize,
        /// The arming of the timer that has elapsed.
        activation: Activation,
    },
    /// A message has arrived.
    Message {
        /// The number of the port.
        port: usize,
        /// The numbers of the filters that let the message through.
        filters: Vec<usize>,
        /// The priority. Of the waiting messages, the message with the greatest priority comes first.
        priority: u8,
        /// The content.
        value: Value,
    },
    /// An event outside the activity, by the number of the notice.
    Notice(usize),
    /// Too many runs have ended at once, one after the other. The activity ends.
    Overrun,
}

impl Event {
    /// Returns an empty message that no filter lets through.
    pub fn message(port: usize) -> Self {
        Self::Message { port, filters: Vec::new(), priority: 0, value: Value::EMPTY }
    }
}

/// A command of an activity. The caller carries out the commands of a step in their order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Start the run of a state.
    Run {
        /// The state whose run starts.
        state: usize,
        /// The number of the new activation.
        activation: Activation,
        /// The value that the run starts with.
        value: Value,
    },
    /// Stop the run of a state.
    Stop {
        /// The state whose run stops.
        state: usize,
        /// The number of the activation that stops.
        activation: Activation,
    },
    /// Deliver [`Event::Elapsed`] after this time.
    Arm {
        /// The transition that the timer is for.
        transition: usize,
        /// The number of this arming.
        activation: Activation,
        /// The time from now.
        after: Duration,
    },
    /// Cancel a timer.
    Cancel {
        /// The transition that the timer is for.
        transition: usize,
        /// The number of the arming that is cancelled.
        activation: Activation,
    },
    /// Send a value.
    Send {
        /// The number of the output port.
        output: usize,
        /// The value.
        value: Value,
    },
    /// Write a line that people read.
    Log(String),
    /// Report a lost message: too many messages wait at its port.
    Lost {
        /// The number of the port.
        port: usize,
    },
}
