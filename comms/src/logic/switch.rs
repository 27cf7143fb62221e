//! Switching wires while data flows: nothing is lost, doubled or taken in the wrong order.
//!
//! A producer flips all its wires of one switch at once, between two values. It marks this in band: the last message on
//! a wire that is closed is [`Boundary::Closed`], the first on a wire that is opened [`Boundary::Opened`]. The consumer
//! takes all values up to the end of the old wires, and holds back the values of the new ones until then ([`Intake`]).
//!
//! A switch has a *generation*, the same for all who take part in it. Boundaries may be repeated at will.

mod flow;
mod gaps;
mod intake;

use crate::logic::codec::{Enveloped, Kind};
pub use flow::Flow;
pub use gaps::{Gaps, PublisherId, Sequence};
pub use intake::{Arrival, Intake, Passed, Taken};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How long values of new wires are held back for the end of the old ones. Then they pass, and later values of the old
/// ones are dropped.
pub const HOLD_WITHIN: Duration = Duration::from_secs(1);

/// A word in band, between the values of a wire.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Boundary {
    /// The following values were sent after the wire was opened; on a wire that was already open, after all others were
    /// flipped.
    Opened {
        /// The switch; 0 for a wire that was opened without one.
        generation: u64,
        /// Wires to the same consumer that the switch closes: their values come first.
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

/// The wires of one producer that a switch flips, all between the same two values.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Flip {
    /// The switch.
    pub generation: u64,
    /// Wires to close.
    pub close: Vec<u32>,
    /// Wires to open.
    pub open: Vec<Opening>,
}

/// A wire that a switch opens. A wire that is already open only gets the boundary.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Opening {
    /// Number of the wire.
    pub wire: u32,
    /// Wires to the same consumer that the switch closes.
    pub after: Vec<u32>,
}

/// The end of a switch that a consumer has to expect.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Expect {
    /// The switch.
    pub generation: u64,
    /// Its inputs that are closed.
    pub close: Vec<u32>,
    /// Its inputs that are opened.
    pub open: Vec<u32>,
}
