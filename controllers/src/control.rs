//! Control laws and estimators, one a file: plain functions and small structs, no ports, no clock, no I/O.

pub mod angle;
pub mod approach;
pub mod caster;
pub mod clearance;
pub mod compliant;
pub mod door;
pub mod filter;
pub mod hinge;
pub mod history;
pub mod leaf;
pub mod lever;
pub mod line;
pub mod look;
pub mod opened;
pub mod oscillation;
pub mod passage;
pub mod press;
pub mod puma560;
pub mod ramp;
pub mod redundancy;
pub mod servoing;
pub mod swing;
pub mod swivel;
pub mod through;
pub mod touch;
pub mod unload;
