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
    /// Put this message into the queue.
    Put(Message),
    /// Ask for the counters, for people and tools.
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
    /// The type of the queue's messages.
    pub type_name: String,
    /// The fields of that type, as a spec spells them; empty if it does not name them.
    pub fields: String,
    /// How many wait at most.
    pub capacity: u64,
    /// The policy for a full queue.
    pub full: Full,
    /// The lock without which the queue accepts nothing; empty if it needs none.
    pub lock: String,
    /// The counters of its messages.
    pub counters: QueueCounters,
    /// The sender of the last accepted message, as in the header; empty if there was none.
    pub last_sender: String,
}

/// To a router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RouterRequest {
    /// Send to this queue each message that one of the filters accepts; without filters, every message. A repeated
    /// request renews the subscription and replaces its filters.
    Subscribe {
        /// The name of the queue.
        queue: String,
        /// The type that the queue accepts.
        type_name: String,
        /// The filters.
        filters: Vec<Filter>,
    },
    /// Stop sending to this queue.
    Unsubscribe {
        /// The name of the queue.
        queue: String,
    },
    /// Ask for the subscribers, for people and tools.
    Look,
}

/// From a router.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RouterAnswer {
    /// The queue is in the register.
    Subscribed {
        /// Whether the queue was in the register before.
        is_known: bool,
        /// How many messages for this queue were lost since it was first registered.
        lost: u64,
    },
    /// The queue is not in the register.
    Unsubscribed,
    /// The queue is not in the register, and cannot be added.
    Refused(RouterRefusal),
    /// To [`RouterRequest::Look`].
    Status(RouterStatus),
}

/// Why a router refuses a subscription.
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
        /// The type that the queue accepts.
        taken: String,
    },
    /// There are too many filters, or they are too long.
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
    /// The type of the router's messages.
    pub type_name: String,
    /// The fields of that type, as a spec spells them; empty if it does not name them.
    pub fields: String,
    /// The counters of its messages.
    pub counters: RouterCounters,
    /// The subscribers, by name.
    pub subscribers: Vec<SubscriberStatus>,
}

/// A request to a lock. A repeated request has no further effect.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LockRequest {
    /// Wait for the lock, and take it.
    Acquire {
        /// The client: a random number that it draws at its start.
        client: u64,
        /// The name of the client, for people.
        name: String,
        /// The number of the request, counted by the client.
        request: u64,
        /// The priority: a client with a greater number goes first.
        priority: u8,
    },
    /// Keep the lock for another lease.
    Renew {
        /// The client.
        client: u64,
        /// The request that was granted.
        request: u64,
    },
    /// Let go of the lock, or wait no more.
    Release {
        /// The client.
        client: u64,
        /// The last request to end: this one and all earlier requests are over.
        request: u64,
    },
    /// Ask for the holder, for people and tools.
    Look,
}

/// From a lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LockAnswer {
    /// The client holds the lock.
    Granted {
        /// The answered request.
        request: u64,
        /// The fencing number of this grant.
        fence: u64,
        /// How long a grant lasts.
        lease: Duration,
        /// How much of the lease was left when the server answered.
        left: Duration,
        /// Whether a client of greater priority waits. The lease is not renewed then.
        is_wanted: bool,
    },
    /// The client waits. It has to ask again within one lease, otherwise it is forgotten.
    Waiting {
        /// The answered request.
        request: u64,
        /// How many clients wait before this one.
        ahead: u64,
        /// The holder of the lock; empty if there is none.
        holder: String,
        /// How long a grant lasts.
        lease: Duration,
    },
    /// The client does not hold the lock, and does not wait for it.
    Denied {
        /// The answered request.
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
    /// The lease of the client is over.
    #[error("the lease is over: it was not renewed in time")]
    Expired,
    /// A client of greater priority has got the lock.
    #[error("a client with a higher priority has taken the lock")]
    Preempted,
    /// The client has released the lock.
    #[error("the lock was released")]
    Released,
    /// The server was restarted, and does not know that the client ever held the lock.
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
    /// The fencing number of the holder.
    pub fence: Option<u64>,
    /// For how long, without a renewal.
    pub left: Option<Duration>,
    /// How long a grant lasts.
    pub lease: Duration,
    /// The waiting clients, in their order.
    pub waiting: Vec<String>,
    /// The counters of its grants.
    pub counters: LockCounters,
}

/// The grants of a lock since the start of its server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockCounters {
    /// How often the lock was granted.
    pub grants: u64,
    /// How many leases ran out.
    pub expired: u64,
    /// How many holders had to give way.
    pub preempted: u64,
}

impl LockAnswer {
    /// Returns the number of the answered request; 0 for none.
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

/// The data of a message, with room for its header and the envelope.
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
