//! The state of a process as one of a few marks, for pictures.

use crate::deployment::Health;
use crate::sentence::change_text;
use crate::text::clean;
use node::logic::protocol::{Change, Ending};

/// How a process is, in a picture: each mark has its own sign, word and colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// It runs.
    Running,
    /// It waits to be activated.
    Idle,
    /// It is on its way from one state to another.
    Changing,
    /// Its last activation is done.
    Done,
    /// Its last activation was stopped.
    Stopped,
    /// It has failed.
    Failed,
    /// Its host does not answer.
    Lost,
}

/// How the last activation of a process has ended, according to events.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LastEnd {
    /// Its mark.
    pub mark: Mark,
    /// How, for a person.
    pub text: String,
}

impl Mark {
    /// Returns the mark of a process.
    pub fn new(health: Health, last: Option<&LastEnd>) -> Self {
        match health {
            Health::Running => Self::Running,
            Health::Changing => Self::Changing,
            Health::Failed => Self::Failed,
            Health::Unknown => Self::Lost,
            Health::Quiet => last.map_or(Self::Idle, |last| last.mark),
        }
    }

    /// Returns it in one word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Idle => "idle",
            Self::Changing => "changing",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Lost => "lost",
        }
    }
}

impl LastEnd {
    /// Takes a change of a process in.
    pub(crate) fn after(change: &Change, before: Option<Self>) -> Option<Self> {
        let mark = match change {
            Change::Ended(Ending::Done(_)) => Mark::Done,
            Change::Ended(Ending::Stopped) => Mark::Stopped,
            Change::Ended(Ending::Aborted(_) | Ending::Unconfirmed) | Change::Died(_) => Mark::Failed,
            Change::Activated
            | Change::Resumed
            | Change::Restarting { .. }
            | Change::Replacing
            | Change::Reverting { .. }
            | Change::Renewing { .. } => return None,
            Change::Stopping
            | Change::Started { .. }
            | Change::Held { .. }
            | Change::HeldBy { .. }
            | Change::Configured { .. }
            | Change::EndedLate
            | Change::Switched(_)
            | Change::Says { .. }
            | Change::Entered { .. } => return before,
        };
        // The box of the process in which a failure began has the same mark, so its path is left out.
        let text = if let Change::Ended(Ending::Aborted(failure)) = change {
            format!("aborted: {}", failure.cause)
        } else {
            change_text(change)
        };
        Some(Self { mark, text: clean(&text) })
    }
}
