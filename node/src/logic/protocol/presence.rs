//! The ping and the pong: the question whether a node is there, and its answer. Also the messages between two nodes of
//! one name.

use super::Deployment;
use comms::logic::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The question whether a node is there, to all others.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ping {
    /// Name of the asking node.
    pub from: String,
    /// Its boot number.
    pub boot: u64,
    /// Numbers the question.
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
    /// The question's number.
    pub round: u64,
    /// How long it has been up.
    pub up: Duration,
    /// Where it runs, for a person: machine and process id.
    pub place: String,
    /// The boot that has the asker's name here, if any: a node deals with one boot of each name.
    pub holder: Option<u64>,
    /// Its session, as in a [`Dial`](comms::logic::control::Dial).
    pub session: String,
    /// Stands for its machine, its network and its run folder. Two boots with the same origin never run at once: a node locks its folder.
    pub origin: u32,
}

/// The report of a node to another one of its name: the deployments it runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Namesake {
    /// Boot number of the sender.
    pub boot: u64,
    /// Boot number of the other one.
    pub to_boot: u64,
    /// The deployments that it has a part of, and whether it reaches the home of each.
    pub deployments: Vec<(Deployment, bool)>,
    /// The deployments that the sender has ended, because they continue on the other node.
    pub ended: Vec<Deployment>,
}

/// The message of a node to another one whose message it has refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// Name of the node that has refused it.
    pub by: String,
    /// Why, for a person.
    pub why: String,
}

/// The position of the audit log of a node, signed by this node for others, or by another node for this one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditHead {
    /// The name of the sending node.
    pub from: String,
    /// The form of a [`trust::audit::Head`].
    pub head: Vec<u8>,
}

/// The certificate of a node: the sender asks the others to renew it, or has renewed it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Renewing {
    /// The name of the sending node.
    pub from: String,
    /// The form of a [`trust::team::Credential`].
    pub credential: Vec<u8>,
}

/// A name that two nodes have.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Duplicate {
    /// The name.
    pub host: String,
    /// Where the node is that other nodes deal with, for a person.
    pub first: String,
    /// Where the other one is.
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
