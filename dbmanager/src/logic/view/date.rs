//! Dates as text: `2026-11-21 10:00:02` in UTC or in local time, and the expressions that people use for moments.

use std::time::Duration;
use toml::value::{Date, Datetime, Offset};

const DAY_MS: u64 = 86_400_000;
const MINUTE_MS: i64 = 60_000;

/// Returns how many minutes local time is ahead of UTC, at a moment in milliseconds since 1970.
pub type Ahead = fn(u64) -> i64;

/// The [`Ahead`] of UTC.
pub fn utc(_millis: u64) -> i64 {
    0
}

/// Returns a date in UTC, given in milliseconds since 1970, to the second.
///
/// Source: H. Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`.
pub fn text(millis: u64) -> String {
    let (days, rest) = (millis / DAY_MS + 719_468, millis % DAY_MS / 1000);
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    // A year begins in March here, so that a leap day is its last day.
    let month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    let year = year_of_era + era * 400 + next;
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}")
}

/// Returns the same date in local time.
pub fn local(millis: u64, ahead: Ahead) -> String {
    text(millis.saturating_add_signed(MINUTE_MS * ahead(millis)))
}

/// Returns the offset of local time from UTC in the form that follows a date: `Z`, `+01:00`.
pub fn offset(minutes: i64) -> String {
    let (sign, size) = (if minutes < 0 { '-' } else { '+' }, minutes.unsigned_abs());
    if minutes == 0 { "Z".to_owned() } else { format!("{sign}{:02}:{:02}", size / 60, size % 60) }
}

/// Returns the offset of local time from UTC as the name of a zone: `UTC`, `UTC+01:00`.
pub fn zone(minutes: i64) -> String {
    if minutes == 0 { "UTC".to_owned() } else { format!("UTC{}", offset(minutes)) }
}

/// Reads a moment, as milliseconds since 1970; in local time unless the text has an offset. Accepts
/// `5 min ago`, `14:03` (the last time it was 14:03), `yesterday`, `yesterday 14:03`, or a TOML
/// date, such as `2026-11-21`, `2026-11-21 10:00:02` or `2026-11-21T12:00:02+02:00`. A day without
/// a time means its midnight.
pub fn parse(text: &str, now: u64, ahead: Ahead) -> Option<u64> {
    let text = text.trim();
    if let Some(span) = text.strip_suffix("ago") {
        return now.checked_sub(millis(span.trim())?);
    }
    let now_here = now.checked_add_signed(MINUTE_MS * ahead(now))?;
    let today = now_here - now_here % DAY_MS;
    let (day, rest) = text.split_once(' ').unwrap_or((text, ""));
    let day = match day {
        "today" => Some(today),
        "yesterday" => Some(today.checked_sub(DAY_MS)?),
        _ => None,
    };
    if let (Some(day), "") = (day, rest) {
        return to_utc(day, ahead);
    }
    let read: Datetime = day.map_or(text, |_| rest).parse().ok()?;
    let of_day = read.time.map_or(0, |time| {
        let seconds = u64::from(time.hour) * 3600 + u64::from(time.minute) * 60 + u64::from(time.second);
        seconds * 1000 + u64::from(time.nanosecond / 1_000_000)
    });
    match (day, read.date, read.offset) {
        (Some(day), None, None) => to_utc(day + of_day, ahead),
        (None, None, None) if today + of_day <= now_here => to_utc(today + of_day, ahead),
        (None, None, None) => to_utc((today + of_day).checked_sub(DAY_MS)?, ahead),
        (None, Some(date), None) => to_utc(days(date)? * DAY_MS + of_day, ahead),
        (None, Some(date), Some(offset)) => {
            let minutes = if let Offset::Custom { minutes } = offset { i64::from(minutes) } else { 0 };
            (days(date)? * DAY_MS + of_day).checked_add_signed(-MINUTE_MS * minutes)
        }
        _ => None,
    }
}

/// Returns the moment at which local clocks show a time. In the hour that is repeated in autumn, clocks show each time
/// twice.
fn to_utc(here: u64, ahead: Ahead) -> Option<u64> {
    let near = here.checked_add_signed(-MINUTE_MS * ahead(here))?;
    here.checked_add_signed(-MINUTE_MS * ahead(near))
}

