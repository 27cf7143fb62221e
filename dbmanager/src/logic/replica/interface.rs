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
    /// Random bits of the system, from which origins are made.
    pub seed: u64,
    /// How many bytes of transactions are kept although everybody has them.
    pub log_size: usize,
}

/// The acknowledgement level: how far a transaction has to get.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AckLevel {
    /// On the disk of this robot.
    Local,
    /// On the disks of so many other robots.
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
    /// How far it must get before the caller is answered.
    pub level: AckLevel,
    /// When the caller gives up waiting.
    pub until: Time,
}

/// An input of a replica.
#[derive(Clone, Debug)]
pub enum Input {
    /// The replica begins; or the time has come that [`Replica::deadline`](super::Replica::deadline) asked for.
    Tick(Wall),
    /// Callers want to commit. Those that wait at the same time go to the disk together.
    Commit(Vec<CommitRequest>, Wall),
    /// A message has arrived.
    Received(ReplicaId, Message, Wall),
    /// A peer has arrived, or returned: it is told of the state here at once.
    Appeared(Wall),
    /// An operator: this is the first member of a team.
    Found(Wall),
    /// An operator: this origin will never write again.
    Retire(ReplicaId, Wall),
    /// An operator: this one gives up its team for that of another replica.
    Join(ReplicaId, Wall),
    /// An operator: dates have gone wrong, begin a new epoch.
    HealClock(Wall),
}

/// The answer to the caller of a commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Nothing was written.
    Refused(TxnError),
    /// The transaction is durable here, and will be everywhere.
    Committed(Dot),
    /// The transaction has reached the level that was asked for.
    Reached(Dot),
    /// The transaction has not reached the level in time, but still may. It stays committed.
    Pending(Dot),
}

/// An alarm for the operator.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Alarm {
    /// A transaction is dated far ahead of our trusted clock.
    ClockSuspect {
        /// The replica that committed it.
        origin: ReplicaId,
        /// How far it is ahead.
        ahead_by: Duration,
    },
    /// An origin has used a number twice.
    Fork(ReplicaId),
    /// A peer has the same transactions and another state.
    Diverged(ReplicaId),
    /// A peer writes a format that this program cannot read.
    NeedsUpgrade(u8),
    /// A peer has sent a message that no correct peer sends.
    Malformed(ReplicaId),
    /// A peer has passed on a transaction that breaks the rules. It is left out.
    Forged {
        /// Its sender.
        from: ReplicaId,
        /// Why, for a person.
        why: String,
    },
    /// The replica of this robot belongs to another team of the same name; told at each of its hellos.
    OtherTeam(ReplicaId, String),
    /// This replica has to begin under a new origin.
    Rejoining {
        /// The origin that was given up.
        from: ReplicaId,
    },
}

/// An effect of a replica. Effects are carried out in order.
#[derive(Clone, Debug)]
pub enum Effect {
    /// Write this, and return only when it is on the disk.
    Persist(Batch),
    /// Send this to all replicas.
    Broadcast(Message),
    /// Send this to one.
    Send(ReplicaId, Message),
    /// Tell the caller of a ticket.
    Answer(u64, Answer),
    /// Tell watchers: this transaction is visible now.
    Visible(Dot, EncodedTxn),
    /// A transaction has a new name, since its origin had to be given up.
    Renamed(Dot, Dot),
    /// Watchers start again: the state was replaced by a snapshot.
    Replaced,
    /// Tell an operator.
    Alarm(Alarm),
}
