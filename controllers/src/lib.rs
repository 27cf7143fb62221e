//! Controllers: the kit to write one, a library of control laws, the simulated robot, and the paper's process types.
//!
//! Floors within the room: [`sdk`] knows no robot; [`control`] knows no ports; [`robot`] is the plant, which controllers
//! reach through its devices only; [`library`] puts laws behind ports.
//!
//! ```
//! let registry = controllers::registry();
//! let gripper = registry.create("GripperControl", &["open"]).expect("it is there");
//! assert!(!gripper.interface().about.service);
//! assert!(registry.create("GripperControl", &["ajar"]).is_err());
//! ```

pub mod control;
pub mod library;
pub mod message;
pub mod robot;
pub mod sdk;

/// Returns every controller type of this crate: Appendix A of the paper, its CompliantMotion, and the plant.
pub fn registry() -> sdk::Registry {
    library::registry()
}
