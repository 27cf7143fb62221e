//! A thread that finds flushes that hang.
//!
//! When a write fails on one of the engine's threads, the engine does not always wake the thread that waits for it. A commit
//! on a full disk would wait for ever. A further flush finds the error, and wakes the waiting thread. So a watching thread
//! looks every second. If a flush takes longer than that, the watching thread begins another flush, without waiting for it.

use comms::io::clock::{self, Wakeup, Woken};
use std::future::Future;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Waker};
use std::thread::JoinHandle;
use std::time::Duration;

/// How long a flush may take before another flush begins.
const PATIENCE: Duration = Duration::from_secs(1);

/// The watching thread. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Watch {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    /// Counts both the begun and the ended flushes: the number is odd during a flush.
    turns: AtomicU64,
    closing: Wakeup,
}

impl Watch {
    /// Begins to watch; `flush` starts a further flush.
    pub(super) fn start<F: Future>(flush: impl Fn() -> F + Send + 'static) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let seen = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("store-watch".to_owned()).spawn(move || {
            let mut before = 0;
            while seen.closing.wait(Some(clock::now() + PATIENCE)) == Woken::Deadline {
                let turns = seen.turns.load(Ordering::Relaxed);
                if turns == before && turns % 2 == 1 {
                    // One poll starts the flush, which then runs by itself.
                    drop(Box::pin(flush()).as_mut().poll(&mut Context::from_waker(Waker::noop())));
                }
                before = turns;
            }
        })?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Runs work that flushes and does not panic.
    pub(super) fn during<T>(&self, work: impl FnOnce() -> T) -> T {
        self.shared.turns.fetch_add(1, Ordering::Relaxed);
        let done = work();
        self.shared.turns.fetch_add(1, Ordering::Relaxed);
        done
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.closing.wake();
        if self.thread.take().is_some_and(|thread| thread.join().is_err()) {
            tracing::error!("the watch over a store has panicked");
        }
    }
}
