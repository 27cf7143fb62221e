//! Dates as text, in UTC: `2026-11-21 10:00:02`.

use toml::value::{Datetime, Offset};

const DAY_MS: u64 = 86_400_000;

/// Returns a date, given in milliseconds since 1970, to the second.
///
/// Source: H. Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`.
pub fn text(millis: u64) -> String {
    let (days, rest) = (millis / DAY_MS + 719_468, millis % DAY_MS / 1000);
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    // A year begins in March here, so that the day that comes and goes is its last.
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    let year = year_of_era + era * 400 + next;
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}")
}

/// Reads a date as TOML has it (`2026-11-21`, `2026-11-21 10:00:02`, `2026-11-21T12:00:02+02:00`) as milliseconds since
/// 1970; without an offset it is in UTC, without a time at midnight.
pub fn parse(text: &str) -> Option<u64> {
    let Datetime { date, time, offset } = text.trim().parse().ok()?;
    let date = date?;
    // The inverse, `days_from_civil`.
    let month = u64::from(date.month);
    let year = u64::from(date.year).checked_sub(u64::from(month <= 2))?;
    let shifted = if month > 2 { month - 3 } else { month + 9 };
    let day_of_year = (153 * shifted + 2) / 5 + u64::from(date.day) - 1;
    let days = (year * 365 + year / 4 - year / 100 + year / 400 + day_of_year).checked_sub(719_468)?;
    let of_day = time.map_or(0, |time| {
        let seconds = u64::from(time.hour) * 3600 + u64::from(time.minute) * 60 + u64::from(time.second);
        seconds * 1000 + u64::from(time.nanosecond / 1_000_000)
    });
    let minutes_ahead = match offset {
        Some(Offset::Custom { minutes }) => i64::from(minutes),
        Some(Offset::Z) | None => 0,
    };
    (days * DAY_MS + of_day).checked_add_signed(-60_000 * minutes_ahead)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_written_is_read(seconds in 0_u64..253_402_300_800) {
            prop_assert_eq!(parse(&text(seconds * 1000)), Some(seconds * 1000));
        }
    }

    #[test]
    fn known_dates() {
        assert_eq!(text(0), "1970-01-01 00:00:00");
        assert_eq!(text(951_782_400_000), "2000-02-29 00:00:00");
        assert_eq!(text(1_795_255_200_000), "2026-11-21 10:00:00");
        assert_eq!(parse("2026-11-21T12:00:00.5+02:00"), Some(1_795_255_200_500));
        assert_eq!(parse("1970-01-02"), Some(DAY_MS));
        for none in ["", "12:00:00", "yesterday", "1969-12-31", "2026-02-30x", "0000-01-01"] {
            assert_eq!(parse(none), None, "{none}");
        }
    }
}
