//! The records on the disks of nodes: of deployments that run, and of those that were stopped while their home was
//! away.

use super::{Deployment, Signed};
use language::plan::Plan;
use serde::{Deserialize, Serialize};

/// The record that a home keeps of a deployment for as long as the deployment is to run. A node that begins after a
/// reboot finds it.
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
    /// Whether it has ended because its node was told to leave. Callers were already told of this end.
    pub has_ended: bool,
    /// Whether it waits to be resumed: then the next node resumes it even in the same boot.
    pub waits: bool,
    /// The plan, and the request if a user has signed it; none if the deployment is not to be resumed.
    pub resume: Option<(Plan, Option<Signed>)>,
}

/// A deployment that ran when the node before this one ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Before {
    /// The record that was kept.
    pub kept: Kept,
    /// Whether the machine was rebooted since.
    pub was_rebooted: bool,
}

/// A tombstone: a deployment that a user has stopped while its home was away. The home does not know of the stop.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Tombstone {
    /// The host of `main`.
    pub home: String,
    /// The deployment. Earlier deployments of the same name are included.
    pub deployment: Deployment,
}

/// The state before its start that an agent is given.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Earlier {
    /// The deployments that ran, with their home here.
    pub running: Vec<Before>,
    /// The tombstones for other homes.
    pub tombstones: Vec<Tombstone>,
}