/// Reads a number with a unit of time: `5 min`, `1.5h`.
fn millis(text: &str) -> Option<u64> {
    let (number, unit) = text.split_at(text.find(|character: char| character.is_ascii_alphabetic())?);
    let unit = match unit {
        "s" | "second" | "seconds" => 1e3,
        "min" | "minute" | "minutes" => 60e3,
        "h" | "hour" | "hours" => 3600e3,
        "d" | "day" | "days" => 86_400e3,
        "week" | "weeks" => 7.0 * 86_400e3,
        _ => return None,
    };
    let number: f64 = number.trim().parse().ok()?;
    u64::try_from(Duration::try_from_secs_f64(number * unit / 1e3).ok()?.as_millis()).ok()
}

/// Returns the number of days since 1970: the inverse of the formula in [`text`], `days_from_civil`.
fn days(date: Date) -> Option<u64> {
    let month = u64::from(date.month);
    let year = u64::from(date.year).checked_sub(u64::from(month <= 2))?;
    let shifted = if month > 2 { month - 3 } else { month + 9 };
    let day_of_year = (153 * shifted + 2) / 5 + u64::from(date.day) - 1;
    (year * 365 + year / 4 - year / 100 + year / 400 + day_of_year).checked_sub(719_468)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// One hour ahead of UTC, and two hours in summer: from the end of March to the end of October 2026.
    fn berlin(millis: u64) -> i64 {
        if (1_774_746_000_000..1_792_890_000_000).contains(&millis) { 120 } else { 60 }
    }

    proptest! {
        #[test]
        fn what_was_written_is_read(seconds in 0_u64..253_402_300_800) {
            let millis = seconds * 1000;
            prop_assert_eq!(parse(&text(millis), 0, utc), Some(millis));
            let with_offset = format!("{}{}", local(millis, |_| -210), offset(-210));
            if seconds > 210 * 60 {
                prop_assert_eq!(parse(&with_offset, 0, utc), Some(millis));
            }
            prop_assert_eq!(parse(&local(millis, |_| 60), 0, |_| 60), Some(millis));
        }
    }

    #[test]
    fn known_dates() {
        assert_eq!(text(0), "1970-01-01 00:00:00");
        assert_eq!(text(951_782_400_000), "2000-02-29 00:00:00");
        assert_eq!(text(1_795_255_200_000), "2026-11-21 10:00:00");
        assert_eq!(local(1_795_255_200_000, berlin), "2026-11-21 11:00:00");
        assert_eq!([0, 60, -210].map(zone), ["UTC", "UTC+01:00", "UTC-03:30"]);
        assert_eq!(parse("2026-11-21T12:00:00.5+02:00", 0, berlin), Some(1_795_255_200_500));
        assert_eq!(parse("1970-01-02", 0, utc), Some(DAY_MS));
        for none in
            ["", "noon", "yesterday 2026-11-21", "1969-12-31", "2026-02-30x", "0000-01-01", "ago", "5 ago", "-1 h ago"]
        {
            assert_eq!(parse(none, 1_795_255_200_000, utc), None, "{none}");
        }
    }

    #[test]
    fn a_moment_is_named_as_people_do() {
        // Saturday 2026-11-21, 11:00 in Berlin.
        let now = 1_795_255_200_000;
        let check = |text: &str, expected: &str| {
            let read = parse(text, now, berlin).map(|millis| local(millis, berlin));
            assert_eq!(read.as_deref(), Some(expected), "{text}");
        };
        check("10:59", "2026-11-21 10:59:00");
        check("11:00:00", "2026-11-21 11:00:00");
        check("14:03", "2026-11-20 14:03:00");
        check("today", "2026-11-21 00:00:00");
        check("today 23:00", "2026-11-21 23:00:00");
        check("yesterday", "2026-11-20 00:00:00");
        check("yesterday 14:03", "2026-11-20 14:03:00");
        check("5 min ago", "2026-11-21 10:55:00");
        check("1.5h ago", "2026-11-21 09:30:00");
        check("2 days ago", "2026-11-19 11:00:00");
        check("2026-11-21 10:00", "2026-11-21 10:00:00");
        check("2026-07-01 10:00:00", "2026-07-01 10:00:00");
        check("2026-11-21 10:00:00Z", "2026-11-21 11:00:00");
        assert_eq!(parse("2026-07-01 10:00", now, berlin).map(text), Some("2026-07-01 08:00:00".to_owned()));
    }
}
