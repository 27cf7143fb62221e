//! The tests of `dbmanager`, in one program.

mod faults;
mod keys;
mod simulation;
mod store;
mod view;
