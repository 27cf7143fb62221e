//! The bridge between wires and topics of ROS 2: one program for each host whose ports are connected with topics.
//!
//! It is a controller, so a node starts it, links it, restarts it and stops it like any other. Each topic is a port of it. The
//! bytes of a value are not changed: both sides have CDR. `logic` decides which values pass; `io` has the session with the router.

mod io;
mod logic;
mod module;

use controllers::sdk::Registry;

/// Returns the controller type of the bridge.
pub fn registry() -> Registry {
    let mut registry = Registry::default();
    registry.add_module(module::interface(), |_, arguments| {
        let bridge = module::Bridge::new(arguments)?;
        Ok(Box::new(bridge) as Box<dyn controllers::sdk::Module>)
    });
    registry
}
