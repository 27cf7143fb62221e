//! The subscribers of a publisher.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// Whether the publisher has a subscriber.
#[derive(Debug, Default)]
pub(crate) struct Listeners {
    heard: Mutex<Matching>,
    /// Whether there is any subscriber. An atomic, because loops read it each time they send.
    is_any: AtomicBool,
    changed: Condvar,
    on_arrival: OnceLock<OnArrival>,
}

/// Called when a subscriber comes.
struct OnArrival(Box<dyn Fn() + Send + Sync>);

impl fmt::Debug for OnArrival {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("OnArrival")
    }
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
        self.tell(matching);
    }

    /// Notes whether the consumer is connected directly.
    pub(crate) fn set_direct(&self, is_connected: bool) {
        self.change(|heard| heard.directly = is_connected);
        self.tell(is_connected);
    }

    /// Calls `on_arrival` whenever a subscriber comes, on a thread that must not wait. A second call has no effect.
    pub(super) fn on_arrival(&self, on_arrival: impl Fn() + Send + Sync + 'static) {
        self.on_arrival.get_or_init(|| OnArrival(Box::new(on_arrival)));
    }

    fn tell(&self, has_come: bool) {
        if let Some(OnArrival(tell)) = self.on_arrival.get().filter(|_| has_come) {
            tell();
        }
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
