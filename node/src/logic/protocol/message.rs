//! The messages on the link between two nodes.

use super::{Deployment, Relay, ToCoordinator, ToParticipant};
use serde::{Deserialize, Serialize};

/// From node to node, in order and once (see `link`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Message {
    /// The deployment that it is about.
    pub deployment: Deployment,
    /// The content.
    pub body: Body,
}

impl Message {
    /// Returns the last message of a node before it ends.
    pub fn leaves() -> Self {
        Self::about_none(Body::Leaves)
    }

    /// Returns a message about no deployment.
    pub fn about_none(body: Body) -> Self {
        Self { deployment: Deployment { name: String::new(), epoch: 0 }, body }
    }

    /// Returns a message to be passed on, or one that was.
    pub fn relay(relay: Relay) -> Self {
        Self::about_none(Body::Relay(Box::new(relay)))
    }

    /// Returns whether it is the last word about something: that a process has ended, that everything is to end, or that a host does not
    /// take part. Such a message is true however late it comes.
    pub fn is_final(&self) -> bool {
        matches!(
            self.body,
            Body::Participant(ToParticipant::Ended { .. } | ToParticipant::Loose { .. } | ToParticipant::Release)
                | Body::Coordinator(
                    ToCoordinator::Refused { .. } | ToCoordinator::Released | ToCoordinator::Unconfirmed
                )
        )
    }
}

/// The content of a message, by its receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Body {
    /// The deployment at its home.
    Coordinator(ToCoordinator),
    /// The deployment's part on the receiving host.
    Participant(ToParticipant),
    /// No receiver: it replaces a message that its sender has withdrawn.
    Tombstone,
    /// The node: the sender ends as it was told to, and nothing that it has started is left. About no deployment.
    Leaves,
    /// Another node, which the sender does not reach; or the receiver, from such a node. About no deployment.
    Relay(Box<Relay>),
    /// The node: this deployment, which has its home there, was stopped while it was away, and so were earlier ones of that name.
    Stopped,
    /// The node: the sender has received `Stopped`.
    Mourned,
    /// The node: the sender, a home, asks for a mark after all events that have happened there so far. About no deployment.
    Inquiry {
        /// The number of the question; the sender counts.
        number: u64,
    },
    /// The home: all events before its question have arrived before this message. About no deployment.
    Reported {
        /// The number of the question.
        number: u64,
    },
    /// The home: the sender was away for long, and begins nothing for this home before the home has answered. About no deployment.
    CheckIn {
        /// The number of the question; the sender counts.
        number: u64,
    },
    /// The node that has checked in: all decisions of the home have arrived before this message. About no deployment.
    CheckedIn {
        /// The number of the question.
        number: u64,
    },
}
