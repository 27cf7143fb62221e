//! The questions of a command line to a robot's database, their answers, and the envelope of messages between replicas.
//!
//! As everything in `protocol`, these types are promises to other versions: variants and fields are only appended.

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
        /// How the keys begin.
        prefix: String,
        /// The state of the copy that is asked for.
        at: AsOf,
    },
    /// Write. Answered by [`Reply::Committed`]; if the call waits for more than the local disk, one of
    /// [`Reply::Reached`] and [`Reply::Pending`] follows.
    Commit(Commit),
    /// The status of a replica and its team. Answered by [`Reply::Status`].
    Status,
    /// Make this robot the first member of a team. Answered by [`Reply::Done`].
    Found,
    /// This member will never write again. Answered by [`Reply::Done`].
    Retire {
        /// Its robot's name, or the 16 digits of its origin.
        member: String,
    },
    /// Dates have gone wrong: begin a new epoch of timestamps. Answered by [`Reply::Done`].
    HealClock,
    /// Asks for the changes and their authors. Answered by a stream of [`Reply::History`].
    History(Filter),
    /// Asks for the unsettled conflicts. Answered by a stream of [`Reply::Conflicts`].
    Conflicts {
        /// How the keys begin.
        prefix: String,
    },
    /// Settle a key. Answered as `Commit` is, or by [`Reply::Done`] if there is nothing to settle.
    Resolve(Resolve),
    /// Asks for the changes between two moments. Answered by a stream of [`Reply::Differences`].
    Diff {
        /// The earlier one.
        from: AsOf,
        /// The later one.
        to: AsOf,
        /// How the keys begin.
        prefix: String,
    },
    /// Asks for the transactions of a moment. Answered by [`Reply::Version`].
    Version(AsOf),
    /// Subscribes to changes of keys. Answered by [`Reply::Version`], the place where the stream begins, and a stream
    /// of [`Reply::Notification`].
    Watch {
        /// The keys.
        keys: Keys,
        /// After which transactions; nothing for now.
        from: Option<VersionVector>,
    },
    /// The keys below a prefix as a file. Answered by a stream of [`Reply::Text`].
    Export {
        /// How the keys begin.
        prefix: String,
        /// The state of the copy that is asked for.
        at: AsOf,
    },
    /// Say who alone writes below a prefix. Answered as `Commit` is.
    Own(Own),
    /// Asks for the owners of prefixes. Only the owner of a prefix may write below it. Answered by [`Reply::Owners`].
    Owners,
    /// The names that a robot had before the one under which it is heard now will never write again. Answered by
    /// [`Reply::Done`].
    RetireOlder {
        /// The robot.
        robot: String,
    },
    /// This robot gives up its team for that of another robot, which has the same name and was begun apart. Answered by
    /// [`Reply::Done`].
    Join {
        /// The robot of the other team.
        robot: String,
    },
    /// Asks for the present values of keys, and subscribes to their changes from there. Answered by a stream of
    /// [`Reply::Entries`], the [`Reply::Version`] at which they stand, and a stream of [`Reply::Notification`].
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
    /// When it had these transactions.
    Version(VersionVector),
    /// A date, in milliseconds since 1970.
    Date(u64),
    /// The transactions of this copy that a robot has too, as far as is known here.
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
    /// The writes that the caller has seen, as [`conflict::seen`](dbmanager::logic::view::conflict::seen) names them.
    /// If others stand there, nothing is settled.
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
    /// Something else; nothing to delete it.
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
    /// The robot; nothing if everybody may write there.
    pub robot: Option<String>,
    /// Whether it is taken from its owner, even if the owner is out of reach and does not know.
    pub by_force: bool,
    /// The reason, for the history.
    pub reason: String,
    /// The acknowledgement level.
    pub level: AckLevel,
    /// The time until the answer `Pending`.
    pub within: Duration,
}

/// A draft with its acknowledgement level and the time that it may take. `Commit` and `Own` become one.
#[derive(Clone, Debug)]
pub(crate) struct WriteRequest {
    pub(crate) draft: Draft,
    pub(crate) level: AckLevel,
    pub(crate) within: Duration,
}

