//! What a node and the parent of one program, `dca-shim`, have in common: how they talk, and what each leaves on the disk for
//! the other.
//!
//! The package stands below `node`, so that the shim has nothing of the agent in it.

pub mod process_record;
pub mod processes;
pub mod protocol;
