//! Messages that a node passes on between two other nodes that do not reach each other.

use super::Message;
use crate::logic::link::Ends;
use serde::{Deserialize, Serialize};

/// A message from one node to another, by way of a third node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Relay {
    /// Name of the sender.
    pub from: String,
    /// Name of the receiver.
    pub to: String,
    /// The content.
    pub what: Relayed,
    /// In a team, the signature of the sender: the node that passes the message on cannot sign for the sender. Empty outside a team.
    pub proof: Vec<u8>,
}

/// The content of a relay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Relayed {
    /// The question whether a node is present, as in a [`Ping`](super::Ping).
    Ping {
        /// Boot number of the node that asks.
        boot: u64,
        /// The number of the question.
        round: u64,
    },
    /// The answer, as in a [`Pong`](super::Pong).
    Pong {
        /// Boot number of the node that answers.
        boot: u64,
        /// Boot number of the node that asked.
        to_boot: u64,
        /// The number of the question.
        round: u64,
        /// The boot that holds the asking node's name here, if any.
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
