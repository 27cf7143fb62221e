//! The store on the disk, and group commit.

pub mod group;
pub mod store;
