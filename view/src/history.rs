//! The changes of processes over time, for pictures. The oldest ones leave.

use crate::deployment::DETAILS_MAX;
use crate::identity::MissionId;
use crate::ring::Ring;
use crate::text::clean;
use comms::logic::time::Time;
use node::logic::protocol::{Change, Ending, Failure, FailureCause};

/// The most changes, of all deployments together.
const CHANGES_MAX: usize = 8000;

/// A change of a process.
#[derive(Clone, Debug)]
pub struct PastChange {
    mission: MissionId,
    /// The absolute path of the process.
    pub path: String,
    /// When it was, by the clock of the view.
    pub at: Time,
    /// The change. Its texts are safe and short.
    pub change: Change,
}

/// The changes.
#[derive(Clone, Debug)]
pub(crate) struct History {
    changes: Ring<PastChange>,
    /// Up to when changes have left.
    left: Time,
}

impl History {
    pub(crate) fn new() -> Self {
        Self { changes: Ring::new(CHANGES_MAX), left: Time::ZERO }
    }

    /// Adds a change of a process, whose path is a name.
    pub(crate) fn push(&mut self, number: u64, mission: &MissionId, path: &str, change: &Change, at: Time) {
        let Some(change) = short(change) else { return };
        let new = PastChange { mission: mission.clone(), path: path.to_owned(), at, change };
        let gone = self.changes.push(number, new);
        self.left = gone.map_or(self.left, |oldest| self.left.max(oldest.at));
    }

    /// Returns the changes of a deployment in the order in which they were reported.
    pub(crate) fn of(&self, mission: &MissionId) -> impl Iterator<Item = &PastChange> {
        self.changes.iter().filter(move |one| one.mission == *mission)
    }

    /// Returns the time up to which changes may be missing.
    pub(crate) fn left(&self) -> Time {
        self.left
    }
}

/// Returns a change with short texts; none if pictures do not show it.
fn short(change: &Change) -> Option<Change> {
    // The words for a cause are kept, not its parts.
    let cause = |cause: &FailureCause| FailureCause::Reported(clean(&cause.to_string()));
    Some(match change {
        Change::Ended(Ending::Done(_)) => Change::Ended(Ending::Done(Vec::new())),
        Change::Ended(Ending::Aborted(Failure { origin, cause: of, at })) => {
            Change::Ended(Ending::Aborted(Failure { origin: clean(origin), cause: cause(of), at: *at }))
        }
        Change::Died(of) => Change::Died(cause(of)),
        Change::Restarting { cause: of, count } => Change::Restarting { cause: cause(of), count: *count },
        Change::Reverting { cause: of } => Change::Reverting { cause: cause(of) },
        Change::Held { resource, host } => Change::Held { resource: clean(resource), host: clean(host) },
        Change::HeldBy { resource, by, host } => {
            Change::HeldBy { resource: clean(resource), by: clean(by), host: clean(host) }
        }
        Change::Configured { parameter, value } => {
            Change::Configured { parameter: clean(parameter), value: value.as_deref().map(clean) }
        }
        Change::Renewing { with } => Change::Renewing { with: clean(with) },
        Change::Says { text, is_routine } => Change::Says { text: clean(text), is_routine: *is_routine },
        Change::Entered { states } => {
            Change::Entered { states: states.iter().take(DETAILS_MAX).map(|state| clean(state)).collect() }
        }
        Change::Switched(_) => return None,
        Change::Activated
        | Change::Stopping
        | Change::Ended(Ending::Stopped | Ending::Unconfirmed)
        | Change::Started { .. }
        | Change::Resumed
        | Change::Replacing
        | Change::EndedLate => change.clone(),
    })
}
