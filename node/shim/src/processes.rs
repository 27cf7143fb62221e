//! The processes of this machine by `/proc`. The number and the start time of a process name it for good.

use crate::process_record::Process;
use rustix::process::{Pid, PidfdFlags, Signal, getpid, pidfd_open, pidfd_send_signal};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

/// The fields of `/proc/PID/stat` in use. Source: proc_pid_stat(5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stat {
    /// The process.
    pub process: Process,
    /// Number of its parent.
    pub parent: i32,
    /// Number of the process that made its session.
    pub session: i32,
    /// Whether it has ended, and its parent has not collected it yet.
    pub is_zombie: bool,
    /// Whether it is suspended, by a signal or by a debugger, and waits to be resumed.
    pub is_stopped: bool,
}

/// Returns the kernel's record of a process; none if the process is not there.
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
        is_stopped: matches!(*fields.first()?, "T" | "t"),
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

/// Returns the descendants of `roots` among `all`, without the roots.
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

/// Returns every process below `root`. With the kernel's own lists of children, the cost does not
/// depend on the number of other processes on the machine. A kernel may be built without these
/// lists. Source: proc_tid_children(5).
pub fn below(root: i32) -> BTreeSet<Process> {
    if !has_child_lists(root) {
        return descendants(&all(), [root]);
    }
    let (mut found, mut parents) = (BTreeSet::new(), vec![root]);
    while let Some(parent) = parents.pop() {
        for process in listed_children(parent) {
            if found.insert(process) {
                parents.push(process.pid);
            }
        }
    }
    found
}

/// Returns the children of this process that have ended and have not been collected.
pub fn ended_children() -> BTreeSet<Process> {
    let this = getpid().as_raw_nonzero().get();
    let children = if has_child_lists(this) { stats_of_children(this) } else { all() };
    let ended = children.into_iter().filter(|stat| stat.is_zombie && stat.parent == this);
    ended.map(|stat| stat.process).collect()
}

fn has_child_lists(pid: i32) -> bool {
    Path::new(&format!("/proc/{pid}/task/{pid}/children")).exists()
}

/// Each thread has a separate list.
fn listed_children(pid: i32) -> Vec<Process> {
    stats_of_children(pid).into_iter().map(|stat| stat.process).collect()
}

fn stats_of_children(pid: i32) -> Vec<Stat> {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let lists = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("children")).ok());
    let pids: Vec<i32> =
        lists.flat_map(|list| list.split_whitespace().map(str::parse).collect::<Vec<_>>()).flatten().collect();
    pids.into_iter().filter_map(stat).collect()
}

/// Returns whether a process runs: it exists, has the start time given, and has not ended.
pub fn is_running(process: Process) -> bool {
    stat(process.pid).is_some_and(|stat| stat.process == process && !stat.is_zombie)
}

/// Returns whether a process exists with the given start time, possibly ended and not yet reaped.
pub fn is_there(process: Process) -> bool {
    stat(process.pid).is_some_and(|stat| stat.process == process)
}

/// Returns whether a process has files open, or hides its files from this process. A process that is being killed closes its
/// files before it is gone, which takes seconds on a busy machine.
pub fn has_open_files(pid: i32) -> bool {
    std::fs::read_dir(format!("/proc/{pid}/fd"))
        .map_or_else(|error| error.kind() == std::io::ErrorKind::PermissionDenied, |mut files| files.next().is_some())
}

/// Returns the processor time of all children of this process that have ended, and of theirs. Source: proc_pid_stat(5),
/// fields 16 and 17, which count hundredths of a second on every Linux.
pub fn time_of_ended_children() -> Duration {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = text.rsplit_once(") ").map(|(_, fields)| fields.split(' ').skip(13).take(2));
    let ticks = fields.into_iter().flatten().filter_map(|field| field.parse::<u64>().ok()).sum::<u64>();
    Duration::from_millis(10 * ticks)
}

/// Returns whether a debugger holds a process. Source: proc_pid_status(5).
pub fn is_traced(pid: i32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let tracer = status.lines().find_map(|line| line.strip_prefix("TracerPid:"));
    tracer.is_some_and(|tracer| tracer.trim() != "0")
}

/// Returns the real user of a process, which decides who may signal the process. None if the process does not exist. Sources:
/// proc_pid_status(5), kill(2).
pub fn user(pid: i32) -> Option<u32> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let users = status.lines().find_map(|line| line.strip_prefix("Uid:"))?;
    users.split_whitespace().next()?.parse().ok()
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
        // A process that has already ended needs no signal.
        pidfd_send_signal(&pidfd, signal).unwrap_or_default();
    }
}

/// Names this boot of the kernel.
pub fn kernel_boot() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    boot.trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    #[test]
    fn the_lists_of_children_name_the_same_processes_as_all_of_proc() {
        // Two children, one of which has a child; each prints that it is there.
        let script = "sh -c 'sleep 100 & echo ready; wait' & echo ready; wait";
        let mut shell = Command::new("sh").args(["-c", script]).stdout(Stdio::piped()).spawn().expect("a shell starts");
        let mut lines = BufReader::new(shell.stdout.take().expect("it is piped")).lines();
        for _ in 0..2 {
            assert_eq!(lines.next().expect("a line").expect("text"), "ready");
        }
        let root = shell.id().cast_signed();
        if !has_child_lists(root) {
            println!("skipped: this kernel has no lists of children");
        }
        let found = below(root);
        assert_eq!((found.len(), &found), (2, &descendants(&all(), [root])));
        for process in found {
            signal(process, Signal::KILL);
        }
        shell.kill().expect("it is ours");
        shell.wait().expect("it is ours");
    }

    #[test]
    fn a_process_that_was_killed_has_no_open_files() {
        let mut program = Command::new("sleep").arg("100").spawn().expect("a program starts");
        let pid = program.id().cast_signed();
        assert!(has_open_files(getpid().as_raw_nonzero().get()) && has_open_files(pid));
        program.kill().expect("it is ours");
        // The process stays until its parent collects it.
        while !stat(pid).expect("nobody has looked").is_zombie {
            std::thread::yield_now();
        }
        assert!(!has_open_files(pid));
        program.wait().expect("it is ours");
    }
}
