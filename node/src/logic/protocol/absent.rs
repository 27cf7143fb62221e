//! Messages about hosts that do not answer.

use super::Deployment;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The answer to [`super::Request::Absent`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Absent {
    /// Hosts that were present earlier and do not answer now.
    pub hosts: Vec<AbsentHost>,
    /// Deployments that have ended, if some host has not confirmed the end.
    pub ends: Vec<OpenEnd>,
    /// Processes of running deployments on hosts that do not answer.
    pub processes: Vec<AbsentProcess>,
}

/// A host that does not answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AbsentHost {
    /// Its name.
    pub host: String,
    /// How long ago its node last answered, or its link was last up.
    #[serde(with = "comms::logic::human::seconds")]
    pub heard: Duration,
    /// Whether it counts as lost. Otherwise it is missing.
    pub lost: bool,
}

/// A deployment that has ended, as far as is known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenEnd {
    /// The deployment.
    pub deployment: Deployment,
    /// The host of `main`.
    pub home: String,
    /// The hosts that have not confirmed that nothing of the deployment is left.
    pub hosts: Vec<OpenHost>,
}

/// A host that has not confirmed that nothing of a deployment is left there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenHost {
    /// Its name.
    pub host: String,
    /// Why the host has not confirmed this.
    pub why: Why,
    /// How long ago its node last answered. Nothing if the node answers now, or has never answered.
    #[serde(with = "comms::logic::human::seconds_if_known")]
    pub heard: Option<Duration>,
}

/// Why a host has not confirmed that nothing of a deployment is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Why {
    /// The host was lost before the end.
    Lost,
    /// The host did not answer in time.
    Late,
    /// Its node could not end everything.
    Unable,
    /// The home was restarted, and has had no contact with the host since then.
    Restarted,
}

/// A process whose state is unknown, because its host does not answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AbsentProcess {
    /// The deployment of the process.
    pub deployment: Deployment,
    /// The host.
    pub host: String,
    /// Absolute path.
    pub path: String,
    /// Its type.
    pub kind: String,
}
