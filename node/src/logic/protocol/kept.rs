//! Records on the disks of nodes: about running deployments, and about deployments that were stopped while their home
//! could not be reached.

use super::{Deployment, Signed};
use language::plan::Plan;
use serde::{Deserialize, Serialize};

/// The record of a deployment on the disk of its home, until the deployment has to end. After a reboot, the next node finds the record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// The deployment.
    pub deployment: Deployment,
    /// The epoch under which a user has deployed it. If the deployment was resumed, this is an earlier epoch than its own.
    pub origin: u64,
    /// The user who has deployed it.
    pub by: String,
    /// The participating hosts, the host of `main` first.
    pub hosts: Vec<String>,
    /// Whether it has ended because its node had to end. Callers have already been told of this end.
    pub has_ended: bool,
    /// Whether it waits to be resumed. Then the next node resumes it, even without a reboot.
    pub waits: bool,
    /// The plan, and the request if a user has signed it. Nothing if the deployment should not be resumed.
    pub resume: Option<(Plan, Option<Signed>)>,
}

/// A deployment that ran when the previous node ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Before {
    /// The record that was kept.
    pub kept: Kept,
    /// Whether the machine was rebooted since then.
    pub was_rebooted: bool,
}

/// A tombstone says that a user has stopped a deployment while its home could not be reached. The home does not know of the stop.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Tombstone {
    /// The host of `main`.
    pub home: String,
    /// The deployment. Earlier deployments of the same name count as stopped as well.
    pub deployment: Deployment,
}

/// The state from before its start that an agent gets.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Earlier {
    /// The deployments with their home here that ran.
    pub running: Vec<Before>,
    /// The tombstones for other homes.
    pub tombstones: Vec<Tombstone>,
}
