//! The agent of a host, and the command line.

pub mod logic;
