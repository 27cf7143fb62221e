//! The state of a mission for people: its phases, the peaks of its signals, its end and the cause of the end.
//!
//! A [`Mission`] is computed from the plan, the [`Report`]s of the deployment and the [`Signals`] of its programs, in
//! the order in which they arrive. It contains nothing that is special to one task. The same input gives the same
//! result, in a live display and in a report of a record a year later.

mod late;
mod losses;
mod phases;
mod progress;
mod signals;
mod start;
mod summary;

pub use phases::{DecidingMember, PHASES_MAX, Phase};
pub use progress::{Line, Progress, Style};
pub use signals::{TRACKS_MAX, Track};
pub use start::Start;
pub use summary::{Files, failure_chain, failure_output, summary};

use comms::logic::signals::Signals;
use language::plan::Plan;
use late::Late;
use losses::ProgramLosses;
use node::logic::protocol::{Change, Deployment, Ending, Failure, Report};
use phases::Phases;
use signals::Tracks;
use std::time::Duration;
use view::sentence::{
    ENDED_LATE, configured_text, entered_text, renewing_text, report_text, restarting_text, reverting_text,
};

/// The largest number of stored notes: the first half keeps the first notes, the other half keeps the latest notes. The
/// others are counted. Routine notes are dropped first.
pub const NOTES_MAX: usize = 200;

/// A deployment seen from outside.
#[derive(Debug, Clone)]
pub struct Mission {
    name: String,
    deployment: Option<Deployment>,
    start: Start,
    phases: Phases,
    tracks: Tracks,
    late: Late,
    losses: ProgramLosses,
    notes: Vec<Note>,
    notes_dropped: usize,
    verdict: Option<Verdict>,
    now: Duration,
}

/// How a mission ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// The outcome, with its details.
    pub outcome: Outcome,
    /// Time since GO; zero if there was no GO.
    pub at: Duration,
    /// The hosts that could not confirm that nothing of the deployment is left.
    pub unconfirmed: Vec<String>,
}

/// The end of a mission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// `main` ended normally.
    Done,
    /// `main` failed.
    Aborted(Failure),
    /// The mission was asked to stop.
    Stopped,
    /// It is not known how the mission ended.
    Unconfirmed,
    /// The mission was never started.
    Refused(Vec<String>),
}

impl Outcome {
    /// Returns the outcome in one word.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Aborted(_) => "aborted",
            Self::Stopped => "stopped",
            Self::Unconfirmed => "unconfirmed",
            Self::Refused(_) => "refused",
        }
    }
}

/// Something unusual that a person should see at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// Time since GO.
    pub at: Duration,
    /// Path of the process, without the leading `main/`.
    pub process: String,
    /// The event.
    pub text: String,
    /// The last lines that the program wrote before it failed.
    pub output: Vec<String>,
    /// The position of this note among all notes of the mission.
    pub number: usize,
    /// Whether the note may be left out when there are many. Questions and failures are never routine.
    pub is_routine: bool,
}

impl Mission {
    /// Returns the mission of `plan` before anything happened.
    pub fn new(plan: &Plan) -> Self {
        Self {
            name: plan.name.clone(),
            deployment: None,
            start: Start::new(plan),
            phases: Phases::new(plan),
            tracks: Tracks::default(),
            late: Late::new(plan),
            losses: ProgramLosses::default(),
            notes: Vec::new(),
            notes_dropped: 0,
            verdict: None,
            now: Duration::ZERO,
        }
    }

