//! The bridge between a mission and ROS 2: one program for each host whose ports are connected with topics or services.
//!
//! The bridge is a controller, so a node starts it, links it, restarts it and stops it like any other. Each topic is one of its ports, and
//! each service is an export or a call. The bytes of a value are not changed: both sides use CDR. `logic` decides which values and calls
//! pass, and `io` has the session with the router. An action of ROS 2 and a program of ROS 2 are other controllers in the same program.

mod action;
mod carried;
mod control;
mod io;
mod logic;
mod module;
mod node;
mod setup;

use controllers::sdk::Registry;
use controllers::sdk::process::{self, Embedding, run_in};
use std::process::ExitCode;

/// The log lines to show, unless `RUST_LOG` is set. Zenoh reports each failed attempt to reach a router; the bridge reports it only once.
const LOGGED: &str = "off,bridge=info,controllers=warn,comms=warn";

/// Sends the log of this process to standard error, which `dca logs` shows.
pub fn log() {
    process::log(LOGGED);
}

/// Returns the controller types of the program: the bridge, an action as a task, and a program of ROS 2.
pub fn registry() -> Registry {
    registry_with(Vec::new())
}

/// Returns the same types as [`registry`]; `rest` are the arguments of the program after `--`, for a program of ROS 2.
fn registry_with(rest: Vec<String>) -> Registry {
    let mut registry = Registry::default();
    registry.add_module(module::interface(), |_, arguments| {
        let bridge = module::Bridge::new(arguments)?;
        Ok(Box::new(bridge) as Box<dyn controllers::sdk::Module>)
    });
    registry.add_module(action::interface(), |_, arguments| {
        let action = action::Action::new(arguments)?;
        Ok(Box::new(action) as Box<dyn controllers::sdk::Module>)
    });
    registry.add_module(node::interface(), move |_, arguments| {
        let node = node::RosNode::new(arguments, &rest)?;
        Ok(Box::new(node) as Box<dyn controllers::sdk::Module>)
    });
    registry
}

/// Runs this process according to its command line. The arguments after `--` are for a program of ROS 2.
pub fn run() -> ExitCode {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let place = arguments.iter().position(|argument| argument == "--");
    let rest = place.map_or_else(Vec::new, |place| arguments.split_off(place).split_off(1));
    run_in(&registry_with(rest), &Embedding { arguments, around: |run| run() })
}
