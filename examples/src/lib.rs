//! The controllers of all examples; the folder of each example has its spec, its page and its source.

#[path = "../claims/claims.rs"]
mod claims;
#[path = "../hardware/hardware.rs"]
mod hardware;
#[path = "../levels/levels.rs"]
mod levels;
#[path = "../machines/machines.rs"]
mod machines;
#[path = "../patrol/patrol.rs"]
mod patrol;
#[path = "../pid/pid.rs"]
mod pid;
#[path = "../post/post.rs"]
mod post;
#[path = "../ratios/ratios.rs"]
mod ratios;
#[path = "../requests/requests.rs"]
mod requests;
#[path = "../serial/serial.rs"]
mod serial;
#[path = "../talk/talk.rs"]
mod talk;
#[path = "../tour/tour.rs"]
mod tour;

use controllers::sdk::{Registry, Signal};

/// Returns a signal that the summary of a run shows.
fn headline(name: &str, unit: &str, value: f64) -> Signal {
    Signal { name: name.into(), unit: unit.into(), value, headline: true }
}

/// Returns every controller type of the examples.
pub fn registry() -> Registry {
    let mut registry = Registry::default();
    claims::add(&mut registry);
    hardware::add(&mut registry);
    levels::add(&mut registry);
    machines::add(&mut registry);
    patrol::add(&mut registry);
    pid::add(&mut registry);
    post::add(&mut registry);
    ratios::add(&mut registry);
    requests::add(&mut registry);
    serial::add(&mut registry);
    talk::add(&mut registry);
    tour::add(&mut registry);
    registry
}
