//! The messages between replicas, as data.
//!
//! Pushing is only a shortcut: pulls alone converge. The version vector in a [`Pull`] is the token to resume from, and
//! the only digest that is needed; a connection that is cut costs one chunk. Each message may be lost, repeated, late
//! or out of order.

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
    /// To all, from time to time: the presence and the state of the sender.
    Hello(Hello),
    /// To one peer: a request for the transactions that the sender lacks.
    Pull(Pull),
    /// The answer.
    Chunk(Chunk),
    /// To one peer: a request for one chunk of a snapshot.
    ChunkRequest(ChunkHash),
    /// The answer; without bytes if there is no such chunk any more.
    SnapshotChunk {
        /// The hash of the chunk.
        name: ChunkHash,
        /// Its bytes; nothing if the sender does not have them.
        bytes: Option<Vec<u8>>,
    },
    /// To a peer that waits for it: the transactions that the sender has durably.
    Ack(VersionVector),
    /// To all: new transactions of mine, for receivers that have the previous ones.
    DeltaPush(DeltaPush),
    /// Right before a [`Chunk::Txns`] with more to come: the last transaction of each origin in it. Until its bytes have come, the next
    /// pull can be on its way, so that a link with a long delay is not idle in between.
    Coming {
        /// The number of the pull.
        number: u32,
        /// The last transactions.
        last: VersionVector,
    },
}

/// The part of a message in an exchange with one peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// The peer answers it with a response.
    Request {
        /// How long the response may be in transit. The replica has given it up by then, but still takes it.
        within: Duration,
    },
    /// The message answers a request of the peer.
    Response,
    /// The message has no answer.
    OneWay,
}

impl Message {
    /// Returns the message's part in an exchange, so that the code that carries messages need not know the variants.
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
    /// A random number for each boot: two boots of one origin at a time are a clone.
    pub boot: u64,
    /// The newest format it reads.
    pub format: u8,
    /// Whether it may be asked for transactions.
    pub member: bool,
    /// The chain of sponsors: its sponsor, the sponsor's sponsor, and so on.
    pub sponsors: Vec<ReplicaId>,
    /// [`VersionVector::digest`] of its version vector.
    pub vector: u64,
    /// The same of the chains: of two replicas with equal version vectors it differs if a number was used twice.
    pub chains: u64,
    /// The same of the further transactions that it has and cannot read.
    pub pending: u64,
    /// Digest of the state that this gives.
    pub state: u128,
    /// Number and hash of its own last transaction.
    pub head: (u64, ChainHash),
    /// Its wall clock.
    pub wall: Wall,
}

/// A question for transactions.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pull {
    /// Its number, which the answer repeats.
    pub number: u32,
    /// The durable transactions of the sender.
    pub vector: VersionVector,
    /// The transactions that the sender has buffered because it cannot read them, or that are on their way to it.
    pub pending: VersionVector,
    /// About how many bytes to answer with.
    pub size_max: u32,
    /// Set by a replica that is not a member: a request to be admitted.
    pub join: Option<Join>,
}

/// A request to become a member.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Join {
    /// The origin to admit; it has written nothing.
    pub origin: ReplicaId,
    /// Name of the robot.
    pub robot: String,
    /// Origins that it has given up.
    pub replaces: Vec<ReplicaId>,
    /// In a team with keys, the [`Claim`](crate::logic::notary::Claim) of both.
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
        /// Some of the transactions that you lack.
        txns: Vec<EncodedTxn>,
        /// Whether there is more.
        more: bool,
    },
    /// The transactions are gone: take the state.
    Snapshot(Manifest),
    /// You were retired, by a transaction with this timestamp.
    Retired(Timestamp),
    /// I know your last transaction as this one, and yours is older or another.
    Fork {
        /// Its number.
        seq: u64,
        /// Its hash.
        hash: ChainHash,
    },
    /// You have said to have this, and now you say that you have less.
    Behind(VersionVector),
    /// You have seen another transaction by one of these numbers: I know them by these hashes.
    Known(Vec<(Dot, ChainHash)>),
}
