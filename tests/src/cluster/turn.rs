//! Whole robots in real time take turns.
//!
//! A door has 22 programs and a simulated robot, and uses half a processor. A test program runs five tests at a time. Five doors at a
//! time would starve each other, and each would abort, rightly, because the arm says nothing for a second.

use std::sync::{Condvar, Mutex, PoisonError};

/// The robots of this process that have a turn.
static TAKEN: Mutex<usize> = Mutex::new(0);
/// Announces the end of a turn.
static FREE: Condvar = Condvar::new();

/// The permission to run a whole robot in real time, until it is dropped. There are as many turns as processors.
#[derive(Debug)]
#[must_use = "a turn ends when it is dropped"]
pub struct Turn(());

impl Turn {
    /// Waits for a turn. Other tests of this process, without a robot, go on meanwhile.
    pub fn take() -> Self {
        let turns = std::thread::available_parallelism().map_or(1, usize::from);
        let taken = TAKEN.lock().unwrap_or_else(PoisonError::into_inner);
        let mut taken = FREE.wait_while(taken, |taken| *taken >= turns).unwrap_or_else(PoisonError::into_inner);
        *taken += 1;
        Self(())
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        *TAKEN.lock().unwrap_or_else(PoisonError::into_inner) -= 1;
        FREE.notify_one();
    }
}
