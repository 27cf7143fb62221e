//! The processes of this machine, from `/proc`.

use rustix::process::{Pid, Signal, getpid, kill_process};
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

/// A process that was alive when it was read.
#[derive(Clone)]
pub struct Process {
    /// The process id.
    pub pid: i32,
    /// The arguments of the process. Its own name is the first.
    pub command: Vec<String>,
    /// The environment as `NAME=value`. It may be empty.
    pub environment: Vec<String>,
    folder: Option<PathBuf>,
}

impl fmt::Debug for Process {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.pid, self.command.join(" "))
    }
}

impl Process {
    /// Sends a signal, unless the process has already ended.
    pub fn signal(&self, signal: Signal) {
        if let Some(pid) = Pid::from_raw(self.pid) {
            kill_process(pid, signal).unwrap_or_default();
        }
    }

    /// Returns a process, or none if it does not exist. A zombie has no command, and so counts as gone.
    fn look(pid: i32) -> Option<Self> {
        let lines = |name: &str| {
            let bytes = std::fs::read(format!("/proc/{pid}/{name}")).unwrap_or_default();
            let lines = bytes.split(|byte| *byte == 0).map(|line| String::from_utf8_lossy(line).into_owned());
            lines.filter(|line| !line.is_empty()).collect::<Vec<_>>()
        };
        let command = lines("cmdline");
        let folder = std::fs::read_link(format!("/proc/{pid}/cwd")).ok();
        (!command.is_empty()).then(|| Self { pid, command, environment: lines("environ"), folder })
    }

    fn is_of(&self, folder: &Path) -> bool {
        let name = folder.to_string_lossy();
        let names = |text: &String| text.contains(&*name);
        self.folder.as_ref().is_some_and(|own| own.starts_with(folder))
            || self.command.iter().any(names)
            || self.environment.iter().any(names)
    }
}

/// Processes that only use processor time. Dropping them ends them.
#[derive(Debug)]
pub struct Busy(Vec<Child>);

impl Busy {
    /// Starts `count` processes with this niceness. A process with 19 gives way to all others.
    ///
    /// # Panics
    /// Panics if the shell cannot be started.
    pub fn start(count: usize, niceness: u8) -> Self {
        let niceness = niceness.to_string();
        let one =
            |_| Command::new("nice").args(["-n", &niceness, "sh", "-c", "while kill -0 $PPID; do :; done"]).spawn();
        Self((0..count).map(one).map(|child| child.expect("a shell is everywhere")).collect())
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        for child in &mut self.0 {
            child.kill().unwrap_or_default();
            drop(child.wait());
        }
    }
}

/// Returns every process that works in `folder`, or that names it in its arguments or environment.
pub(super) fn of_folder(folder: &Path) -> Vec<Process> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    let others = pids.filter(|pid| *pid != getpid().as_raw_nonzero().get());
    others.filter_map(Process::look).filter(|process| process.is_of(folder)).collect()
}

/// Returns the number of threads of a process.
pub fn threads(pid: u32) -> usize {
    std::fs::read_dir(format!("/proc/{pid}/task")).map_or(0, Iterator::count)
}

/// Returns the memory of a process, in bytes; 0 if the process is gone.
pub fn memory(pid: u32) -> u64 {
    let pages = std::fs::read_to_string(format!("/proc/{pid}/statm")).unwrap_or_default();
    pages.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok()).unwrap_or(0) * 4096
}

/// Returns the target of each open file descriptor of a process.
pub fn descriptors(pid: u32) -> Vec<String> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
    let targets = entries.filter_map(|entry| std::fs::read_link(entry.path()).ok());
    targets.map(|target| target.display().to_string()).collect()
}