    /// Adds the next report.
    pub fn report(&mut self, report: &Report) {
        match report {
            Report::Accepted { deployment } => self.deployment = Some(deployment.clone()),
            Report::Programs { .. } | Report::Stepped { .. } => {}
            Report::Replanned { plan } => {
                self.phases.replan(plan);
                self.late.replan(plan);
            }
            Report::Changed { .. } | Report::Unchanged { .. } | Report::Omitted { .. } => {
                self.note_of_main(report);
            }
            Report::Prepared { host, leaves } => self.start.prepared(host, *leaves),
            Report::Connected { host } => self.start.connected(host),
            Report::Aligned { within, .. } => self.start.aligned(*within),
            Report::BeganLate { .. } => self.note_of_main(report),
            Report::Go { took, signals: _ } => self.start.go(*took),
            Report::Process { path, change, at } => {
                self.now = self.now.max(*at);
                self.phases.change(path, change, *at);
                self.late.change(path, change);
                self.note(path, change, *at);
            }
            Report::Refused { reasons } => self.finish(Outcome::Refused(reasons.clone()), self.now, &[]),
            Report::Finished { ending, at, unconfirmed } => {
                let outcome = match ending {
                    Ending::Done(_) => Outcome::Done,
                    Ending::Aborted(failure) => Outcome::Aborted(failure.clone()),
                    Ending::Stopped => Outcome::Stopped,
                    Ending::Unconfirmed => Outcome::Unconfirmed,
                };
                self.finish(outcome, *at, unconfirmed);
            }
        }
    }

    /// Adds a sample of the program `path` that came `at` after GO. Values that are not finite are left out. Counts of
    /// losses are also added after the end, because the last sample may arrive after it.
    pub fn signals(&mut self, path: &str, at: Duration, sample: &Signals) {
        self.losses.take(path, sample);
        if self.verdict.is_some() {
            return;
        }
        self.now = self.now.max(at);
        for signal in &sample.values {
            if signal.value.is_finite() {
                let Some(track) = self.tracks.push(path, at, signal) else { continue };
                self.phases.sample(track, signal.value, at);
            }
        }
    }

    /// Adds whole lines of the program `path`. Lines that arrive after the end are also included.
    pub fn wrote(&mut self, path: &str, text: &str) {
        self.late.wrote(path, text);
    }

    /// Sets the time when nothing has happened.
    pub fn tick(&mut self, now: Duration) {
        if self.start.is_running() && self.verdict.is_none() {
            self.now = self.now.max(now);
        }
    }

    /// Returns the name of the deployment.
    pub fn name(&self) -> &str {
        self.deployment.as_ref().map_or(&self.name, |deployment| &deployment.name)
    }

    /// Returns the name and the epoch, once the deployment is accepted.
    pub fn deployment(&self) -> Option<&Deployment> {
        self.deployment.as_ref()
    }

    /// Returns the progress of the start.
    pub fn start(&self) -> &Start {
        &self.start
    }

    /// Returns every phase so far, the current one last.
    pub fn phases(&self) -> &[Phase] {
        self.phases.all()
    }

    /// Returns the phase that is running.
    pub fn phase(&self) -> Option<&Phase> {
        self.phases.all().last().filter(|phase| phase.end.is_none())
    }

    /// Returns the programs that run now inside groups of the current phase: paths below its group, `hit/force`.
    pub fn inner(&self) -> impl Iterator<Item = &str> {
        self.phases.inner()
    }

    /// Returns the length of the longest phase name of the plan.
    pub fn phase_width(&self) -> usize {
        self.phases.name_width()
    }

    /// Returns how many phases were dropped before the first phase of [`Mission::phases`].
    pub fn phases_dropped(&self) -> usize {
        self.phases.dropped()
    }

    /// Returns every signal seen so far, in the order of first appearance.
    pub fn tracks(&self) -> &[Track] {
        self.tracks.all()
    }

    /// Returns the signals that belong on a one-line display, each with its index in [`Mission::tracks`].
    pub fn headlines(&self) -> impl Iterator<Item = (usize, &Track)> {
        self.tracks.all().iter().enumerate().filter(|(_, track)| track.headline)
    }

    /// Returns the title of a track: its name, and the program if two programs use the same name.
    pub fn title(&self, track: &Track) -> String {
        self.tracks.title(track)
    }

    /// Returns the unusual events.
    pub fn notes(&self) -> &[Note] {
        &self.notes
    }

