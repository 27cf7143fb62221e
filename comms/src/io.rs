//! Clocks, sockets and zenoh.

pub mod clock;
pub mod queue;
pub mod session;
