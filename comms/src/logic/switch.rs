//! Switching wires while data flows: no value is lost, duplicated or taken in the wrong order.
//!
//! A producer flips all wires of one switch at once, between two values, and marks this in the data. The last message
//! on a closed wire is [`Boundary::Closed`], the first on an opened wire is [`Boundary::Opened`]. The consumer takes
//! all values up to the end of the old wires, and holds back the values of the new wires until then ([`Intake`]).
//!
//! A switch has a *generation*, which is the same for all programs that take part. Boundaries may be repeated.

mod flow;
mod gaps;
mod intake;

use crate::logic::codec::{Enveloped, Kind};
pub use flow::Flow;
pub use gaps::{Gaps, PublisherId, Sequence};
pub use intake::{Arrival, Intake, Passed, Taken};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How long values of new wires are held back for the end of the old wires. After that time they pass, and later values
/// of the old wires are dropped.
pub const HOLD_WITHIN: Duration = Duration::from_secs(1);

/// A control message between the values of a wire.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Boundary {
    /// The following values were sent after the wire was opened. On a wire that was already open, they were sent after
    /// all other wires of the switch were flipped.
    Opened {
        /// The switch; 0 for a wire that was opened without one.
        generation: u64,
        /// The wires to the same consumer that the switch closes. The values of these wires come first.
        after: Vec<u32>,
    },
    /// Nothing more comes.
    Closed {
        /// The switch; 0 for a wire that was closed without one.
        generation: u64,
        /// How many values were sent since the wire was opened.
        sent: u64,
    },
}

impl Enveloped for Boundary {
    const KIND: Kind = Kind::Boundary;
    const SIZE_MAX: usize = 64 << 10;
}

/// The wires of one producer that a switch flips, all of them between the same two values.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flip {
    /// The switch.
    pub generation: u64,
    /// Wires to close.
    pub close: Vec<u32>,
    /// Wires to open.
    pub open: Vec<Opening>,
}

/// A wire that a switch opens. A wire that is already open gets only the boundary.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Opening {
    /// Number of the wire.
    pub wire: u32,
    /// Wires to the same consumer that the switch closes.
    pub after: Vec<u32>,
}

/// A switch of inputs that a consumer has to expect.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Expect {
    /// The switch.
    pub generation: u64,
    /// The inputs that the switch closes.
    pub close: Vec<u32>,
    /// The inputs that the switch opens.
    pub open: Vec<u32>,
}
