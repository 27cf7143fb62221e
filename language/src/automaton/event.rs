//! The events and commands of an automaton.

use crate::algebra::{Activation, Outcome, Value};
use std::time::Duration;

/// One thing that has happened to an activity: the input of [`step`](super::step()).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// The activity is started with a value.
    Start(Value),
    /// The activity is asked to stop.
    Stop,
    /// The run of a state has ended.
    Ended {
        /// The state.
        state: usize,
        /// The activation of the run that has ended.
        activation: Activation,
        /// How it has ended.
        outcome: Outcome,
    },
    /// A timer has run out.
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
        /// The numbers of the filters that let it through.
        filters: Vec<usize>,
        /// The priority; of messages that wait, a greater one comes first.
        priority: u8,
        /// The content.
        value: Value,
    },
    /// The surroundings have noticed something.
    Notice(usize),
    /// Too many runs have ended at once, one after the other: the activity ends.
    Overrun,
}

impl Event {
    /// Returns an empty message that no filter lets through.
    pub fn message(port: usize) -> Self {
        Self::Message { port, filters: Vec::new(), priority: 0, value: Value::EMPTY }
    }
}

/// One order of an activity. A step gives them in the order in which they are to be carried out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Start the run of a state.
    Run {
        /// The state.
        state: usize,
        /// The activation that begins.
        activation: Activation,
        /// The value that the run starts with.
        value: Value,
    },
    /// Stop the run of a state.
    Stop {
        /// The state.
        state: usize,
        /// The activation that is to stop.
        activation: Activation,
    },
    /// Deliver [`Event::Elapsed`] after this time.
    Arm {
        /// The transition that the timer is for.
        transition: usize,
        /// The number of this arming.
        activation: Activation,
        /// How long.
        after: Duration,
    },
    /// Forget a timer.
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
    /// Write a line for people.
    Log(String),
    /// A message was lost, because too many wait at its port.
    Lost {
        /// The number of the port.
        port: usize,
    },
}
