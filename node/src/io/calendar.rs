//! The calendar clock of this host. Clients ask for it, and the times of events use it.

use crate::logic::protocol::{ClockKeeping, ClockReading};
use comms::io::clock::{ClockQuality, belief, calendar_origin, unix_time};
use std::time::Duration;

/// If the calendar clock is set by at least this much, later events use the new time.
const SET_MIN: Duration = Duration::from_millis(5);

/// Reads the clock. The slow steps come first, so that the returned time is fresh.
pub(super) fn read() -> ClockReading {
    let keeping = match belief() {
        ClockQuality::Kept => ClockKeeping::Kept,
        ClockQuality::Plausible => ClockKeeping::Unkept,
        ClockQuality::Unset => ClockKeeping::Unset,
    };
    ClockReading { shown: unix_time(), keeping }
}

/// Returns the calendar time at the origin of the boot clock if it differs from `known`. Then the calendar clock has been set.
pub(super) fn set(known: Duration) -> Option<Duration> {
    Some(calendar_origin()).filter(|origin| origin.abs_diff(known) >= SET_MIN)
}
