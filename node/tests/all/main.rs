//! The tests of `node`, in one program.

mod agents;
mod attach;
mod databases;
mod gate;
