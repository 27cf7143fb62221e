//! The simulated robot, its door and its devices: quasi-static, 1 kHz, to the bit the same for the same seed.
//!
//! World frame: the wall is the plane x = 0, the robot stands at negative x and looks along x, z is up. A closed door fills
//! the wall from its hinge towards negative y and opens towards the robot, its angle positive then. Nothing of this is
//! for controllers: they know devices only.
//!
//! Source: a purpose-made model; all constants are choices of ours, named where they stand.

pub mod body;
pub mod camera;
pub mod contact;
pub mod door;
pub mod drive;
pub mod force_torque;
pub mod laser;
pub mod plant;
pub mod room;
pub mod setup;
