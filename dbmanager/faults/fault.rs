//! Part of the copy of the sources: the injected fault that is switched on, for all replicas of a thread.

use std::cell::Cell;

thread_local! {
    static PLANTED: Cell<&'static str> = const { Cell::new("") };
}

/// Switches this fault on, and the previous one off.
pub fn plant(name: &'static str) {
    PLANTED.set(name);
}

/// Returns whether this fault is on.
pub(crate) fn planted(name: &str) -> bool {
    PLANTED.get() == name
}
