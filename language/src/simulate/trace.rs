//! The events in a story of a verifier. Each event is one line of text: `done main/arm found`, `elapsed main 1`, `lost
//! c2`.

use crate::automaton::Failure;
use crate::script::ScriptErrorKind;
use crate::syntax::ast::content;
use std::fmt;
use std::str::FromStr;

/// An event of a running plan. Processes and groups are named by their paths.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TraceEvent {
    /// This group starts. It is the whole of the story.
    Start(String),
    /// The whole of the story is asked to stop.
    Stop,
    /// A process has ended normally, with the outcome of this name if it has one.
    Done(String, Option<String>),
    /// A process has failed. If there is a reason, the failure has this reason.
    Fails(String, Option<Failure>),
    /// A process that was asked to stop has stopped.
    Stopped(String),
    /// The time of a `wait` or a limit of a group has passed. The number counts the waits and limits in the order of
    /// the text, from 1.
    Elapsed(String, u32),
    /// An order to stop arrives at a group.
    Reached(String),
    /// An order to start a process arrives at its host.
    Arrived(String),
    /// A supervisor receives the report that a group on another host has ended.
    Heard(String),
    /// A fault strikes a program.
    Struck(ProgramFault, String),
    /// A program has died, and it will be started again.
    Dies(String),
    /// A program that died runs again.
    Back(String),
    /// The programs of a group have died more often than the group allows.
    TooMany(String),
    /// A host is lost, with everything on it.
    Lost(String),
    /// A host continues, but can reach no other host.
    Cut(String),
    /// The node of a host notes that another host is lost.
    Noted(String),
    /// An activity gets a message. The number counts the messages that the activity distinguishes, from 1.
    Told(String, u32),
    /// The next script of an activity fails.
    Script(String, ScriptErrorKind),
}

/// A fault of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ProgramFault {
    /// The program dies. Its policy decides whether it is started again.
    Crash,
    /// The program dies, and has died too often to be started again.
    CrashTooOften,
    /// The program dies, and with it the programs of the group have died more often than the group allows.
    CrashTooMany,
    /// The program hangs: it never ends by itself.
    Hang,
    /// The stop of the program cannot be confirmed.
    Unanswered,
}

/// The error for a line that is not understood.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected what happens, such as `done main/arm`, `fails main/arm`, `elapsed main 1`, `stop` or `lost c2`, found `{line}`"
)]
pub struct TraceError {
    /// The line.
    pub line: String,
}

impl ProgramFault {
    const ALL: [Self; 5] = [Self::Crash, Self::CrashTooOften, Self::CrashTooMany, Self::Hang, Self::Unanswered];

    /// Returns the word for this fault.
    pub fn word(self) -> &'static str {
        match self {
            Self::Crash => "crash",
            Self::CrashTooOften => "crash-too-often",
            Self::CrashTooMany => "crash-too-many",
            Self::Hang => "hang",
            Self::Unanswered => "unanswered",
        }
    }
}

impl TraceEvent {
    /// Returns the path of the process or group of the event. Returns none if the event is about the whole or a host.
    pub fn path(&self) -> Option<&str> {
        match self {
            Self::Start(path)
            | Self::Done(path, _)
            | Self::Fails(path, _)
            | Self::Stopped(path)
            | Self::Elapsed(path, _)
            | Self::Reached(path)
            | Self::Arrived(path)
            | Self::Heard(path)
            | Self::Struck(_, path)
            | Self::Dies(path)
            | Self::Back(path)
            | Self::TooMany(path)
            | Self::Told(path, _)
            | Self::Script(path, _) => Some(path),
            Self::Stop | Self::Lost(_) | Self::Cut(_) | Self::Noted(_) => None,
        }
    }
}

impl fmt::Display for TraceEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start(path) => write!(f, "start {path}"),
            Self::Stop => write!(f, "stop"),
            Self::Done(path, None) => write!(f, "done {path}"),
            Self::Done(path, Some(tag)) => write!(f, "done {path} {tag}"),
            Self::Fails(path, None) => write!(f, "fails {path}"),
            Self::Fails(path, Some(failure)) => write!(f, "fails {path} {failure}"),
            Self::Stopped(path) => write!(f, "stopped {path}"),
            Self::Elapsed(path, number) => write!(f, "elapsed {path} {number}"),
            Self::Reached(path) => write!(f, "reached {path}"),
            Self::Arrived(path) => write!(f, "arrived {path}"),
            Self::Heard(path) => write!(f, "heard {path}"),
            Self::Struck(fault, path) => write!(f, "{} {path}", fault.word()),
            Self::Dies(path) => write!(f, "dies {path}"),
            Self::Back(path) => write!(f, "back {path}"),
            Self::TooMany(path) => write!(f, "too-many {path}"),
            Self::Lost(host) => write!(f, "lost {host}"),
            Self::Cut(host) => write!(f, "cut {host}"),
            Self::Noted(host) => write!(f, "noted {host}"),
            Self::Told(path, number) => write!(f, "told {path} {number}"),
            Self::Script(path, kind) => write!(f, "script {path} {}", Failure::of_script(*kind)),
        }
    }
}

