//! The calendar clock of this host, for clients that ask, and for the times of events.

use crate::logic::protocol::{ClockKeeping, ClockReading};
use comms::io::clock::{ClockQuality, belief, calendar_origin, unix_time};
use std::time::Duration;

/// By how much the calendar clock must have been set before events have its new time.
const SET_MIN: Duration = Duration::from_millis(5);

/// Reads the clock. The slow steps come first, so that the time shown is no older than the answer.
pub(super) fn read() -> ClockReading {
    let keeping = match belief() {
        ClockQuality::Kept => ClockKeeping::Kept,
        ClockQuality::Plausible => ClockKeeping::Unkept,
        ClockQuality::Unset => ClockKeeping::Unset,
    };
    ClockReading { shown: unix_time(), keeping }
}

/// Returns the calendar time at the origin of the boot clock, if it differs from `known`: then the calendar clock has
/// been set.
pub(super) fn set(known: Duration) -> Option<Duration> {
    Some(calendar_origin()).filter(|origin| origin.abs_diff(known) >= SET_MIN)
}
