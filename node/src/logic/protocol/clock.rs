//! The calendar clock of a host, as its node reads it for an answer.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// The answer to [`super::Request::Clock`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ClockReading {
    /// The time since 1970 that the clock shows.
    pub shown: Duration,
    /// Whether the clock is synchronised.
    pub keeping: ClockKeeping,
}

/// Whether a calendar clock is synchronised with other clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockKeeping {
    /// The kernel reports that it is synchronised.
    Kept,
    /// It is not synchronised. It shows a date that may be right.
    Unkept,
    /// It shows a date that cannot be right.
    Unset,
}

impl fmt::Display for ClockKeeping {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Kept => "kept",
            Self::Unkept => "not kept",
            Self::Unset => "not set",
        })
    }
}
