//! Finds every process below this one.

use rustix::io::Errno;
use rustix::process::{Signal, WaitId, WaitIdOptions, getpid, waitid};
use shim::process_record::Process;
use shim::processes;
use std::collections::BTreeSet;

/// Rounds of stopping before the killing begins; a program that forks faster than it can be stopped is killed piece by
/// piece.
const ROUNDS_MAX: usize = 20;

/// Kills every process below this one. Processes that were made in the meantime may be left when it returns; the caller
/// repeats it until it has no child.
pub(crate) fn kill_descendants() {
    // The walk over all processes of the machine takes milliseconds. Orphans of a child become children of this
    // process.
    if is_childless() {
        return;
    }
    // All are stopped first, so that none forks while others are being killed.
    let mut stopped = BTreeSet::new();
    for _ in 0..ROUNDS_MAX {
        let found = processes::below(getpid().as_raw_nonzero().get());
        let fresh: Vec<Process> = found.difference(&stopped).copied().collect();
        if fresh.is_empty() {
            break;
        }
        for process in fresh {
            processes::signal(process, Signal::STOP);
            stopped.insert(process);
        }
    }
    for process in stopped {
        processes::signal(process, Signal::KILL);
    }
}

/// Returns whether this process has no descendants. A child that has ended is counted until it is reaped.
fn is_childless() -> bool {
    let look = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    waitid(WaitId::All, look).is_err_and(|error| error == Errno::CHILD)
}
