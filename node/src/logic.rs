//! The decisions of a node: pure state machines. Time comes in, effects go out.

pub mod absence;
pub mod agent;
pub mod attachments;
pub mod claims;
pub mod coordinator;
pub mod database;
pub mod effect;
pub mod executable;
pub mod executer;
pub mod gate;
pub mod history;
pub mod instance;
pub mod link;
mod meant;
pub mod nameserver;
pub mod node_state;
pub mod output_lines;
pub mod parameters;
pub mod participant;
pub mod printable;
pub mod programs;
pub mod protocol;
pub mod table;
pub mod timed;
mod timing;
pub mod unit_file;
pub mod wiring;
