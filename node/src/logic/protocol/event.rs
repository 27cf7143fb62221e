//! The events that listeners to everything hear.

use super::{Deployment, Report};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A report of a deployment, as its home tells it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Of which deployment.
    pub deployment: Deployment,
    /// Its number among the reports of the deployment, from 0 on: an event that is repeated has the same number.
    pub number: u64,
    /// The host of the event; the host of `main` for an event about all.
    pub host: String,
    /// The age of the event when it was sent. It orders events even if the clocks of two homes differ.
    #[serde(with = "comms::logic::human::seconds")]
    pub ago: Duration,
    /// The event.
    pub report: Report,
    /// When it was, for users: since 1970, by the calendar clock of the home when it noted the event. Each answer has
    /// the same time.
    #[serde(with = "comms::logic::human::seconds")]
    pub time: Duration,
}
