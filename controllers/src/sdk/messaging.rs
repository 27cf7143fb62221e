//! Queues, requests, routers and locks of a controller: the second paper's messaging level and synchronisation layer, over exports and calls.
//!
//! A queue is exported as a procedure that takes a `QueueMessage` and answers a `Receipt`, a lock as one that takes a
//! `LockRequest` and answers a `LockAnswer`, a router as one that takes a `Subscription` and answers a `Delivery`. So a
//! spec connects, checks and switches them like any call.

mod lock;
mod queue;
mod request;
mod router;

pub use comms::logic::messaging::fencing::Refusal;
pub use comms::logic::messaging::header::{Header, Message as QueueMessage, MessageId};
pub use comms::logic::messaging::lock::LockSettings;
pub use comms::logic::messaging::queue::{Full, QueueCounters, Receipt, Rejected};
pub use comms::logic::messaging::router::{Filter, Gone};
pub use comms::logic::messaging::wire::{
    Denied, LockAnswer, LockRequest, LockStatus, QueueStatus, RouterRefusal, RouterStatus,
};

pub use lock::{Lock, LockUser};
pub use queue::{EncodedMessage, Label, Queue, QueueClient, SendEnd, Taken};
pub use request::{Answered, Replier, RequestFailure, Requester};
pub use router::{Delivery, Dropped, Router, RouterUser, Subscribed, Subscription};

use super::port::Message;

impl Message for QueueMessage {
    const TYPE: &'static str = "QueueMessage";
}

impl Message for Receipt {
    const TYPE: &'static str = "Receipt";
}

impl Message for QueueStatus {
    const TYPE: &'static str = "QueueStatus";
}

impl Message for LockRequest {
    const TYPE: &'static str = "LockRequest";
}

impl Message for LockAnswer {
    const TYPE: &'static str = "LockAnswer";
}

impl Message for LockStatus {
    const TYPE: &'static str = "LockStatus";
}

#[cfg(test)]
mod tests;
