//! Messages that a node passes on between two other nodes that do not reach each other.

use super::Message;
use crate::logic::link::Ends;
use serde::{Deserialize, Serialize};

/// Something from one node to another, by way of a third.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Relay {
    /// Name of the node that it is from.
    pub from: String,
    /// Name of the node that it is for.
    pub to: String,
    /// The content.
    pub what: Relayed,
    /// In a team, the signature of the sender: the node that passes the message on does not speak for the sender. Empty
    /// elsewhere.
    pub proof: Vec<u8>,
}

/// The content of a relay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Relayed {
    /// The question whether a node is there, as in a [`Ping`](super::Ping).
    Ping {
        /// Boot number of the node that asks.
        boot: u64,
        /// Numbers the question.
        round: u64,
    },
    /// The answer, as in a [`Pong`](super::Pong).
    Pong {
        /// Boot number of the node that answers.
        boot: u64,
        /// Boot number of the node that asked.
        to_boot: u64,
        /// The question's number.
        round: u64,
        /// The boot that has the asker's name here, if any has.
        holder: Option<u64>,
    },
    /// A frame of the link between the two.
    Frame {
        /// Boot number of the sender.
        boot: u64,
        /// Boot number of the receiver, as the sender knows it.
        boot_peer: u64,
        /// The two ends of the link.
        ends: Ends,
        /// All messages up to this number have arrived at the sender.
        acknowledged: u64,
        /// A numbered message.
        message: Option<(u64, Box<Message>)>,
    },
}
