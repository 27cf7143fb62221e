//! The questions of a command line to a robot's database, the answers to them, and the envelope of messages between replicas.
//!
//! Like everything in `protocol`, these types are a promise to other versions: variants and fields are only appended.

use comms::logic::codec::{Enveloped, Kind};
use dbmanager::logic::key::Key;
use dbmanager::logic::message::Message;
use dbmanager::logic::replica;
use dbmanager::logic::state::Version;
use dbmanager::logic::txn::{Draft, Grant, Require, Value, Write};
use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};
use dbmanager::logic::view::as_of::Difference;
use dbmanager::logic::view::conflict::{Conflict, Race};
use dbmanager::logic::view::past::{Filter, HistoryEntry, Keys};
use dbmanager::logic::view::status::Lag;
use dbmanager::logic::view::watch::Notification;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A message of one replica to another, or to all.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Envelope {
    /// The address of the sender.
    pub from: ReplicaId,
    /// The message.
    pub message: Message,
}

impl Enveloped for Envelope {
    const KIND: Kind = Kind::Envelope;
}

/// A question to the database of one robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Question {
    /// Asks for the value of a key. Answered by [`Reply::Entries`].
    Get {
        /// The key.
        key: Key,
    },
    /// Asks for the values, present or past, of the keys below a prefix. Answered by a stream of [`Reply::Entries`].
    List {
        /// The beginning of the keys.
        prefix: String,
        /// The state of the copy that is asked for.
        at: AsOf,
    },
    /// Writes keys. Answered by [`Reply::Committed`]. If the call waits for more than the local disk,
    /// [`Reply::Reached`] or [`Reply::Pending`] follows.
    Commit(Commit),
    /// Asks for the status of a replica and its team. Answered by [`Reply::Status`].
    Status,
    /// Makes this robot the first member of a team. Answered by [`Reply::Done`].
    Found,
    /// Retires a member, which will never write again. Answered by [`Reply::Done`].
    Retire {
        /// The name of the member's robot, or the 16 digits of its origin.
        member: String,
    },
    /// Begins a new epoch of timestamps after dates have gone wrong. Answered by [`Reply::Done`].
    HealClock,
    /// Asks for the changes and their authors. Answered by a stream of [`Reply::History`].
    History(Filter),
    /// Asks for the unsettled conflicts. Answered by a stream of [`Reply::Conflicts`].
    Conflicts {
        /// The beginning of the keys.
        prefix: String,
    },
    /// Settles a key. Answered in the same way as `Commit`, or by [`Reply::Done`] if nothing is to be settled.
    Resolve(Resolve),
    /// Asks for the changes between two moments. Answered by a stream of [`Reply::Differences`].
    Diff {
        /// The earlier moment.
        from: AsOf,
        /// The later moment.
        to: AsOf,
        /// The beginning of the keys.
        prefix: String,
    },
    /// Asks for the transactions that were there at a moment. Answered by [`Reply::Version`].
    Version(AsOf),
    /// Subscribes to changes of keys. Answered by [`Reply::Version`], which is the position where the stream begins,
    /// and then by a stream of [`Reply::Notification`].
    Watch {
        /// The keys.
        keys: Keys,
        /// After which transactions the stream begins; nothing if it begins now.
        from: Option<VersionVector>,
    },
    /// Asks for the keys below a prefix as a file. Answered by a stream of [`Reply::Text`].
    Export {
        /// The beginning of the keys.
        prefix: String,
        /// The state of the copy that is asked for.
        at: AsOf,
    },
    /// Gives a prefix to one robot, which alone may write below it, or to everybody. Answered in the same way as `Commit`.
    Own(Own),
    /// Asks for the owners of prefixes. Only the owner of a prefix may write below it. Answered by [`Reply::Owners`].
    Owners,
    /// Retires the names that a robot had before its present one. These names will never write again. Answered by [`Reply::Done`].
    RetireOlder {
        /// The robot.
        robot: String,
    },
    /// Moves this robot from its team to the team of another robot. Both teams have the same name, and were begun
    /// separately. Answered by [`Reply::Done`].
    Join {
        /// The robot of the other team.
        robot: String,
    },
    /// Asks for the present values of keys, and subscribes to later changes. Answered by a stream of
    /// [`Reply::Entries`], the [`Reply::Version`] of these values, and a stream of [`Reply::Notification`].
    Follow {
        /// The keys.
        keys: Keys,
    },
}

