//! Queues, requests, routers and locks of a controller, over exports and calls: the messaging level and synchronisation
//! layer of the second paper.
//!
//! Each of these is exported as a procedure. The procedure of a queue takes a `QueueMessage` and answers a `Receipt`. A
//! lock takes a `LockRequest` and answers a `LockAnswer`. A router takes a `Subscription` and answers a `Delivery`. So
//! a spec connects, checks and switches them like any call.

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
    Denied, LockAnswer, LockCounters, LockRequest, LockStatus, QueueStatus, RouterRefusal, RouterStatus,
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
