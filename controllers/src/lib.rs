//! Controllers: the kit to write one, a library of control laws, the simulated robot, and the paper's process types.
//!
//! Floors within the room: [`sdk`] knows no robot; a controller imports the sdk and control laws.

pub mod control;
pub mod message;
pub mod robot;
pub mod sdk;

/// Returns every controller type of this crate.
pub fn registry() -> sdk::Registry {
    sdk::Registry::default()
}
