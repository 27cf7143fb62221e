//! Values, losses and the settings of the network, as pure functions.

pub(crate) mod arrivals;
pub(crate) mod network;
pub(crate) mod senders;
pub(crate) mod value;
