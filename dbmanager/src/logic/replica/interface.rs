//! The configuration of a replica, its inputs and its effects.

use crate::logic::clock::Wall;
use crate::logic::message::Message;
use crate::logic::record::Batch;
use crate::logic::txn::{Draft, EncodedTxn, TxnError};
use crate::logic::version_vector::{Dot, ReplicaId};
use comms::logic::time::Time;
use std::collections::BTreeSet;
use std::time::Duration;

/// The configuration of a replica.
#[derive(Clone, Debug)]
pub struct Config {
    /// Name of the robot.
    pub robot: String,
    /// Random bits of the system, from which origins are generated.
    pub seed: u64,
    /// How many bytes of transactions are kept, although all members already have them.
    pub log_size: usize,
}

/// The acknowledgement level: how many robots must have a transaction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AckLevel {
    /// On the disk of this robot.
    Local,
    /// On the disks of this many other robots.
    Replicated(usize),
    /// On the disks of these robots.
    On(BTreeSet<String>),
    /// On the disks of all members.
    Everywhere,
}

/// A request to commit.
#[derive(Clone, Debug)]
pub struct CommitRequest {
    /// Named in the answers.
    pub ticket: u64,
    /// The changes and conditions to commit.
    pub draft: Draft,
    /// The level that the transaction must reach before the caller is answered.
    pub level: AckLevel,
    /// When the caller gives up waiting.
    pub until: Time,
}

/// An input of a replica.
#[derive(Clone, Debug)]
pub enum Input {
    /// The replica begins, or the time of [`Replica::deadline`](super::Replica::deadline) has come.
    Tick(Wall),
    /// Callers want to commit. Requests that wait at the same time go to the disk together.
    Commit(Vec<CommitRequest>, Wall),
    /// A message has arrived.
    Received(ReplicaId, Message, Wall),
    /// A peer has appeared or returned: it is sent the state of this replica at once.
    Appeared(Wall),
    /// From an operator: this is the first member of a team.
    Found(Wall),
    /// From an operator: this origin will never write again.
    Retire(ReplicaId, Wall),
    /// From an operator: this replica gives up its team for the team of another replica.
    Join(ReplicaId, Wall),
    /// From an operator: dates have gone wrong, so begin a new epoch.
    HealClock(Wall),
}

/// The answer to the caller of a commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Nothing was written.
    Refused(TxnError),
    /// The transaction is durable here, and will reach all other replicas.
    Committed(Dot),
    /// The transaction has reached the requested level.
    Reached(Dot),
    /// The transaction has not reached the level in time, but may still reach it. It stays committed.
    Pending(Dot),
}

/// An alarm for the operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Alarm {
    /// A transaction is dated far ahead of this robot's trusted clock.
    ClockSuspect {
        /// The replica that committed it.
        origin: ReplicaId,
        /// How far its date is ahead.
        ahead_by: Duration,
    },
    /// An origin has used a number twice.
    Fork(ReplicaId),
    /// A peer has the same transactions but another state.
    Diverged(ReplicaId),
    /// A peer writes a format that this program cannot read.
    NeedsUpgrade(u8),
    /// A peer has sent a message that no correct peer sends.
    Malformed(ReplicaId),
    /// A peer has passed on a transaction that breaks the rules. It is not applied.
    Forged {
        /// The peer that has sent it.
        from: ReplicaId,
        /// Why, for a person.
        why: String,
    },
    /// The replica of this robot belongs to another team of the same name. Repeated at each of its hellos.
    OtherTeam(ReplicaId, String),
    /// This replica has to continue under a new origin.
    Rejoining {
        /// The origin that was given up.
        from: ReplicaId,
    },
}

/// An effect of a replica. Effects are executed in order.
#[derive(Clone, Debug)]
pub enum Effect {
    /// Write this batch, and continue only when it is on the disk.
    Persist(Batch),
    /// Send this message to all replicas.
    Broadcast(Message),
    /// Send this message to one replica.
    Send(ReplicaId, Message),
    /// Tell the caller of a ticket.
    Answer(u64, Answer),
    /// Tell watchers that this transaction is now visible.
    Visible(Dot, EncodedTxn),
    /// A transaction has a new name (old, new), since its origin was given up.
    Renamed(Dot, Dot),
    /// Restart watchers: the state was replaced by a snapshot.
    Replaced,
    /// Tell an operator.
    Alarm(Alarm),
}
