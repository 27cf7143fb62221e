//! The ping asks whether a node is present, and the pong is the answer. Also messages between two nodes with the same name.

use super::Deployment;
use comms::logic::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The question to all other nodes whether they are present.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ping {
    /// Name of the asking node.
    pub from: String,
    /// Its boot number.
    pub boot: u64,
    /// The number of the question.
    pub round: u64,
}

/// The answer to a [`Ping`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pong {
    /// Name of the answering node.
    pub from: String,
    /// Its boot number.
    pub boot: u64,
    /// Boot number of the node that asked.
    pub to_boot: u64,
    /// The number of the question.
    pub round: u64,
    /// How long it has been running.
    pub up: Duration,
    /// Where it runs, for a person: machine and process id.
    pub place: String,
    /// The boot that holds the asking node's name here, if any. A node communicates with only one boot of each name.
    pub holder: Option<u64>,
    /// Its session, with the same id as in a [`Dial`](comms::logic::control::Dial).
    pub session: String,
    /// Identifies its machine, its network and its run folder. Two boots with the same origin never run at once,
    /// because a node locks its folder.
    pub origin: u32,
}

/// A message of a node to another node of its name: which deployments it runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Namesake {
    /// Boot number of the sender.
    pub boot: u64,
    /// Boot number of the other node.
    pub to_boot: u64,
    /// The deployments with a part on the sender, and whether it reaches the home of each.
    pub deployments: Vec<(Deployment, bool)>,
    /// The deployments that the sender has ended because they continue on the other node.
    pub ended: Vec<Deployment>,
}

/// A message of a node to the sender of a message that it has refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// Name of the node that has refused the message.
    pub by: String,
    /// The reason, for a person.
    pub why: String,
}

/// The position of a node's audit log. It is signed by this node for others, or by another node for this one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditHead {
    /// The name of the sending node.
    pub from: String,
    /// The bytes of a [`trust::audit::Head`].
    pub head: Vec<u8>,
}

/// The certificate of a node. Either the sender asks the others to renew it, or it has renewed the certificate.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Renewing {
    /// The name of the sending node.
    pub from: String,
    /// The bytes of a [`trust::team::Credential`].
    pub credential: Vec<u8>,
}

/// A name that two nodes share.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Duplicate {
    /// The name.
    pub host: String,
    /// Where the node runs that other nodes communicate with, for a person.
    pub first: String,
    /// Where the other node runs.
    pub second: String,
}

impl Enveloped for Namesake {
    const KIND: Kind = Kind::Namesake;
    const SIZE_MAX: usize = 64 << 10;
}

impl Enveloped for Refusal {
    const KIND: Kind = Kind::Refusal;
    const SIZE_MAX: usize = 4 << 10;
}

impl Enveloped for AuditHead {
    const KIND: Kind = Kind::AuditHead;
    const SIZE_MAX: usize = 4 << 10;
}

impl Enveloped for Renewing {
    const KIND: Kind = Kind::Renewing;
    const SIZE_MAX: usize = 4 << 10;
}

impl Enveloped for Ping {
    const KIND: Kind = Kind::Ping;
    const SIZE_MAX: usize = 1 << 10;
}

impl Enveloped for Pong {
    const KIND: Kind = Kind::Pong;
    const SIZE_MAX: usize = 4 << 10;
}
