//! Clocks, sockets and zenoh.

pub mod clock;
pub mod control;
pub mod data;
pub mod queue;
pub mod session;
