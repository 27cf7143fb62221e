//! The simulated robot, its door and its devices. The model is quasi-static, has steps of 1 ms, and gives identical
//! results for the same seed.
//!
//! World frame: the wall is the plane x = 0, the robot is at negative x and looks along x, z is up. A closed door fills
//! the wall from its hinge towards negative y and opens towards the robot, with a positive angle. Controllers know none
//! of this, only the devices.
//!
//! Source: a purpose-made model; all constants are our choices, named at their definitions.

pub mod arm;
pub mod base;
pub mod body;
pub mod camera;
pub mod contact;
pub mod door;
pub mod drive;
mod fault;
pub mod force_torque;
pub mod gripper;
pub mod laser;
pub mod plant;
pub mod room;
pub mod setup;