impl FromStr for TraceEvent {
    type Err = TraceError;

    fn from_str(line: &str) -> Result<Self, TraceError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let event = match *words.as_slice() {
            ["stop"] => Some(Self::Stop),
            ["done", path, tag] => Some(Self::Done(path.to_owned(), Some(tag.to_owned()))),
            ["elapsed", path, number] => {
                let number = number.parse().ok().filter(|number| *number > 0);
                number.map(|number| Self::Elapsed(path.to_owned(), number))
            }
            ["told", path, number] => {
                let number = number.parse().ok().filter(|number| *number > 0);
                number.map(|number| Self::Told(path.to_owned(), number))
            }
            ["script", path, word] => {
                let is_it = |kind: &ScriptErrorKind| Some(Failure::of_script(*kind)) == Failure::of_word(word);
                let kind = ScriptErrorKind::ALL.into_iter().find(is_it);
                kind.map(|kind| Self::Script(path.to_owned(), kind))
            }
            [word, name] => of_one(word, name.to_owned()),
            ["fails", path, ..] => reason(line, path).map(|failure| Self::Fails(path.to_owned(), Some(failure))),
            _ => None,
        };
        event.ok_or_else(|| TraceError { line: line.trim().to_owned() })
    }
}

/// Returns the reason after the path: a word, or a text in quotes.
fn reason(line: &str, path: &str) -> Option<Failure> {
    let (_, reason) = line.split_once(path)?;
    let reason = reason.trim();
    let is_text = reason.len() > 1 && reason.starts_with('"') && reason.ends_with('"');
    if is_text { Some(Failure::Failed(content(reason))) } else { Failure::of_word(reason) }
}

/// Returns the event of a word that needs one process, group or host.
fn of_one(word: &str, name: String) -> Option<TraceEvent> {
    Some(match word {
        "start" => TraceEvent::Start(name),
        "done" => TraceEvent::Done(name, None),
        "fails" => TraceEvent::Fails(name, None),
        "stopped" => TraceEvent::Stopped(name),
        "reached" => TraceEvent::Reached(name),
        "arrived" => TraceEvent::Arrived(name),
        "heard" => TraceEvent::Heard(name),
        "dies" => TraceEvent::Dies(name),
        "back" => TraceEvent::Back(name),
        "too-many" => TraceEvent::TooMany(name),
        "lost" => TraceEvent::Lost(name),
        "cut" => TraceEvent::Cut(name),
        "noted" => TraceEvent::Noted(name),
        _ => {
            let fault = ProgramFault::ALL.into_iter().find(|fault| fault.word() == word)?;
            TraceEvent::Struck(fault, name)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_event_is_a_line_and_back() {
        let path = || "main/a".to_owned();
        let mut events = vec![
            TraceEvent::Start("main".to_owned()),
            TraceEvent::Stop,
            TraceEvent::Done(path(), None),
            TraceEvent::Done(path(), Some("found".to_owned())),
            TraceEvent::Fails(path(), None),
            TraceEvent::Fails(path(), Some(Failure::HostLost)),
            TraceEvent::Fails(path(), Some(Failure::Failed("no \"way\" \\ there".to_owned()))),
            TraceEvent::Stopped(path()),
            TraceEvent::Elapsed(path(), 2),
            TraceEvent::Reached(path()),
            TraceEvent::Arrived(path()),
            TraceEvent::Heard(path()),
            TraceEvent::Dies(path()),
            TraceEvent::Back(path()),
            TraceEvent::TooMany(path()),
            TraceEvent::Lost("c1".to_owned()),
            TraceEvent::Cut("c1".to_owned()),
            TraceEvent::Noted("c1".to_owned()),
            TraceEvent::Told(path(), 3),
            TraceEvent::Script(path(), ScriptErrorKind::Budget),
        ];
        events.extend(ProgramFault::ALL.map(|fault| TraceEvent::Struck(fault, path())));
        for event in events {
            assert_eq!(event.to_string().parse(), Ok(event));
        }
        for line in [
            "",
            "done",
            "elapsed main 0",
            "elapsed main x",
            "eats main/a",
            "stop main",
            "done a b c",
            "fails a b",
            "fails a \"",
        ] {
            assert!(line.parse::<TraceEvent>().is_err(), "{line}");
        }
    }
}