/// A point in the history of one robot's copy.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AsOf {
    /// The present state.
    Now,
    /// The moment when the copy had just these transactions.
    Version(VersionVector),
    /// A date, in milliseconds since 1970.
    Date(u64),
    /// The transactions of this copy that, as far as this replica knows, the named robot also has.
    On(String),
}

/// How to settle a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Resolve {
    /// The key.
    pub key: Key,
    /// The choice.
    pub choice: Choice,
    /// The reason, for the history.
    pub reason: String,
    /// The acknowledgement level.
    pub level: AckLevel,
    /// The time until the answer `Pending`.
    pub within: Duration,
    /// The writes that the caller has seen, as named by [`conflict::seen`](dbmanager::logic::view::conflict::seen). If
    /// the key has other writes, nothing is settled.
    pub seen: String,
}

/// The value that settles a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Choice {
    /// The value that a read shows.
    Shown,
    /// The value that this robot wrote.
    By(String),
    /// The value that this transaction wrote.
    Txn(Dot),
    /// Another value, or nothing to delete the key.
    Value(Option<Value>),
}

/// A transaction that a caller asks for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commit {
    /// The reason, for the history.
    pub reason: String,
    /// The conditions.
    pub requires: Vec<Require>,
    /// The writes.
    pub writes: Vec<Write>,
    /// The acknowledgement level.
    pub level: AckLevel,
    /// The time until the answer `Pending`.
    pub within: Duration,
}

/// A request to give a prefix to one robot, or to everybody.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Own {
    /// The prefix, without a `/` at the end.
    pub prefix: Key,
    /// The robot; nothing if everybody may write below the prefix.
    pub robot: Option<String>,
    /// Whether the prefix is taken from its owner even if the owner cannot be reached and is not told.
    pub by_force: bool,
    /// The reason, for the history.
    pub reason: String,
    /// The acknowledgement level.
    pub level: AckLevel,
    /// The time until the answer `Pending`.
    pub within: Duration,
}

/// A draft with its acknowledgement level and the time that it may take. `Commit` and `Own` are converted to this form.
#[derive(Clone, Debug)]
pub(crate) struct WriteRequest {
    pub(crate) draft: Draft,
    pub(crate) level: AckLevel,
    pub(crate) within: Duration,
}

/// The acknowledgement level: how far a commit must get before its caller gets an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AckLevel {
    /// To the local disk of this robot.
    Local,
    /// To the disks of this number of other robots.
    Replicated(u32),
    /// To the disks of these robots.
    On(Vec<String>),
    /// To the disks of all members.
    Everywhere,
}

/// An element of the answer to a [`Question`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// Some keys with their versions, in order of stamp. A read shows the last version.
    Entries(Vec<(Key, Vec<Version>)>),
    /// The transaction is on the disk of the robot that was asked, and will reach all others.
    Committed(Dot),
    /// The transaction has reached the requested level.
    Reached(Dot),
    /// The transaction has not reached the requested level in time, but may still reach it. It stays committed.
    Pending(Dot),
    /// A sentence for a person, which says why nothing was done.
    Refused(String),
    /// Nothing was done, because only this robot may write below the prefix.
    NotOwner {
        /// The robot's name.
        owner: String,
    },
    /// The answer to `Status`.
    Status(Box<Status>),
    /// A sentence for a person: the request is fulfilled.
    Done(String),
    /// A sentence for a user, in addition to the answer.
    Note(String),
    /// The answer to `History`, the oldest change first.
    History(Vec<HistoryEntry>),
    /// The answer to `Conflicts`.
    Conflicts(Vec<Conflict>, Vec<Race>),
    /// The answer to `Diff`.
    Differences(Vec<Difference>),
    /// The answer to `Version`.
    Version(VersionVector),
    /// An element of the answer to `Watch`.
    Notification(Notification),
    /// The answer to `Export`: a part of the text.
    Text(String),
    /// The answer to `Owners`: prefixes, each with its only writer; no writer if all replicas may write.
    Owners(Vec<(String, Option<String>)>),
    /// The answer to `Commit` if nothing was done because a condition is not met.
    Unmet {
        /// The key of the condition.
        key: Key,
        /// A sentence for a person.
        why: String,
    },
    /// A sentence for a user: it is unknown whether the write was done.
    Unknown(String),
}

