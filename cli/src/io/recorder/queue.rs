//! The bounded queue to the recorder. A full queue drops samples; no producer waits for it.

use crate::logic::record::Entry;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The queue accepts a sample while it has fewer samples and reports than this: about two seconds of a busy robot.
pub(super) const SAMPLES: usize = 4_096;
/// The queue accepts a report while it has fewer samples and reports than this.
const REPORTS: usize = 2 * SAMPLES;
/// The most bytes of values of wires in the queue: a second of several cameras.
pub(super) const VALUES_SIZE_MAX: usize = 64 << 20;
/// A value of a wire counts as at least this many bytes, so the queue has at most 32,768 values.
const VALUE_MIN: usize = 2 << 10;

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
    /// The bytes of the values of wires in the queue, and the number of these values.
    values_size: usize,
    values: usize,
    /// How many samples and reports were dropped.
    dropped: u64,
    closed: bool,
}

/// Returns the size of a value of a wire; nothing for another entry.
fn size(entry: &Entry) -> Option<usize> {
    match entry {
        Entry::Port { bytes, .. } => Some(bytes.len().max(VALUE_MIN)),
        Entry::Report(_) | Entry::Signals { .. } | Entry::Output { .. } | Entry::Missing { .. } => None,
    }
}

impl State {
    /// Returns whether there is room for an entry.
    fn has_room(&self, entry: &Entry) -> bool {
        let others = self.entries.len() - self.values;
        match entry {
            Entry::Report(_) | Entry::Output { .. } | Entry::Missing { .. } => others < REPORTS,
            Entry::Signals { .. } => others < SAMPLES,
            Entry::Port { .. } => {
                let size = size(entry).unwrap_or_default();
                self.values == 0 || self.values_size.saturating_add(size) <= VALUES_SIZE_MAX
            }
        }
    }
}

impl Queue {
    /// Adds an entry that came at `arrived`. If the queue is closed or full, drops the entry and returns false. Dropped
    /// samples and reports are also counted.
    pub(super) fn push(&self, entry: Entry, arrived: Duration) -> bool {
        let (mut state, size) = (self.lock(), size(&entry));
        let fits = !state.closed && state.has_room(&entry);
        if fits {
            state.values += usize::from(size.is_some());
            state.values_size += size.unwrap_or_default();
            state.entries.push_back((entry, arrived));
            self.changed.notify_one();
        } else if matches!(entry, Entry::Report(_) | Entry::Output { .. } | Entry::Signals { .. }) {
            state.dropped += 1;
        }
        fits
    }

    /// Takes the oldest entry out. If there is none, waits for one, at most for `timeout`.
    pub(super) fn pop(&self, timeout: Duration) -> Work {
        let mut state = self.lock();
        if state.entries.is_empty() && !state.closed {
            let waited = self.changed.wait_timeout(state, timeout);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        match state.entries.pop_front() {
            Some((entry, arrived)) => {
                if let Some(size) = size(&entry) {
                    state.values -= 1;
                    state.values_size -= size;
                }
                Work::Entry(Box::new(entry), arrived)
            }
            None if state.closed => Work::Closed,
            None => Work::Nothing,
        }
    }

    /// Refuses all further entries.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }

    /// Returns how many samples and reports were dropped.
    pub(super) fn dropped(&self) -> u64 {
        self.lock().dropped
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code panics while it holds the lock, so the data is always consistent.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
