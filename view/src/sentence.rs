//! The words for reports, for changes of processes and for endings. The progress line, the record and the page use the same words.

use comms::logic::human::span;
use dbmanager::logic::view::date;
use node::logic::instance::{RESTARTS_MAX, WINDOW};
use node::logic::protocol::{Change, Ending, FailureCause, Report};
use node::logic::table::counted;
use std::time::Duration;

/// The words for a process whose program has ended after an unconfirmed stop.
pub const ENDED_LATE: &str = "has ended after all: its resources are free";

/// Returns a time since 1970 as UTC, to the second: `2026-11-23T00:00:00`.
pub fn date_and_time(since_1970: Duration) -> String {
    date::text(u64::try_from(since_1970.as_millis()).unwrap_or(u64::MAX)).replace(' ', "T")
}

/// Returns the time of day of a time since 1970, in UTC: `23:59:59`.
pub fn time_of_day(since_1970: Duration) -> String {
    date_and_time(since_1970).get(11..19).unwrap_or_default().to_owned()
}

/// Returns a report as one line.
pub fn report_text(report: &Report) -> String {
    match report {
        Report::Accepted { deployment } => format!("accepted as {deployment}"),
        Report::Prepared { host, leaves } => format!("{host}: {} up", counted(*leaves, "program")),
        Report::Connected { host } => format!("{host}: linked"),
        Report::Go { took, .. } => format!("GO after {:.1} s", took.as_secs_f64()),
        Report::Process { path, change, .. } => format!("{path} {}", change_text(change)),
        Report::Refused { reasons } => format!("refused: {}", reasons.join("; ")),
        Report::Programs { at } => format!("{} can be heard", counted(at.len(), "program")),
        Report::Finished { ending, .. } => format!("finished: {}", ending_text(ending)),
        Report::Changed { revision, by, changes } => {
            format!("changed by {by} (revision {revision}): {}", changes.join("; "))
        }
        Report::Unchanged { by, reasons } => format!("a change by {by} was taken back: {}", reasons.join("; ")),
        Report::Omitted { count } => {
            format!(
                "{} left out here: the home of the deployment keeps the first 1,000 and the latest reports",
                counted(*count, "report")
            )
        }
        Report::Aligned { lead, within } => format!(
            "the first step begins on all hosts {:.0} ms after GO, to within {}",
            lead.as_secs_f64() * 1000.0,
            span(*within)
        ),
        Report::BeganLate { host, by } => {
            format!("{host} began {} late: the order to start came too late, or its node was away", span(*by))
        }
        Report::Replanned { .. } => "now follows a changed plan".to_owned(),
        Report::Stepped { path, steps, .. } => format!("{path} took {}", counted(steps.len(), "step")),
    }
}

/// Returns a change of a process in words that follow the name of the process.
pub fn change_text(change: &Change) -> String {
    match change {
        Change::Activated => "activated".to_owned(),
        Change::Stopping => "asked to stop".to_owned(),
        Change::Ended(ending) => ending_text(ending),
        Change::Died(cause) => format!("died: {cause}"),
        Change::Started { pid } => format!("started as process {pid}"),
        Change::Restarting { cause, count } => restarting_text(cause, *count),
        Change::Resumed => "activated again".to_owned(),
        Change::Held { .. } | Change::HeldBy { .. } => change.held_text().unwrap_or_default(),
        Change::EndedLate => ENDED_LATE.to_owned(),
        Change::Switched(how) => how.text(),
        Change::Configured { parameter, value } => configured_text(parameter, value.as_deref()),
        Change::Says { text, .. } => text.clone(),
        Change::Entered { states } => entered_text(states),
        Change::Replacing => "is replaced".to_owned(),
        Change::Reverting { cause } => reverting_text(cause),
        Change::Renewing { with } => renewing_text(with),
    }
}

/// Returns the words for a program that is put back, since its replacement was not healthy.
pub fn reverting_text(cause: &FailureCause) -> String {
    format!("returns to the previous program, because the new program was not healthy: {cause}")
}

/// Returns the words for an activity that is in other states.
pub fn entered_text(states: &[String]) -> String {
    format!("is in {}", states.join(", "))
}

/// Returns the words for a process that is restarted with another one.
pub fn renewing_text(with: &str) -> String {
    format!("is started again with `{with}`, which has died")
}

/// Returns the words for a parameter that was set while the program runs; without a value it has the spec's value
/// again.
pub fn configured_text(parameter: &str, value: Option<&str>) -> String {
    match value {
        Some(value) => format!("was told that `{parameter}` is {value}"),
        None => format!("was told that `{parameter}` has the value of the spec"),
    }
}

/// Returns the words for a program that has died for the `count`th time and is started again.
pub fn restarting_text(cause: &FailureCause, count: u32) -> String {
    format!("died and is started again ({count} of {RESTARTS_MAX} in {} s): {cause}", WINDOW.as_secs())
}

/// Returns an ending in words.
pub fn ending_text(ending: &Ending) -> String {
    match ending {
        Ending::Done(_) => "done".to_owned(),
        Ending::Aborted(failure) => format!("aborted: {failure}"),
        Ending::Stopped => "stopped".to_owned(),
        Ending::Unconfirmed => "its stop could not be confirmed".to_owned(),
    }
}
