//! All tests of `verify`, in one program.

mod activities;
mod assumed;
mod conform;
mod corpus;
mod exports;
mod faults;
mod mistakes;
mod repairs;
mod replay;
mod rewriting;
mod stories;
mod threads;
mod timers;
mod times;
mod verdicts;