/// The status of a replica and its team.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Name of the robot that was asked.
    pub robot: String,
    /// The name under which the replica writes.
    pub origin: ReplicaId,
    /// Name of the team.
    pub team: String,
    /// Whether the replica belongs to the team.
    pub member: bool,
    /// The status of its store.
    pub store: StoreStatus,
    /// The contents of its store.
    pub contents: ContentsStatus,
    /// How reliable its clock is: `unset`, `plausible`, `network` or `satellite`.
    pub clock: String,
    /// The members of the team. They include the replica itself.
    pub members: Vec<MemberStatus>,
    /// The alarms, the latest last.
    pub alarms: Vec<String>,
    /// Robots with recent messages that belong to another team of the same name.
    pub other_team: Vec<String>,
}

/// The store of a replica.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreStatus {
    /// Why the store does not write. Nothing if the store writes.
    pub closed: Option<String>,
    /// Where the store is; nothing if it is only in memory.
    pub place: Option<String>,
    /// How many transactions are kept.
    pub log_len: u64,
    /// How many bytes the kept transactions take.
    pub log_size: u64,
}

/// The contents of a replica.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContentsStatus {
    /// The transactions that the replica has.
    pub version: VersionVector,
    /// The transactions that every member has.
    pub stable: VersionVector,
    /// A number that is the same for replicas with the same state.
    pub digest: String,
    /// How many keys have a value.
    pub keys: u64,
    /// How many keys have concurrent writes that were not settled.
    pub conflicts: u64,
    /// The number of keys with unsettled races, as far as the log goes back.
    pub races: u64,
}

/// The status of a member, as another member knows it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemberStatus {
    /// Name of its robot.
    pub robot: String,
    /// The name under which the member writes.
    pub origin: ReplicaId,
    /// How long ago the last message of the member came. Nothing if no message has come since the node was started, or
    /// if the member is the asked replica.
    #[serde(with = "comms::logic::human::seconds_if_known")]
    pub heard: Option<Duration>,
    /// The transactions of this replica that, as far as this replica knows, the member lacks.
    pub lacks: Lag,
    /// How many transactions the member is known to have that are missing here. This is known only if the member has reported it.
    pub ahead: u64,
    /// Whether deleted keys and old transactions cannot be removed because of its lag.
    pub pins: bool,
    /// Its clock, if it has reported one.
    pub clock: Option<Clock>,
}

/// The clock of another robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// How reliable the clock is: `unset`, `plausible`, `network` or `satellite`.
    pub quality: String,
    /// By how many milliseconds the clock was ahead of the asked replica's clock, when the robot reported it. This
    /// includes the delay between the two.
    pub ahead: i64,
}

impl From<Commit> for WriteRequest {
    fn from(commit: Commit) -> Self {
        let Commit { reason, requires, writes, level, within } = commit;
        let draft = Draft::new(reason);
        let draft = requires.into_iter().fold(draft, |draft, require| draft.require(require.key, require.condition));
        let draft = writes.into_iter().fold(draft, |draft, Write { key, value }| match value {
            Some(value) => draft.put(key, value),
            None => draft.delete(key),
        });
        Self { draft, level, within }
    }
}

impl From<Own> for WriteRequest {
    fn from(own: Own) -> Self {
        let Own { prefix, robot, by_force, reason, level, within } = own;
        let grant = match robot {
            Some(robot) if by_force => Grant::TakeOver(robot),
            robot => Grant::Give(robot),
        };
        Self { draft: Draft::new(reason).grant(prefix, grant), level, within }
    }
}

impl AckLevel {
    /// Returns the level of a commit.
    pub fn to_replica(&self) -> replica::AckLevel {
        match self {
            Self::Local => replica::AckLevel::Local,
            Self::Replicated(count) => replica::AckLevel::Replicated(usize::try_from(*count).unwrap_or(usize::MAX)),
            Self::On(robots) => replica::AckLevel::On(robots.iter().cloned().collect()),
            Self::Everywhere => replica::AckLevel::Everywhere,
        }
    }
}
