//! The progress of long work, for a person who waits: which part is done, and an estimate of the remaining time.

use crate::logic::estimate::{Estimate, PATIENCE};
use crate::logic::mission::{Line, Style};
use crate::output::Output;
use comms::io::clock;
use comms::logic::time::Time;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often the line on a terminal is drawn again.
const DRAWN_EVERY: Duration = Duration::from_millis(200);
/// How often a line is printed to a file or a pipe.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// The progress of some work. Nothing is shown if the work ends soon.
#[derive(Debug)]
pub(crate) struct Work(Mutex<ProgressLine>);

#[derive(Debug)]
struct ProgressLine {
    output: Output,
    estimate: Estimate,
    begun: Time,
    last: Option<Time>,
}

impl Work {
    /// Begins to measure the time.
    pub(crate) fn new() -> Self {
        let told =
            ProgressLine { output: Output::standard(), estimate: Estimate::default(), begun: clock::now(), last: None };
        Self(Mutex::new(told))
    }

    /// Notes how many jobs of a kind are done.
    pub(crate) fn jobs(&self, what: &'static str, done: usize, of: usize) {
        let mut told = self.told();
        let at = clock::now().since(told.begun);
        told.estimate.jobs(at, what, done, of);
        told.tell();
    }

    /// Notes how many states an exploration has found.
    pub(crate) fn states(&self, count: u32) {
        let mut told = self.told();
        told.estimate.states(count);
        told.tell();
    }

    fn told(&self) -> MutexGuard<'_, ProgressLine> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ProgressLine {
    fn tell(&mut self) {
        let now = clock::now();
        let (patience, every) = match self.output.style() {
            Style::Terminal(_) => (PATIENCE, DRAWN_EVERY),
            Style::Plain => (LINE_EVERY, LINE_EVERY),
        };
        let elapsed = now.since(self.begun);
        if elapsed < patience || self.last.is_some_and(|last| now.since(last) < every) {
            return;
        }
        self.last = Some(now);
        self.output.line(&Line::Live(self.estimate.line(elapsed)));
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        self.output.clear();
    }
}
