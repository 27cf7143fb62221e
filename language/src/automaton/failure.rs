//! The reasons of failures, which transitions and the arms of `else match` can name.

use crate::algebra::{Cause, Value};
use crate::plan::{DEADLINE, text_value};
use crate::script::ScriptErrorKind;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The reason of a failure. Each failure has exactly one reason, and keeps it in groups and operators.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Failure {
    /// A program has reported a failure.
    Reported,
    /// The process was already running.
    Busy,
    /// A stop was not confirmed.
    StopUnconfirmed,
    /// A service has ended.
    ServiceEnded,
    /// A `fail` or `abort` with this text.
    Failed(String),
    /// No arm of a `match` fits the tag.
    NoMatch,
    /// The time of a `within` has passed.
    Timeout,
    /// A program has died, hangs, or could not be started.
    Crash,
    /// A host was lost.
    HostLost,
    /// A script has used up its budget.
    ScriptBudget,
    /// A script has made an error.
    ScriptFailed,
}

impl Failure {
    /// The reasons that a spec names with a word.
    pub const WORDS: [(&'static str, Self); 10] = [
        ("timeout", Self::Timeout),
        ("reported", Self::Reported),
        ("crash", Self::Crash),
        ("host_lost", Self::HostLost),
        ("busy", Self::Busy),
        ("stop_unconfirmed", Self::StopUnconfirmed),
        ("service_ended", Self::ServiceEnded),
        ("no_match", Self::NoMatch),
        ("script_budget", Self::ScriptBudget),
        ("script_failed", Self::ScriptFailed),
    ];

    /// The reasons without a text that a report can carry. The second byte of the report says the reason. The first byte is 0, so that the
    /// report is neither a text nor a tag.
    const MARKS: [(Self, u8); 7] = [
        (Self::Busy, 1),
        (Self::ServiceEnded, 2),
        (Self::NoMatch, 3),
        (Self::Crash, 4),
        (Self::HostLost, 5),
        (Self::ScriptBudget, 6),
        (Self::ScriptFailed, 7),
    ];

    /// Returns the reason that a word names.
    pub fn of_word(word: &str) -> Option<Self> {
        Self::WORDS.into_iter().find(|(known, _)| *known == word).map(|(_, failure)| failure)
    }

    /// Returns one reason for all failures that no part of a spec asks for. Packed states use it. No spec can name it.
    pub fn other() -> Self {
        Self::Failed("\0".to_owned())
    }

    /// Returns the report of a member that has failed for this reason. The report of an unconfirmed stop is empty, because it is an event of
    /// its own.
    pub fn report(&self) -> Value {
        match self {
            Self::Failed(text) => text_value(text),
            Self::Timeout => text_value(DEADLINE),
            Self::Reported
            | Self::Busy
            | Self::StopUnconfirmed
            | Self::ServiceEnded
            | Self::NoMatch
            | Self::Crash
            | Self::HostLost
            | Self::ScriptBudget
            | Self::ScriptFailed => {
                let mark = Self::MARKS.iter().find(|(marked, _)| marked == self);
                mark.map_or(Value::EMPTY, |(_, number)| Value::new(&[0, *number]))
            }
        }
    }

    /// Returns the reason in the report of a member.
    pub fn of_report(report: &Value) -> Self {
        if let Some(text) = report.text() {
            return Self::of_text(text);
        }
        let is_it = |(_, number): &(Self, u8)| report.bytes() == [0, *number];
        Self::MARKS.into_iter().find(is_it).map_or(Self::Reported, |(marked, _)| marked)
    }

    /// Returns the reason of a `fail` with this text.
    pub(crate) fn of_text(text: &str) -> Self {
        if text.starts_with(DEADLINE) { Self::Timeout } else { Self::Failed(text.to_owned()) }
    }

    /// Returns the reason of an abort.
    pub fn of(cause: &Cause) -> Self {
        match cause {
            Cause::Reported(report) => Self::of_report(report),
            Cause::Failed(why) => Self::of_text(why),
            Cause::Busy => Self::Busy,
            Cause::StopUnconfirmed => Self::StopUnconfirmed,
            Cause::ServiceEnded => Self::ServiceEnded,
            Cause::NoMatch => Self::NoMatch,
            Cause::Script(error) => Self::of_script(error.kind),
        }
    }

    /// Returns the reason of a failed script.
    pub fn of_script(kind: ScriptErrorKind) -> Self {
        match kind {
            ScriptErrorKind::Budget => Self::ScriptBudget,
            ScriptErrorKind::Failed => Self::ScriptFailed,
        }
    }

    /// Returns whether an abort has this reason. The text of a time limit also matches as a text.
    pub(crate) fn is_of(&self, cause: &Cause) -> bool {
        match (self, cause) {
            (Self::Failed(text), Cause::Failed(why)) => **text == **why,
            (Self::Failed(text), Cause::Reported(report)) => text_value(text) == *report,
            (_, _) => Self::of(cause) == *self,
        }
    }

    /// Returns a text for people, if the reason has no text of its own.
    pub(crate) fn words(&self) -> Option<&'static str> {
        match self {
            Self::Busy => Some("busy"),
            Self::StopUnconfirmed => Some("stop unconfirmed"),
            Self::ServiceEnded => Some("service ended"),
            Self::NoMatch => Some("no arm for this outcome"),
            Self::Crash => Some("crash"),
            Self::HostLost => Some("host lost"),
            Self::ScriptBudget => Some("script over its budget"),
            Self::ScriptFailed => Some("script failed"),
            Self::Reported | Self::Failed(_) | Self::Timeout => None,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self, Self::WORDS.iter().find(|(_, known)| known == self)) {
            (Self::Failed(text), _) => write!(f, "{text:?}"),
            (_, Some((word, _))) => f.write_str(word),
            (_, None) => Ok(()),
        }
    }
}
