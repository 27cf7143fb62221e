//! The calendar clock of this host, for whoever asks.

use crate::logic::protocol::{ClockKeeping, ClockReading};
use comms::io::clock::{ClockQuality, belief, unix_time};

/// Reads the clock. What takes time comes first, so that the time shown is no older than the answer.
pub(super) fn read() -> ClockReading {
    let keeping = match belief() {
        ClockQuality::Kept => ClockKeeping::Kept,
        ClockQuality::Plausible => ClockKeeping::Unkept,
        ClockQuality::Unset => ClockKeeping::Unset,
    };
    ClockReading { shown: unix_time(), keeping }
}
