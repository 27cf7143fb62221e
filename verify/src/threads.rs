//! Work that may run in parallel. The caller provides the threads.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Threads to work on something.
pub trait Threads: std::fmt::Debug + Sync {
    /// Returns the number of threads, at least 1.
    fn count(&self) -> usize;

    /// Runs `work` on all threads at once, with the number of each thread, from 0. Returns when all have ended.
    fn run(&self, work: &(dyn Fn(usize) + Sync));
}

/// Only the thread of the caller.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Threads for Alone {
    fn count(&self) -> usize {
        1
    }

    fn run(&self, work: &(dyn Fn(usize) + Sync)) {
        work(0);
    }
}

/// Runs each job on one of the threads, with the number of the thread. The results are in the order of the jobs.
pub(crate) fn each<J: Send, R: Send>(
    threads: &dyn Threads,
    jobs: Vec<J>,
    work: impl Fn(usize, J) -> R + Sync,
) -> Vec<R> {
    if threads.count() < 2 || jobs.len() < 2 {
        return jobs.into_iter().map(|job| work(0, job)).collect();
    }
    let (open, done) = (Mutex::new(jobs.into_iter().enumerate()), Mutex::new(Vec::new()));
    threads.run(&|thread| {
        let claim = || lock(&open).next();
        while let Some((index, job)) = claim() {
            let result = work(thread, job);
            lock(&done).push((index, result));
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

/// If a thread panics, the other threads panic as well, so nothing that it has written is read.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
