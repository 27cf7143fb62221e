//! Passes values from the threads of a data session to the task that shows them.

use crate::logic::value_queue::{Queued, ValueQueue};
use std::sync::{Mutex, PoisonError};
use tokio::sync::Notify;

/// A queue that never makes its senders wait. One task receives the values.
#[derive(Debug)]
pub(crate) struct SharedQueue<S, V> {
    values: Mutex<ValueQueue<S, V>>,
    came: Notify,
}

impl<S: Ord + Clone, V> SharedQueue<S, V> {
    /// Adds a value of this size in bytes.
    pub(crate) fn push(&self, source: &S, size: usize, value: V) {
        self.values.lock().unwrap_or_else(PoisonError::into_inner).push(source, size, value);
        self.came.notify_one();
    }

    /// Returns an empty queue for this many bytes.
    pub(crate) fn with_size(size_max: usize) -> Self {
        Self { values: Mutex::new(ValueQueue::with_size(size_max)), came: Notify::new() }
    }

    /// Returns the next value.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&self) -> Queued<S, V> {
        loop {
            if let Some(value) = self.pop() {
                return value;
            }
            self.came.notified().await;
        }
    }

    /// Returns the next value, if there is one.
    pub(crate) fn pop(&self) -> Option<Queued<S, V>> {
        self.values.lock().unwrap_or_else(PoisonError::into_inner).pop()
    }

    /// Returns the sources that have lost values since their last value was taken out, and how many.
    pub(crate) fn lost(&self) -> Vec<(S, u64)> {
        self.values.lock().unwrap_or_else(PoisonError::into_inner).lost()
    }
}

impl<S: Ord + Clone, V> Default for SharedQueue<S, V> {
    fn default() -> Self {
        Self { values: Mutex::default(), came: Notify::new() }
    }
}
