//! Processes, sockets, files and threads of a node.

mod authors;
mod calendar;
pub mod caller;
pub mod cgroup;
pub mod child;
pub mod database;
pub mod driver;
pub(crate) mod estop;
pub(crate) mod event;
pub mod folder;
pub(crate) mod guard;
pub mod input_log;
pub mod journal;
mod kept;
pub mod logging;
pub mod peers;
pub mod policy;
pub(crate) mod program_database;
pub mod programs;
mod ready;
pub mod run_dir;
pub(crate) mod secrets;
pub mod service_manager;
pub(crate) mod starter;
pub mod state_dir;
pub mod tail;
mod users;
