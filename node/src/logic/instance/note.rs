//! The reports of an instance to its deployment.

use crate::logic::protocol::{Change, Ending, LeafFacts};
use comms::logic::control::PortMessage;

/// A report of an instance to its deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// The program is up and has told where it is.
    Prepared(LeafFacts),
    /// The program cannot take part, and why.
    Refused(String),
    /// Its links stand.
    Connected,
    /// The program has switched the wires of this generation.
    Switched(u64),
    /// The program expects a switch of its inputs, by the number of the order.
    Expecting(u64),
    /// The program has taken a switch of its inputs.
    Taken {
        /// The number of the order.
        ticket: u64,
        /// Values that have not arrived.
        lost: u64,
        /// Values that came too late.
        late: u64,
        /// Wires that nothing was heard of.
        missing: Vec<u32>,
    },
    /// A message for the activity whose ports the program has.
    Message(PortMessage),
    /// The program has sent the value of this number for its activity.
    Sent(u64),
    /// An activation ended.
    Ended(u32, Ending),
    /// The stop of this activation could not be confirmed, and its program has ended now.
    EndedLate(u32),
    /// A change, for the users who watch.
    Changed(Change),
    /// The program was started again and is somewhere else now.
    Moved(LeafFacts),
    /// The program was started again and its links stand; its wires are closed.
    Rejoined,
    /// Links that were added while it runs stand, or why not.
    Linked(Result<(), String>),
    /// The replacement of a program is up.
    Replaced,
    /// The replacement of a program has stayed healthy through its probation.
    Healthy,
    /// The replacement of a program has failed, and why.
    Unhealthy(String),
    /// Nothing of the program is left.
    Gone,
}
