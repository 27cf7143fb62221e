//! The tests of `comms`, in one program.

mod data;
mod direct;
mod object;
mod session;
