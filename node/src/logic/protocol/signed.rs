//! A request that a user has signed, and the orders that the home of a deployment gives because of it. The request is
//! sent together with each order. So each node that carries out an order can check the user's request itself.

use super::{ChangeOrder, Request, ToParticipant};
use comms::logic::codec::{self, CodecError};
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A request with the signature of a user.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signed {
    /// The signed part and the signer, in the form of `trust::request`.
    pub head: Vec<u8>,
    /// The payload: a [`Request`] in its envelope.
    pub body: Vec<u8>,
}

impl Signed {
    /// Returns the request. Its signature is not checked.
    ///
    /// # Errors
    /// The body is not a request.
    pub fn request(&self) -> Result<Request, CodecError> {
        codec::decode(&self.body)
    }

    /// Returns the plan in the request, if it contains one.
    pub fn plan(&self) -> Option<Plan> {
        match self.request() {
            Ok(Request::Deploy { plan, .. }) => Some(plan),
            Ok(Request::Change(change)) => Some(change.plan),
            _ => None,
        }
    }
}

/// An order that starts something, together with the request of a user for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ordered {
    /// The request of the user, with the signature.
    pub by: Signed,
    /// The order.
    pub order: Order,
}

/// An order that starts something.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Order {
    /// [`ToParticipant::Prepare`], with the plan that was signed.
    Prepare,
    /// [`ToParticipant::Rejoin`].
    Rejoin {
        /// The same as there.
        plan: Plan,
        /// The same as there.
        number: u32,
        /// The same as there.
        since_go: Duration,
    },
    /// [`ToParticipant::Change`].
    Change(ChangeOrder),
}

/// The team of a node, for users who sign requests.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TeamOfNode {
    /// The id of the team's key.
    pub id: [u8; 32],
    /// The name of the team.
    pub name: String,
    /// The name in the node's certificate.
    pub node: String,
}

impl ToParticipant {
    /// Returns whether a node of a team carries out this order only with a user's signature.
    pub const fn starts(&self) -> bool {
        matches!(
            self,
            Self::Prepare { .. }
                | Self::Rejoin { .. }
                | Self::Change(ChangeOrder::Examine { .. } | ChangeOrder::Apply { .. })
                | Self::Ordered(_)
        )
    }

    /// Adds the user's request to an order that starts something, if there is a request.
    #[must_use]
    pub fn signed(self, by: Option<&Signed>) -> Self {
        let Some(by) = by.filter(|_| self.starts()) else { return self };
        let order = if let Self::Rejoin { plan, number, since_go } = self {
            Order::Rejoin { plan, number, since_go }
        } else if let Self::Change(order) = self {
            Order::Change(order)
        } else if matches!(self, Self::Prepare { .. }) {
            Order::Prepare
        } else {
            return self;
        };
        Self::Ordered(Box::new(Ordered { by: by.clone(), order }))
    }

    /// Returns the order without the request. Returns nothing if the order needs a plan, and the request contains none.
    pub fn plain(self) -> Option<Self> {
        let Self::Ordered(ordered) = self else { return Some(self) };
        match ordered.order {
            Order::Prepare => ordered.by.plan().map(|plan| Self::Prepare { plan }),
            Order::Rejoin { plan, number, since_go } => Some(Self::Rejoin { plan, number, since_go }),
            Order::Change(order) => Some(Self::Change(order)),
        }
    }
}
