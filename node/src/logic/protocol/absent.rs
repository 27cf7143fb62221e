//! Messages about hosts that do not answer.

use super::Deployment;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The answer to [`super::Request::Absent`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Absent {
    /// Hosts that were there and do not answer.
    pub hosts: Vec<AbsentHost>,
    /// Deployments that have ended, and that some host has not confirmed.
    pub ends: Vec<OpenEnd>,
    /// Processes of deployments that run, on hosts that do not answer.
    pub processes: Vec<AbsentProcess>,
}

/// A host that does not answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AbsentHost {
    /// Its name.
    pub host: String,
    /// How long ago its node answered last, or its link stood.
    #[serde(with = "comms::logic::human::seconds")]
    pub heard: Duration,
    /// Whether it counts as lost; else it is missing.
    pub lost: bool,
}

/// A deployment that has ended, as far as is known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenEnd {
    /// The deployment.
    pub deployment: Deployment,
    /// The host of `main`.
    pub home: String,
    /// The hosts that have not confirmed that nothing of it is left.
    pub hosts: Vec<OpenHost>,
}

/// A host that has not confirmed that nothing of a deployment is left there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OpenHost {
    /// Its name.
    pub host: String,
    /// Why the host has not confirmed it.
    pub why: Why,
    /// How long ago its node answered last, if the node does not answer now and was ever heard.
    #[serde(with = "comms::logic::human::seconds_if_known")]
    pub heard: Option<Duration>,
}

/// Why a host has not confirmed that nothing is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Why {
    /// The host was lost before the end.
    Lost,
    /// The host did not answer in time.
    Late,
    /// Its node could not end everything.
    Unable,
    /// The home was started again, and has not heard of it since.
    Restarted,
}

/// A process of which nothing is known, since its host does not answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AbsentProcess {
    /// Of which deployment.
    pub deployment: Deployment,
    /// The host.
    pub host: String,
    /// Absolute path.
    pub path: String,
    /// Its type.
    pub kind: String,
}
