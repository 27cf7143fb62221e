//! The common part of a node and the parent of one program, `dca-shim`: their protocol, and the files that each leaves for the
//! other.
//!
//! The package is below `node`, so that the shim contains nothing of the agent.

pub mod process_record;
pub mod processes;
pub mod protocol;