    /// Returns each program whose inputs have lost or refused values, or whose outputs have not delivered values, without the leading
    /// `main/`, with the number of values in words.
    pub fn losses(&self) -> impl Iterator<Item = (&str, String)> {
        self.losses.texts().map(|(path, text)| (short(path), text))
    }

    /// Returns how many notes were left out.
    pub fn notes_dropped(&self) -> usize {
        self.notes_dropped
    }

    /// Returns how the mission ended, if it has ended.
    pub fn verdict(&self) -> Option<&Verdict> {
        self.verdict.as_ref()
    }

    /// Returns the latest known time since GO.
    pub fn now(&self) -> Duration {
        self.now
    }

    fn finish(&mut self, outcome: Outcome, at: Duration, unconfirmed: &[String]) {
        self.now = self.now.max(at);
        self.phases.finish(at);
        self.verdict = Some(Verdict { outcome, at, unconfirmed: unconfirmed.to_vec() });
    }

    fn note(&mut self, path: &str, change: &Change, at: Duration) {
        let (text, output) = match change {
            Change::Ended(Ending::Aborted(failure)) if failure.origin == path => {
                (format!("aborted: {}", failure.cause), failure.cause.output())
            }
            Change::Ended(Ending::Unconfirmed) => ("its stop could not be confirmed".to_owned(), &[][..]),
            Change::Died(cause) => (format!("died: {cause}"), cause.output()),
            Change::Restarting { cause, count } => (restarting_text(cause, *count), cause.output()),
            Change::Held { .. } | Change::HeldBy { .. } => (change.held_text().unwrap_or_default(), &[][..]),
            Change::EndedLate => (ENDED_LATE.to_owned(), &[][..]),
            Change::Switched(how) if how.is_smooth() => return,
            Change::Switched(how) => (how.text(), &[][..]),
            Change::Configured { parameter, value } => (configured_text(parameter, value.as_deref()), &[][..]),
            Change::Reverting { cause } => (reverting_text(cause), cause.output()),
            Change::Says { text, .. } => (text.clone(), &[][..]),
            // The states of this activity are the phases, so they need no note.
            Change::Entered { .. } if self.phases.is_of_states(path) => return,
            Change::Entered { states } => (entered_text(states), &[][..]),
            Change::Replacing => ("is replaced".to_owned(), &[][..]),
            Change::Renewing { with } => (renewing_text(with), &[][..]),
            Change::Activated | Change::Stopping | Change::Ended(_) | Change::Started { .. } | Change::Resumed => {
                return;
            }
        };
        let note = Note {
            at,
            process: short(path).to_owned(),
            text,
            output: output.to_vec(),
            number: 0,
            is_routine: is_routine(change),
        };
        self.keep(note);
    }

    fn note_of_main(&mut self, report: &Report) {
        let (at, text) = (self.now, report_text(report));
        self.keep(Note { at, process: "main".to_owned(), text, output: Vec::new(), number: 0, is_routine: false });
    }

    fn keep(&mut self, note: Note) {
        let number = self.notes_dropped + self.notes.len();
        if self.notes.len() == NOTES_MAX {
            let place = self.notes.iter().skip(NOTES_MAX / 2).position(|note| note.is_routine).unwrap_or(0);
            self.notes.remove(NOTES_MAX / 2 + place);
            self.notes_dropped += 1;
        }
        self.notes.push(Note { number, ..note });
    }
}

/// Returns whether a change is so frequent in a working activity that a person need not see each one.
fn is_routine(change: &Change) -> bool {
    matches!(change, Change::Entered { .. } | Change::Says { is_routine: true, .. })
}

/// Returns `path` without the leading `main/`, with which all paths begin.
pub(crate) fn short(path: &str) -> &str {
    path.strip_prefix("main/").unwrap_or(path)
}

/// Formats a time as `22.1 s`.
pub(crate) fn seconds(time: Duration) -> String {
    format!("{:.1} s", time.as_secs_f64())
}

#[cfg(test)]
pub(crate) mod tests;
