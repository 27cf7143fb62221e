//! The agent of a host.

pub mod command;
pub mod console;
pub mod io;
pub mod logic;
