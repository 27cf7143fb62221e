//! The agent of a host, and the command line.

pub mod cli;
pub mod io;
pub mod logic;
