//! The decisions of a node: pure state machines. Time comes in, effects go out.

pub mod protocol;
