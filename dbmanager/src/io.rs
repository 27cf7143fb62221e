//! What touches the disk.

pub mod group;
pub mod store;
