//! What passes the bridge, as pure functions: values, losses, and the network that is meant.

pub(crate) mod arrivals;
pub(crate) mod network;
pub(crate) mod senders;
pub(crate) mod value;
