//! The `.dca` language: text to plan, and what a plan means. Pure: no clock, no file, no network.

pub mod algebra;
pub mod plan;
