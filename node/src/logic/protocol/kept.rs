//! What is kept on the disks of nodes of deployments that run, and of those that were stopped while their home was away.

use super::{Deployment, Signed};
use language::plan::Plan;
use serde::{Deserialize, Serialize};

/// What a home keeps of a deployment for as long as it is to run: a node that begins after a reboot finds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// The deployment.
    pub deployment: Deployment,
    /// The epoch under which a user has deployed it: an earlier one than its own once it was resumed.
    pub origin: u64,
    /// The user.
    pub by: String,
    /// The hosts that take part, that of `main` first.
    pub hosts: Vec<String>,
    /// Whether it has come to an end, since its node was told to leave: that was told.
    pub has_ended: bool,
    /// Whether it waits to be resumed: then the next node resumes it in the same boot, too.
    pub waits: bool,
    /// The plan, and the request if a user has signed it: nothing of what is not to be resumed.
    pub resume: Option<(Plan, Option<Signed>)>,
}

/// A deployment that ran when the node before this one ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Before {
    /// What was kept of it.
    pub kept: Kept,
    /// Whether the machine was rebooted since.
    pub was_rebooted: bool,
}

/// A tombstone: a deployment that a user has stopped while its home was away, which does not know of that.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Tombstone {
    /// The host of `main`.
    pub home: String,
    /// The deployment; those of the same name that were deployed before it are meant, too.
    pub deployment: Deployment,
}

/// What an agent is told at its start of the time before it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Earlier {
    /// The deployments that ran, with their home here.
    pub running: Vec<Before>,
    /// The tombstones for other homes.
    pub tombstones: Vec<Tombstone>,
}
