//! The processes of this machine as `/proc` shows them, each named for good: its number and when it started.

use crate::logic::process_record::Process;
use rustix::process::{Pid, PidfdFlags, Signal, getpid, pidfd_open, pidfd_send_signal};
use std::collections::{BTreeMap, BTreeSet};

/// What `/proc/PID/stat` says of a process. Source: proc_pid_stat(5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stat {
    /// The process.
    pub process: Process,
    /// Number of its parent.
    pub parent: i32,
    /// Number of the process that made its session.
    pub session: i32,
    /// Whether it has ended, and only its parent has not looked yet.
    pub is_zombie: bool,
}

/// Returns what the kernel says of a process; none if it is not there.
pub fn stat(pid: i32) -> Option<Stat> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The second field is a name in parentheses, which may hold any character.
    let (_, fields) = text.rsplit_once(") ")?;
    let fields: Vec<&str> = fields.split(' ').collect();
    let started = fields.get(19)?.parse().ok()?;
    Some(Stat {
        process: Process { pid, started },
        parent: fields.get(1)?.parse().ok()?,
        session: fields.get(3)?.parse().ok()?,
        is_zombie: matches!(*fields.first()?, "Z" | "X"),
    })
}

/// Returns every process of this machine that can be seen.
pub fn all() -> Vec<Stat> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    entries.filter_map(|entry| stat(entry.file_name().to_str()?.parse().ok()?)).collect()
}

/// Returns this process.
pub fn this() -> Option<Process> {
    stat(getpid().as_raw_nonzero().get()).map(|stat| stat.process)
}

/// Returns those of `all` that descend from one of `roots`, the roots left out.
pub fn descendants(all: &[Stat], roots: impl IntoIterator<Item = i32>) -> BTreeSet<Process> {
    let mut children: BTreeMap<i32, Vec<Process>> = BTreeMap::new();
    for stat in all {
        children.entry(stat.parent).or_default().push(stat.process);
    }
    let (mut found, mut parents) = (BTreeSet::new(), Vec::from_iter(roots));
    while let Some(parent) = parents.pop() {
        for process in children.remove(&parent).unwrap_or_default() {
            parents.push(process.pid);
            found.insert(process);
        }
    }
    found
}

/// Returns whether a process runs: it is there, has the start time given, and has not ended.
pub fn is_running(process: Process) -> bool {
    stat(process.pid).is_some_and(|stat| stat.process == process && !stat.is_zombie)
}

/// Returns the environment of a process as `NAME=value`; nothing if it is not ours to read.
pub fn environment(pid: i32) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
    bytes.split(|byte| *byte == 0).filter(|entry| !entry.is_empty()).map(<[u8]>::to_vec).collect()
}

/// Sends a signal, unless the number belongs to another process by now.
pub fn signal(process: Process, signal: Signal) {
    let Some(number) = Pid::from_raw(process.pid) else { return };
    let Ok(pidfd) = pidfd_open(number, PidfdFlags::empty()) else { return };
    if stat(process.pid).is_some_and(|stat| stat.process == process) {
        // A process that has ended meanwhile needs no signal.
        pidfd_send_signal(&pidfd, signal).unwrap_or_default();
    }
}

/// Names this boot of the kernel.
pub fn kernel_boot() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    boot.trim().to_owned()
}
