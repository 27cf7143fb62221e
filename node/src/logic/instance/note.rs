//! The reports of an instance to its deployment.

use crate::logic::protocol::{Change, Ending, LeafFacts};
use comms::logic::control::PortMessage;

/// A report of an instance to its deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// The program has started, and has reported its location.
    Prepared(LeafFacts),
    /// The program cannot take part, for this reason.
    Refused(String),
    /// The links of the program have been made.
    Connected,
    /// The program has carried out the switch of wires with this number.
    Switched(u64),
    /// The program expects the switch of its inputs that the order with this number announced.
    Expecting(u64),
    /// The program has carried out a switch of its inputs.
    Taken {
        /// The number of the order.
        ticket: u64,
        /// How many values have not arrived.
        lost: u64,
        /// How many values came too late.
        late: u64,
        /// The wires from which no value came.
        missing: Vec<u32>,
    },
    /// A message for an activity, from the program that has its ports.
    Message(PortMessage),
    /// The program has sent the value with this number for its activity.
    Sent(u64),
    /// An activation ended.
    Ended(u32, Ending),
    /// The stop of this activation could not be confirmed earlier, and its program has ended now.
    EndedLate(u32),
    /// A change, for the users who watch.
    Changed(Change),
    /// The program was started again and has another location now.
    Moved(LeafFacts),
    /// The program was started again and has made its links. Its wires are closed.
    Rejoined,
    /// The added links of a running program have been made, or the reason why they were not.
    Linked(Result<(), String>),
    /// The replacement of a program has started.
    Replaced,
    /// The replacement of a program has stayed healthy through its probation.
    Healthy,
    /// The replacement of a program has failed, for this reason.
    Unhealthy(String),
    /// Nothing of the program is left.
    Gone,
}