/// The acknowledgement level: how far a commit must get before its caller is answered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AckLevel {
    /// To the disk of this robot.
    Local,
    /// To the disks of so many other robots.
    Replicated(u32),
    /// To the disks of these robots.
    On(Vec<String>),
    /// To the disks of all members.
    Everywhere,
}

/// An element of the answer to a [`Question`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// Some keys with their versions, by stamp: a read shows the last one.
    Entries(Vec<(Key, Vec<Version>)>),
    /// The transaction is durable on the robot that was asked, and will be everywhere.
    Committed(Dot),
    /// The transaction has reached the level that was asked for.
    Reached(Dot),
    /// The transaction has not reached the level in time, but still may. It stays committed.
    Pending(Dot),
    /// A sentence for a person: nothing was done.
    Refused(String),
    /// Nothing was done: only this robot writes there.
    NotOwner {
        /// Its name.
        owner: String,
    },
    /// To `Status`.
    Status(Box<Status>),
    /// A sentence for a person: it is done.
    Done(String),
    /// A sentence for a user, in addition to the answer.
    Note(String),
    /// To `History`: the oldest first.
    History(Vec<HistoryEntry>),
    /// To `Conflicts`.
    Conflicts(Vec<Conflict>, Vec<Race>),
    /// To `Diff`.
    Differences(Vec<Difference>),
    /// To `Version`.
    Version(VersionVector),
    /// To `Watch`.
    Notification(Notification),
    /// To `Export`: a part of the text.
    Text(String),
    /// The answer to `Owners`: prefixes, each with its writer; none if all replicas may write.
    Owners(Vec<(String, Option<String>)>),
    /// To `Commit`: nothing was done, since a condition does not hold.
    Unmet {
        /// The key that it is about.
        key: Key,
        /// A sentence for a person.
        why: String,
    },
    /// A sentence for a user: it is unknown whether the write was done.
    Unknown(String),
}

/// How a replica and its team are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Name of the robot that was asked.
    pub robot: String,
    /// Under which name it writes.
    pub origin: ReplicaId,
    /// Name of the team.
    pub team: String,
    /// Whether it belongs to the team.
    pub member: bool,
    /// Its store.
    pub store: StoreStatus,
    /// The contents of its store.
    pub contents: ContentsStatus,
    /// How far its clock is to be believed: `unset`, `battery`, `network` or `satellite`.
    pub clock: String,
    /// The members, itself included.
    pub members: Vec<MemberStatus>,
    /// The alarms, the latest last.
    pub alarms: Vec<String>,
    /// Robots that were heard of late and belong to another team of the same name.
    pub other_team: Vec<String>,
}

/// The store of a replica.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StoreStatus {
    /// Why it does not write, if it does not.
    pub closed: Option<String>,
    /// Where it is; nothing if it is in memory only.
    pub place: Option<String>,
    /// How many transactions are kept.
    pub log_len: u64,
    /// How many bytes they take.
    pub log_size: u64,
}

/// The contents of a replica.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContentsStatus {
    /// The transactions that it has.
    pub version: VersionVector,
    /// The transactions that every member has.
    pub stable: VersionVector,
    /// A number that replicas with the same state share.
    pub digest: String,
    /// How many keys have a value.
    pub keys: u64,
    /// How many keys have concurrent writes that are not settled.
    pub conflicts: u64,
    /// The number of keys with unsettled races, as far as the log reaches back.
    pub races: u64,
}

/// How a member is, as another knows it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemberStatus {
    /// Name of its robot.
    pub robot: String,
    /// Under which name it writes.
    pub origin: ReplicaId,
    /// When it was last heard of; nothing if never since the node was started, or if it is the replica that was asked.
    #[serde(with = "comms::logic::human::seconds_if_known")]
    pub heard: Option<Duration>,
    /// The transactions of this replica that it is not known to have.
    pub lacks: Lag,
    /// How many transactions are known to exist there and are not here; known only where it has said so.
    pub ahead: u64,
    /// Whether its lag keeps deleted keys and old transactions from being removed.
    pub pins: bool,
    /// Its clock, if it has reported one.
    pub clock: Option<Clock>,
}

/// The clock of another robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// How far it is to be believed: `unset`, `battery`, `network` or `satellite`.
    pub quality: String,
    /// By how many milliseconds its clock was ahead of the clock of the replica that was asked, at the time of its
    /// report; includes the delay between them.
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
