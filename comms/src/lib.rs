//! What is said between DCA's programs, and how it travels.

pub mod io;
pub mod logic;
