//! The messages between replicas, as data.
//!
//! Pushes are only a shortcut: pulls alone converge. The version vector in a [`Pull`] is the token from which a transfer resumes, and
//! the only digest that is needed; a cut connection costs one chunk. Each message may be lost, repeated, late or out of order.

use crate::logic::clock::{Timestamp, Wall};
use crate::logic::delta::DeltaPush;
use crate::logic::snapshot::{ChunkHash, Manifest};
use crate::logic::timing::{CHUNK_WITHIN, PULL_WITHIN};
use crate::logic::txn::{ChainHash, EncodedTxn};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The most bytes of transactions in one push.
pub const PUSH_SIZE_MAX: usize = 32 << 10;
/// The most bytes of transactions in one chunk, unless a single one is longer.
pub const CHUNK_SIZE_MAX: usize = comms::logic::pace::SIZE_MAX;

/// A message. Append only.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Message {
    /// To all: new transactions, unchanged.
    Push(Vec<EncodedTxn>),
    /// To all replicas, from time to time: the presence and the state of the sender.
    Hello(Hello),
    /// To one peer: a request for the transactions that the sender lacks.
    Pull(Pull),
    /// The answer.
    Chunk(Chunk),
    /// To one peer: a request for one chunk of a snapshot.
    ChunkRequest(ChunkHash),
    /// The answer to a `ChunkRequest`.
    SnapshotChunk {
        /// The hash of the chunk.
        name: ChunkHash,
        /// The bytes of the chunk; none if the sender does not have it any more.
        bytes: Option<Vec<u8>>,
    },
    /// To a peer that waits for it: the durable transactions of the sender.
    Ack(VersionVector),
    /// To all replicas: new transactions of the sender, for receivers that have the previous ones.
    DeltaPush(DeltaPush),
    /// Right before a [`Chunk::Txns`] with more to come: the last transaction of each origin in it. While the bytes are in transit, the
    /// receiver can already send the next pull, so that a link with a long delay is not idle in between.
    Coming {
        /// The number of the pull.
        number: u32,
        /// The last transactions.
        last: VersionVector,
    },
}

/// The role of a message in an exchange with one peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// The peer answers the message with a response.
    Request {
        /// How long the response may be in transit. After that time the replica has given the request up, but still takes the response.
        within: Duration,
    },
    /// The message answers a request of the peer.
    Response,
    /// The message has no answer.
    OneWay,
}

impl Message {
    /// Returns the role of the message, so that the code that carries messages does not need to know the variants.
    pub fn pattern(&self) -> Pattern {
        match self {
            Self::Pull(_) => Pattern::Request { within: PULL_WITHIN },
            Self::ChunkRequest(_) => Pattern::Request { within: CHUNK_WITHIN },
            Self::Chunk(_) | Self::SnapshotChunk { .. } => Pattern::Response,
            Self::Push(_) | Self::DeltaPush(_) | Self::Hello(_) | Self::Ack(_) | Self::Coming { .. } => Pattern::OneWay,
        }
    }
}

/// The presence of a replica.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// Name of the robot.
    pub robot: String,
    /// A random number for each boot. Two boots of one origin at the same time show that it was cloned.
    pub boot: u64,
    /// The newest format that the sender can read.
    pub format: u8,
    /// Whether the sender is a member and may be asked for transactions.
    pub member: bool,
    /// The chain of sponsors: the sender's sponsor, that one's sponsor, and so on.
    pub sponsors: Vec<ReplicaId>,
    /// [`VersionVector::digest`] of the sender's version vector.
    pub vector: u64,
    /// The digest of the sender's chains. It differs between two replicas with equal version vectors if a number was used twice.
    pub chains: u64,
    /// The digest of the further transactions that the sender has but cannot read.
    pub pending: u64,
    /// The digest of the state that these transactions give.
    pub state: u128,
    /// Number and hash of the sender's own last transaction.
    pub head: (u64, ChainHash),
    /// The sender's wall clock.
    pub wall: Wall,
}

/// A question for transactions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pull {
    /// The number of the question, which the answer repeats.
    pub number: u32,
    /// The durable transactions of the sender.
    pub vector: VersionVector,
    /// Transactions that the sender does not need: it has buffered them because it cannot read them yet, or they are on their way to
    /// it.
    pub pending: VersionVector,
    /// About how many bytes to answer with.
    pub size_max: u32,
    /// The request to be admitted, from a replica that is not a member.
    pub join: Option<Join>,
}

/// A request to become a member.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Join {
    /// The origin to admit; it has not written anything.
    pub origin: ReplicaId,
    /// Name of the robot.
    pub robot: String,
    /// Origins that the replica has given up.
    pub replaces: Vec<ReplicaId>,
    /// In a team with keys: the [`Claim`](crate::logic::notary::Claim) of the new origin and of the ones given up.
    pub claim: Option<Vec<u8>>,
}

/// An answer. Append only.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Chunk {
    /// Transactions, in an order in which they can be applied.
    Txns {
        /// The number of the pull.
        number: u32,
        /// The transactions of the sender.
        vector: VersionVector,
        /// Some of the transactions that the receiver lacks.
        txns: Vec<EncodedTxn>,
        /// Whether the receiver lacks further transactions.
        more: bool,
    },
    /// The transactions were dropped, so the receiver has to take the state.
    Snapshot(Manifest),
    /// The receiver was retired, by a transaction with this timestamp.
    Retired(Timestamp),
    /// The sender knows this transaction as the receiver's last one, but the receiver has an older or a different one.
    Fork {
        /// The number of the transaction.
        seq: u64,
        /// The hash of the transaction.
        hash: ChainHash,
    },
    /// The receiver has reported this version vector before, and now reports less.
    Behind(VersionVector),
    /// The receiver has seen different transactions under these numbers; the sender knows them by these hashes.
    Known(Vec<(Dot, ChainHash)>),
}
