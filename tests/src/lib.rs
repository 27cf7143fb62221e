//! Whole-system tests: what needs more than one room.

pub mod simulation;
