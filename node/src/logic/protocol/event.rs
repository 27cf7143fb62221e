//! The events that callers get who listen to all deployments.

use super::{Deployment, Report};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A report of a deployment, sent by its home.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// The deployment.
    pub deployment: Deployment,
    /// Its number among the reports of the deployment, counted from 0. If an event is sent again, it has the same number.
    pub number: u64,
    /// The host of the event. For an event about all hosts, the host of `main`.
    pub host: String,
    /// The age of the event when it was sent. It orders events even if the clocks of two homes differ.
    #[serde(with = "comms::logic::human::seconds")]
    pub ago: Duration,
    /// The event.
    pub report: Report,
    /// When it happened, for users: the time since 1970 on the calendar clock of the home when it noted the event. The
    /// event has the same time in every answer.
    #[serde(with = "comms::logic::human::seconds")]
    pub time: Duration,
}
