//! The messages between programs about queues, routers and locks. Each is a request and its answer.

use super::header::Message;
use super::queue::{Full, QueueCounters, Receipt};
use super::router::{Filter, RouterCounters, SubscriberStatus};
use crate::logic::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use thiserror::Error;

/// To a queue.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum QueueRequest {
    /// Receive this message: the one method of a queue.
    Put(Message),
    /// For people and tools: its counters.
    Look,
}

/// From a queue.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum QueueAnswer {
    /// To [`QueueRequest::Put`].
    Receipt(Receipt),
    /// To [`QueueRequest::Look`].
    Status(QueueStatus),
}

/// The status of a queue.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueueStatus {
    /// The type of its messages.
    pub type_name: String,
    /// The fields of that type, as a spec spells them; empty if it does not name them.
    pub fields: String,
    /// How many wait at most.
    pub capacity: u64,
    /// The policy for a full queue.
    pub full: Full,
    /// The lock without which it takes nothing; empty if there is none.
    pub lock: String,
    /// The traffic through it.
    pub counters: QueueCounters,
    /// The sender of the last message that it took in, as its header has it; empty before there was one.
    pub last_sender: String,
}

/// To a router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RouterRequest {
    /// Sends each message that one of the filters takes to this queue; without filters, every message. A repeated
    /// request renews the subscription and replaces its filters.
    Subscribe {
        /// The name of the queue.
        queue: String,
        /// The type that the queue takes.
        type_name: String,
        /// The filters.
        filters: Vec<Filter>,
    },
    /// Stop sending to this queue.
    Unsubscribe {
        /// The name of the queue.
        queue: String,
    },
    /// For people and tools: its subscribers.
    Look,
}

/// From a router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RouterAnswer {
    /// The queue is in the register.
    Subscribed {
        /// Whether it was before.
        is_known: bool,
        /// How many messages that were for it were lost since it was registered first.
        lost: u64,
    },
    /// The queue is not in the register.
    Unsubscribed,
    /// The queue is not in the register, and cannot be.
    Refused(RouterRefusal),
    /// To [`RouterRequest::Look`].
    Status(RouterStatus),
}

/// Why a router does not take a subscription.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum RouterRefusal {
    /// The register is full.
    #[error("the router has {max} subscribers, and no more are allowed")]
    Full {
        /// How many subscribers there may be.
        max: u64,
    },
    /// The queue takes another type.
    #[error("the router sends `{sent}`, and the queue takes `{taken}`")]
    WrongType {
        /// The type that the router sends.
        sent: String,
        /// The type that the queue takes.
        taken: String,
    },
    /// The filters are too many or too long.
    #[error("a subscription has {max} filters at most, each with {size_max} bytes of text")]
    Filters {
        /// How many there may be.
        max: u64,
        /// How long their text may be.
        size_max: u64,
    },
}

/// The status of a router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RouterStatus {
    /// The type of its messages.
    pub type_name: String,
    /// The fields of that type, as a spec spells them; empty if it does not name them.
    pub fields: String,
    /// The traffic through it.
    pub counters: RouterCounters,
    /// Its subscribers, by name.
    pub subscribers: Vec<SubscriberStatus>,
}

/// To a lock. Said again, a request does no more than the first time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LockRequest {
    /// Wait for the lock, and take it.
    Acquire {
        /// One life of one client: a random number.
        client: u64,
        /// The name of the client, for people.
        name: String,
        /// Counts the requests of that client.
        request: u64,
        /// The order among clients: a greater number goes first.
        priority: u8,
    },
    /// Keep the lock for another lease.
    Renew {
        /// The client.
        client: u64,
        /// The request under which it holds the lock.
        request: u64,
    },
    /// Let go of the lock, or wait no more.
    Release {
        /// The client.
        client: u64,
        /// This request and all before it are over.
        request: u64,
    },
    /// For people and tools: its holder.
    Look,
}

/// From a lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LockAnswer {
    /// The client holds the lock.
    Granted {
        /// Its request.
        request: u64,
        /// The fencing number of this grant.
        fence: u64,
        /// How long a grant lasts.
        lease: Duration,
        /// How much of it was left when the server answered.
        left: Duration,
        /// Whether a client with a greater priority waits: then the lease is not renewed.
        is_wanted: bool,
    },
    /// The client waits: it asks again, and is forgotten if it does not within one lease.
    Waiting {
        /// Its request.
        request: u64,
        /// How many others wait before it.
        ahead: u64,
        /// The holder of the lock; empty if there is none.
        holder: String,
        /// How long a grant lasts.
        lease: Duration,
    },
    /// The client does not hold the lock, and does not wait.
    Denied {
        /// Its request.
        request: u64,
        /// The reason.
        why: Denied,
    },
    /// To [`LockRequest::Release`].
    Released {
        /// As asked.
        request: u64,
    },
    /// To [`LockRequest::Look`].
    Status(LockStatus),
}

/// Why a client does not hold a lock.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum Denied {
    /// Its lease is over.
    #[error("the lease is over: it was not renewed in time")]
    Expired,
    /// A client with a greater priority has it.
    #[error("a client with a higher priority has taken the lock")]
    Preempted,
    /// It has let go.
    #[error("the lock was released")]
    Released,
    /// The server does not know that it ever held the lock: it was started again.
    #[error("the lock is not held: its server was started again")]
    NotHeld,
    /// Too many wait.
    #[error("too many clients wait for the lock")]
    TooManyWait,
}

/// The status of a lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockStatus {
    /// The holder.
    pub holder: Option<String>,
    /// Under which number.
    pub fence: Option<u64>,
    /// For how long, without a renewal.
    pub left: Option<Duration>,
    /// How long a grant lasts.
    pub lease: Duration,
    /// The waiting clients, in their order.
    pub waiting: Vec<String>,
    /// How often it was granted since the server's start.
    pub grants: u64,
    /// How many leases ran out.
    pub expired: u64,
    /// How many holders had to give way.
    pub preempted: u64,
}

impl LockAnswer {
    /// Returns which request of a client it answers; 0 for none.
    pub const fn request(&self) -> u64 {
        match self {
            Self::Granted { request, .. }
            | Self::Waiting { request, .. }
            | Self::Denied { request, .. }
            | Self::Released { request } => *request,
            Self::Status(_) => 0,
        }
    }
}

/// More than the data of a message: its header, and the envelope.
const SIZE_MAX: usize = super::header::DATA_SIZE_MAX + (8 << 10);

impl Enveloped for QueueRequest {
    const KIND: Kind = Kind::QueueRequest;
    const SIZE_MAX: usize = SIZE_MAX;
}

impl Enveloped for QueueAnswer {
    const KIND: Kind = Kind::QueueAnswer;
    const SIZE_MAX: usize = 64 << 10;
}

impl Enveloped for RouterRequest {
    const KIND: Kind = Kind::RouterRequest;
    const SIZE_MAX: usize = 64 << 10;
}

impl Enveloped for RouterAnswer {
    const KIND: Kind = Kind::RouterAnswer;
    const SIZE_MAX: usize = 4 << 20;
}

impl Enveloped for LockRequest {
    const KIND: Kind = Kind::LockRequest;
    const SIZE_MAX: usize = 4 << 10;
}

impl Enveloped for LockAnswer {
    const KIND: Kind = Kind::LockAnswer;
    const SIZE_MAX: usize = 1 << 20;
}

#[cfg(test)]
mod tests;
