//! Dates and other moments as a user writes them, in the local time of this machine.

use comms::io::clock;
use dbmanager::logic::view::{date, token};
use node::logic::database::question::AsOf;

/// Reads a date. Returns it as milliseconds since 1970.
pub(crate) fn a_date(text: &str) -> Result<u64, String> {
    date_of(text).ok_or_else(|| format!("a date is {}", dates()))
}

/// Reads a point in the history of a copy.
pub(crate) fn a_moment(text: &str) -> Result<AsOf, String> {
    if text == "now" {
        return Ok(AsOf::Now);
    }
    if let Some(robot) = text.strip_prefix("on:").filter(|robot| !robot.is_empty()) {
        return Ok(AsOf::On(robot.to_owned()));
    }
    let moment = token::vector(text).map(AsOf::Version).or_else(|| date_of(text).map(AsOf::Date));
    moment.ok_or_else(|| format!("a moment is `now`, a version, `on:ROBOT`, or a date: {}", dates()))
}

/// Returns the time zone of dates.
pub(crate) fn zone() -> String {
    date::zone(clock::minutes_ahead(now()))
}

fn date_of(text: &str) -> Option<u64> {
    date::parse(text, now(), clock::minutes_ahead)
}

fn now() -> u64 {
    u64::try_from(clock::unix_time().as_millis()).unwrap_or(u64::MAX)
}

/// Describes the forms in which a date can be written.
fn dates() -> String {
    format!(
        "`14:03`, `yesterday 14:03`, `5 min ago` or `2026-11-21 10:00:00`, in {} unless it ends with `Z` or `+01:00`",
        zone()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_a_date_a_version_or_the_part_that_a_robot_has() {
        assert_eq!(a_moment("on:r3"), Ok(AsOf::On("r3".to_owned())));
        assert_eq!(a_moment("2026-11-21 10:00:00Z"), Ok(AsOf::Date(1_795_255_200_000)));
        assert!(matches!(a_moment("5 min ago"), Ok(AsOf::Date(date)) if now() - date < 310_000));
        let why = a_moment("noon").unwrap_err();
        assert!(why.contains("`yesterday 14:03`") && a_moment("on:").is_err(), "{why}");
    }
}
