//! What a node says of itself and of what runs there.

use super::Deployment;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The answer to [`super::Request::Status`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeStatus {
    /// The node's name.
    pub host: String,
    /// The node's process id.
    pub pid: u32,
    /// Version of DCA.
    pub version: String,
    /// How long it has been up.
    #[serde(with = "comms::logic::human::seconds")]
    pub up: Duration,
    /// Other nodes that it can reach.
    pub peers: Vec<String>,
    /// Deployments with a part here.
    pub deployments: Vec<DeploymentStatus>,
}

/// A deployment as one host sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeploymentStatus {
    /// Which.
    pub deployment: Deployment,
    /// The host of `main`.
    pub home: String,
    /// `preparing`, `connecting`, `running`, `ending`.
    pub phase: String,
    /// Groups and leaves of this host.
    pub processes: Vec<ProcessStatus>,
}

/// A process as its host sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessStatus {
    /// Absolute path.
    pub path: String,
    /// Its type.
    pub kind: String,
    /// `starting`, `idle`, `running`, `stopping`, `dead: SIGSEGV` …
    pub state: String,
    /// Process id of a leaf's program.
    pub pid: Option<u32>,
}
