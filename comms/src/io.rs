//! Clocks, sockets and random numbers. Sessions of zenoh need the feature `zenoh`.

pub mod clock;
pub mod control;
pub mod core_dump;
#[cfg(feature = "zenoh")]
pub mod data;
pub mod descriptors;
#[cfg(feature = "zenoh")]
pub mod direct;
pub mod entropy;
pub mod file;
pub mod queue;
#[cfg(feature = "zenoh")]
pub mod session;
mod soft_limit;
pub mod stack;
pub mod stream;
