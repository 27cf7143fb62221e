//! The common part of a node and the parent of one program, `dca-shim`: their protocol, and the files that each leaves for the
//! other.
//!
//! The package stands below `node`, so that the shim has nothing of the agent in it.

pub mod process_record;
pub mod processes;
pub mod protocol;
