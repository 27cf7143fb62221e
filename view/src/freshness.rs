//! The age of the data in a view.

use comms::logic::time::Time;
use std::fmt;
use std::time::Duration;

/// The age from which data is not live any more: a node that answers does so each second.
pub const STALE_AFTER: Duration = Duration::from_secs(3);

/// Whether data is live.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freshness {
    /// It is less than [`STALE_AFTER`] old.
    Live,
    /// Nothing newer has come for this time.
    Stale(Duration),
    /// Nothing has ever come.
    Never,
}

impl Freshness {
    /// Returns the freshness, at `now`, of data that came at `heard`.
    pub(crate) fn of(heard: Option<Time>, now: Time) -> Self {
        match heard.map(|heard| now.since(heard)) {
            Some(age) if age < STALE_AFTER => Self::Live,
            Some(age) => Self::Stale(age),
            None => Self::Never,
        }
    }

    /// Returns whether the data is live.
    pub fn is_live(self) -> bool {
        self == Self::Live
    }
}

/// `live`, `not live since 3 s`, `no data yet`
impl fmt::Display for Freshness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Live => f.write_str("live"),
            Self::Stale(age) => write!(f, "not live since {} s", age.as_secs()),
            Self::Never => f.write_str("no data yet"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_ages() {
        let at = |millis: u64| Time::ZERO + Duration::from_millis(millis);
        let check = |heard: Option<u64>, now: u64, expected: &str| {
            assert_eq!(Freshness::of(heard.map(at), at(now)).to_string(), expected);
        };
        check(None, 9000, "no data yet");
        check(Some(1000), 3999, "live");
        check(Some(1000), 4000, "not live since 3 s");
        check(Some(1000), 61_900, "not live since 60 s");
        check(Some(1000), 0, "live");
    }
}
