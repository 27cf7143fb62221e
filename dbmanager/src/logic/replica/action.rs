//! The actions that the rules for messages of peers return. A rule reads the ledger; only the replica carries out its actions.

use super::commit::Change;
use super::interface::Effect;
use crate::logic::message::Message;
use crate::logic::version_vector::{ReplicaId, VersionVector};

/// One thing to do about a message of a peer.
#[derive(Debug)]
pub(super) enum Action {
    /// Send or tell something.
    Emit(Effect),
    /// The peer may have more than is here.
    Ahead,
    /// The peer reads formats up to this.
    Reads(u8),
    /// The peer has this, durably.
    Has(VersionVector),
    /// The peer has all own transactions, and means the same by their numbers.
    KnowsOwn,
    /// This origin, under which this replica has not written, has used numbers twice.
    KnowForked(ReplicaId),
    /// Give up the origin, which may have used numbers twice.
    Rejoin {
        /// Whether the origin is known to have used numbers twice.
        twice: bool,
    },
    /// Commit this.
    Commit(Change),
    /// Offer the state to the peer.
    Offer,
}

impl Action {
    /// Returns the action that sends a message.
    pub(super) fn send(to: ReplicaId, message: Message) -> Self {
        Self::Emit(Effect::Send(to, message))
    }
}
