//! The decisions of the bridge, as pure functions: values, losses, calls, goals, nodes, and the network.

pub(crate) mod arrivals;
pub(crate) mod command;
pub(crate) mod component;
pub(crate) mod container;
pub(crate) mod conversion;
pub(crate) mod ending;
pub(crate) mod goal;
pub(crate) mod lifecycle;
pub(crate) mod network;
pub(crate) mod others;
pub(crate) mod parts;
#[cfg(test)]
mod peer;
pub(crate) mod replies;
pub(crate) mod retry;
pub(crate) mod senders;
pub(crate) mod statics;
pub(crate) mod value;
