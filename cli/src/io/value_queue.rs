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

    /// Returns the next value.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&self) -> Queued<S, V> {
        loop {
            if let Some(value) = self.values.lock().unwrap_or_else(PoisonError::into_inner).pop() {
                return value;
            }
            self.came.notified().await;
        }
    }
}

impl<S, V> Default for SharedQueue<S, V> {
    fn default() -> Self {
        Self { values: Mutex::default(), came: Notify::new() }
    }
}
