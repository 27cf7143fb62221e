//! The messaging level and the synchronisation layer: messages with a header, queues, routers, requests and resource
//! locks.
//!
//! - [`header`]: the header of a message, and the limits of each part.
//! - [`queue`]: a named [`MessageQueue`](queue::MessageQueue) receives messages and gives them out by priority.
//! - [`router`]: a [`Router`](router::Router) sends each message to the subscribed queues whose filters accept it.
//! - [`request`]: a request is a message with a marker, and its reply is a message with the same marker.
//! - [`lock`]: a [`ResourceLock`](lock::ResourceLock) lets one client at a time use a resource, for the time of a lease. A
//!   [`FencingCheck`](fencing::FencingCheck) at the resource refuses all other clients. [`lock_client`] is the client's side.
//! - [`port`]: a [`PortInbox`](port::PortInbox) keeps the messages for an activity until its node has taken them.
//! - [`wire`]: the messages between programs for all of these.
//!
//! Each of these is a state machine without a clock: the caller passes the time. Source: Loukianov, Kimura and Sugisaka,
//! "Implementing distributed control system for intelligent mobile robot", Artificial Life and Robotics 8 (2004), section 3.

pub mod fencing;
pub mod header;
pub mod lock;
pub mod lock_client;
pub mod port;
pub mod queue;
pub mod request;
pub mod router;
mod seen;
pub mod wire;
