//! The process algebra: what an event-action expression does with an event.
//!
//! One pure function, [`step`], is called by the supervisor (one event at a time), by the verifier (all of them), by the
//! simulator and by the log checker. It reads no clock, does no I/O and is deterministic.

mod event;

pub use event::{Activation, Cause, Command, Event, Outcome, Reason, Value};
