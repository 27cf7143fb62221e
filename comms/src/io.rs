//! Clocks and sockets; and zenoh, for who asks for the feature of that name.

pub mod clock;
pub mod control;
#[cfg(feature = "zenoh")]
pub mod data;
pub mod descriptors;
pub mod queue;
#[cfg(feature = "zenoh")]
pub mod session;
