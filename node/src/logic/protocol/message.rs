//! The messages on the link between two nodes.

use super::{Deployment, Relay, ToCoordinator, ToParticipant};
use serde::{Deserialize, Serialize};

/// A message from node to node. Messages arrive in order and exactly once (see `link`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Message {
    /// The deployment that it is about.
    pub deployment: Deployment,
    /// The content.
    pub body: Body,
}

impl Message {
    /// Returns the last message of a node that is about to end.
    pub fn leaves() -> Self {
        Self::about_none(Body::Leaves)
    }

    /// Returns a message about no deployment.
    pub fn about_none(body: Body) -> Self {
        Self { deployment: Deployment { name: String::new(), epoch: 0 }, body }
    }

    /// Returns a message that has to be passed on, or that was passed on.
    pub fn relay(relay: Relay) -> Self {
        Self::about_none(Body::Relay(Box::new(relay)))
    }

    /// Returns whether the message is final: a process has ended, everything has to end, or a host does not take part.
    /// Such a message stays true, even if it arrives late.
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

/// The content of a message. Each variant has another receiver.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Body {
    /// For the home of the deployment.
    Coordinator(ToCoordinator),
    /// For the deployment's part on the receiving host.
    Participant(ToParticipant),
    /// For no receiver: the sender has withdrawn the original message.
    Tombstone,
    /// For the node: the sender ends on request, and nothing that it has started is left. This is about no deployment.
    Leaves,
    /// To pass on to another node that the sender does not reach, or for the receiver from such a node. This is about no deployment.
    Relay(Box<Relay>),
    /// For the node that is the home of this deployment: the deployment, and earlier ones of its name, were stopped
    /// while the node could not be reached.
    Stopped,
    /// For the node: the sender has received `Stopped`.
    Mourned,
    /// For the node: the sender is a home. It asks for a mark after all events that have happened on the receiver so
    /// far. This is about no deployment.
    Inquiry {
        /// The number of the question. The sender counts its questions.
        number: u64,
    },
    /// For the home: all events from before its question have arrived before this message. This is about no deployment.
    Reported {
        /// The number of the question.
        number: u64,
    },
    /// For the home: the sender was away for long. It begins nothing for this home until the home has answered. This is
    /// about no deployment.
    CheckIn {
        /// The number of the question. The sender counts its questions.
        number: u64,
    },
    /// For the node that has checked in: all decisions of the home have arrived before this message. This is about no deployment.
    CheckedIn {
        /// The number of the question.
        number: u64,
    },
}
