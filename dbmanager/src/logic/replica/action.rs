//! The actions that the rules for messages of peers return. A rule only reads the ledger; the replica executes the actions.

use super::commit::Change;
use super::interface::Effect;
use crate::logic::message::Message;
use crate::logic::version_vector::{ReplicaId, VersionVector};

/// One action in response to a message of a peer.
#[derive(Debug)]
pub(super) enum Action {
    /// A message or a report.
    Emit(Effect),
    /// Note that the peer may have more transactions.
    Ahead,
    /// Note the newest format that the peer reads.
    Reads(u8),
    /// Note that the peer has these transactions durably.
    Has(VersionVector),
    /// Note that the peer has all own transactions, and knows the same ones under their numbers.
    KnowsOwn,
    /// Note that this origin, under which this replica has not written, has used numbers twice.
    KnowForked(ReplicaId),
    /// Give up the own origin.
    Rejoin {
        /// Whether the origin is known to have used numbers twice.
        twice: bool,
    },
    /// Commit this change.
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
