//! Vocabulary without I/O.

pub mod control;
pub mod signals;
pub mod time;
