//! The bounded queue to the recorder. A full queue drops samples; no producer waits for it.

use crate::logic::record::Entry;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The queue accepts a sample while it is shorter than this: about two seconds of a busy robot.
pub(super) const SAMPLES: usize = 4_096;
/// The queue accepts a value of a wire while it is shorter than this. Values may be large.
pub(super) const PORTS: usize = 256;
/// The queue accepts a report while it is shorter than this.
pub(super) const REPORTS: usize = 2 * SAMPLES;

/// The next work of the recorder.
#[derive(Debug)]
pub(super) enum Work {
    /// An entry, and when it came, since 1970.
    Entry(Box<Entry>, Duration),
    /// No entry has come within the timeout.
    Nothing,
    /// The queue is closed and empty.
    Closed,
}

#[derive(Debug, Default)]
pub(super) struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    entries: VecDeque<(Entry, Duration)>,
    dropped: u64,
    closed: bool,
}

impl Queue {
    /// Adds an entry that came at `arrived`. If the queue is closed or has `limit` entries already, the entry is dropped and counted.
    pub(super) fn push(&self, entry: Entry, arrived: Duration, limit: usize) {
        let mut state = self.lock();
        if state.closed || state.entries.len() >= limit {
            state.dropped += 1;
        } else {
            state.entries.push_back((entry, arrived));
            self.changed.notify_one();
        }
    }

    /// Takes the oldest entry out. If there is none, waits for one, at most for `timeout`.
    pub(super) fn pop(&self, timeout: Duration) -> Work {
        let mut state = self.lock();
        if state.entries.is_empty() && !state.closed {
            let waited = self.changed.wait_timeout(state, timeout);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        match state.entries.pop_front() {
            Some((entry, arrived)) => Work::Entry(Box::new(entry), arrived),
            None if state.closed => Work::Closed,
            None => Work::Nothing,
        }
    }

    /// Refuses all further entries.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }

    /// Returns how many entries were dropped.
    pub(super) fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code panics while it holds the lock, so the data is always consistent.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
