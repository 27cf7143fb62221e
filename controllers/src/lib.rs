//! Controllers: the kit to write one, a library of control laws, the simulated robot, and the paper's process types.
//!
//! The parts, from the general to the special: [`sdk`] knows no robot, and [`control`] knows no ports. [`robot`] is the
//! plant, which controllers reach only through its devices. [`library`] puts laws behind ports.
//!
//! ```
//! let registry = controllers::registry();
//! let gripper = registry.create("GripperControl", &["open"]).expect("it is there");
//! assert!(!gripper.interface().about.service);
//! assert!(registry.create("GripperControl", &["ajar"]).is_err());
//! assert!(registry.create("DoorWorld", &[]).is_ok());
//! ```

// The code of the derive macros refers to `::controllers`, in this crate as in others.
extern crate self as controllers;

/// The controller of the README builds in its printed form.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;

mod activity_ports;
pub mod control;
pub mod library;
pub mod message;
mod replay;
pub mod robot;
pub mod sdk;

/// The standard messages of ROS 2, for ports such as `In<LaserScan>`: in a spec the type is `ros.sensor.LaserScan`.
///
/// ```
/// use controllers::ros::sensor_msgs::LaserScan;
/// use controllers::sdk::Message;
///
/// assert_eq!(<LaserScan as Message>::TYPE, "ros.sensor.LaserScan");
/// ```
pub use ::ros::typed as ros;

/// Returns every controller type of this crate: the types of Appendix A of the paper, its CompliantMotion, and the
/// plant.
pub fn registry() -> sdk::Registry {
    library::registry()
}

/// Returns the type that has the ports of an activity. Specs do not name it, so [`registry`] does not contain it.
pub fn activity_ports() -> sdk::Registry {
    let mut registry = sdk::Registry::default();
    registry.add_module(activity_ports::interface(), |_, arguments| {
        let ports = activity_ports::ActivityPorts::new(arguments)?;
        Ok(Box::new(ports) as Box<dyn sdk::Module>)
    });
    registry
}

/// Returns the type that stands in for a process whose values were recorded. Specs do not name it, so [`registry`] does
/// not contain it.
pub fn replay() -> sdk::Registry {
    let mut registry = sdk::Registry::default();
    registry.add_module(replay::interface(), |_, arguments| {
        let replay = replay::Replay::new(arguments)?;
        Ok(Box::new(replay) as Box<dyn sdk::Module>)
    });
    registry
}
