//! The subscribers of a publisher.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Whether the publisher has a subscriber.
#[derive(Debug, Default)]
pub(crate) struct Listeners {
    heard: Mutex<Matching>,
    /// Whether there is any subscriber. An atomic, because loops read it each time they send.
    is_any: AtomicBool,
    changed: Condvar,
}

/// The kinds of the present subscribers.
#[derive(Clone, Copy, Debug, Default)]
struct Matching {
    by_zenoh: bool,
    directly: bool,
}

impl Matching {
    fn is_any(self) -> bool {
        self.by_zenoh || self.directly
    }
}

impl Listeners {
    pub(super) fn set(&self, matching: bool) {
        self.change(|heard| heard.by_zenoh = matching);
    }

    /// Notes whether the consumer is connected directly.
    pub(crate) fn set_direct(&self, is_connected: bool) {
        self.change(|heard| heard.directly = is_connected);
    }

    /// Returns whether there is a subscriber over zenoh.
    pub(super) fn is_zenoh(&self) -> bool {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner).by_zenoh
    }

    /// Waits for a subscriber. Returns whether one came within the given time.
    pub(super) fn wait(&self, within: Duration) -> bool {
        let heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.changed.wait_timeout_while(heard, within, |heard| !heard.is_any());
        waited.unwrap_or_else(PoisonError::into_inner).0.is_any()
    }

    /// Returns whether there is a subscriber.
    pub(crate) fn is_any(&self) -> bool {
        self.is_any.load(Ordering::Acquire)
    }

    fn change(&self, change: impl FnOnce(&mut Matching)) {
        let mut heard = self.heard.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut heard);
        self.is_any.store(heard.is_any(), Ordering::Release);
        drop(heard);
        self.changed.notify_all();
    }
}
