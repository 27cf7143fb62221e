//! The changes of other nodes that a node reports, and the words for them.

use super::LOST_AFTER;
use comms::logic::human::span;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A change of another node, for the agent and for users.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Change {
    /// A node that did not answer before answers now.
    Appeared {
        /// Its name.
        host: String,
        /// Its boot number.
        boot: u64,
        /// Where it runs, for a person: its machine and process.
        place: String,
        /// Whether another boot had the name before. The state of that boot is lost.
        replaces: bool,
    },
    /// A node does not answer any more.
    Missing {
        /// The name of the node.
        host: String,
        /// Since when it is missing.
        since: Time,
        /// The reason, for a person.
        why: String,
    },
    /// A node has been missing for too long.
    Lost {
        /// Its name.
        host: String,
    },
    /// A node does not answer directly. Another node passes messages on in both directions.
    Detour {
        /// Its name.
        host: String,
        /// Its boot number.
        boot: u64,
        /// The name of the other node.
        via: String,
    },
    /// A second node uses a name that is taken.
    Refused {
        /// The name.
        host: String,
        /// Where the second node runs.
        place: String,
        /// Where the first node runs.
        first: String,
    },
    /// Another node has the name of this node.
    Namesake {
        /// Where the other node runs.
        place: String,
        /// Whether the other node was present first.
        elder: bool,
    },
    /// A deployment runs here and on another node with the name of this node.
    Twice {
        /// The name and the epoch of the deployment.
        deployment: String,
        /// Where the other node runs.
        place: String,
        /// Whether the deployment continues here.
        keeps: bool,
    },
}

impl Change {
    /// Returns whether the change is harmless.
    pub fn is_good(&self) -> bool {
        matches!(self, Self::Appeared { .. })
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Appeared { host, place, replaces: false, .. } => write!(f, "the node `{host}` is there: {place}"),
            Self::Appeared { host, place, .. } => write!(f, "the node `{host}` was started again: {place}"),
            Self::Missing { host, why, .. } => write!(f, "the node `{host}` is missing: {why}"),
            Self::Lost { host } => write!(f, "the node `{host}` is lost: it did not answer for {}", span(LOST_AFTER)),
            Self::Detour { host, via, .. } => {
                write!(f, "the node `{host}` does not answer directly; `{via}` reaches it and passes messages on")
            }
            Self::Refused { host, place, first } => write!(
                f,
                "ignoring a second node called `{host}` ({place}), because the first node ({first}) still runs; give the second node \
                 another name with `dca-node --name`"
            ),
            Self::Namesake { place, elder: true } => {
                write!(f, "another node has the name of this node, and was here first: {place}")
            }
            Self::Twice { deployment, place, keeps } => {
                let ends = if *keeps { "there" } else { "here" };
                write!(
                    f,
                    "`{deployment}` also runs on another node with the name of this node ({place}): the deployment is ended {ends}"
                )
            }
            Self::Namesake { place, elder: false } => {
                write!(f, "ignoring another node that has the name of this node: {place}; give that node another name")
            }
        }
    }
}
