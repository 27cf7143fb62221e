//! Every process below this one.

use rustix::process::{Pid, PidfdFlags, Signal, getpid, pidfd_open, pidfd_send_signal};
use std::collections::{BTreeMap, BTreeSet};

/// Rounds of stopping before the killing begins; a program that forks faster than it is stopped is killed in pieces.
const ROUNDS_MAX: usize = 20;

/// What names a process for good: its number, and when it started.
type Process = (i32, u64);

/// Kills every process below this one. Some may be left when it returns, if they were made meanwhile; the caller looks
/// again until it has no child.
pub(crate) fn kill_descendants() {
    // Stopped first, so that none forks while others are being killed.
    let mut stopped = BTreeSet::new();
    for _ in 0..ROUNDS_MAX {
        let fresh: Vec<Process> = descendants().into_iter().filter(|process| !stopped.contains(process)).collect();
        if fresh.is_empty() {
            break;
        }
        for process in fresh {
            signal(process, Signal::STOP);
            stopped.insert(process);
        }
    }
    for process in stopped {
        signal(process, Signal::KILL);
    }
}

/// Sends a signal, unless the number belongs to another process by now.
fn signal((pid, started): Process, signal: Signal) {
    let Some(number) = Pid::from_raw(pid) else { return };
    let Ok(pidfd) = pidfd_open(number, PidfdFlags::empty()) else { return };
    if stat(pid).is_some_and(|(_, now)| now == started) {
        // One that has ended meanwhile needs no signal.
        pidfd_send_signal(&pidfd, signal).unwrap_or_default();
    }
}

fn descendants() -> BTreeSet<Process> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let mut children: BTreeMap<i32, Vec<Process>> = BTreeMap::new();
    for pid in pids {
        if let Some((parent, started)) = stat(pid) {
            children.entry(parent).or_default().push((pid, started));
        }
    }
    let (mut found, mut parents) = (BTreeSet::new(), vec![getpid().as_raw_nonzero().get()]);
    while let Some(parent) = parents.pop() {
        for process in children.remove(&parent).unwrap_or_default() {
            parents.push(process.0);
            found.insert(process);
        }
    }
    found
}

/// Returns the parent of a process and when it started. Source: proc_pid_stat(5), fields 4 and 22.
fn stat(pid: i32) -> Option<(i32, u64)> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The second field is a name in parentheses, which may hold any character.
    let (_, fields) = text.rsplit_once(") ")?;
    let mut fields = fields.split(' ');
    let parent = fields.nth(1)?.parse().ok()?;
    let started = fields.nth(17)?.parse().ok()?;
    Some((parent, started))
}
