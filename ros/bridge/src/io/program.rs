//! A program of ROS 2 as a child of this process, from its start until none of its processes is left.
//!
//! This process is a subreaper, so orphans of the program become its children. When the program has ended, they are killed: a launch file
//! starts many processes, and some of them live longer than the launch file.

use super::installation::Prepared;
use super::lock;
use crate::logic::ending::Step;
use rustix::io::Errno;
use rustix::process::{
    Pid, PidfdFlags, Resource, Rlimit, Signal, WaitOptions, WaitStatus, pidfd_open, pidfd_send_signal,
};
use signal_hook::consts::SIGINT;
use signal_hook::low_level::signal_name;
use std::fmt;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

/// How a program has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    Exit(i32),
    Signal(i32),
}

/// The stages of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Running,
    /// No process of the program is left.
    Gone(End),
}

/// A started program.
#[derive(Debug)]
pub(crate) struct Program {
    /// Refers only to this process, even if its number is later given to another process.
    pidfd: OwnedFd,
    stage: Arc<Mutex<Stage>>,
}

/// Lets programs that are started from now on handle SIGINT as usual. A node that was started in the background ignores SIGINT, and
/// programs inherit this. They do not inherit a handler.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn handle_interrupts() -> Result<(), String> {
    let handled = signal_hook::flag::register(SIGINT, Arc::default());
    handled.map(drop).map_err(|error| format!("SIGINT cannot be handled: {error}"))
}

impl Program {
    /// Starts a program. `ended` is called on another thread when none of its processes is left.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn start(prepared: &Prepared, ended: impl FnOnce(End) + Send + 'static) -> Result<Self, String> {
        let failed = |error: std::io::Error| format!("cannot execute `{}`: {error}", prepared.path.display());
        rustix::process::set_child_subreaper(Some(rustix::process::getpid())).map_err(|error| failed(error.into()))?;
        let mut command = Command::new(&prepared.path);
        command.args(&prepared.arguments).env_clear().envs(&prepared.environment);
        // `kill 0` in a script refers to the script and its children, not to this process.
        let child = command.stdin(Stdio::null()).process_group(0).spawn().map_err(failed)?;
        let (pid, stage) = (Pid::from_child(&child), Arc::new(Mutex::new(Stage::Running)));
        // Its reaper does not run yet, so the number still refers to this process.
        let pidfd = pidfd_open(pid, PidfdFlags::empty()).map_err(|error| failed(error.into()))?;
        let own = Arc::clone(&stage);
        let reap = move || {
            let end = reap(pid);
            *lock(&own) = Stage::Gone(end);
            ended(end);
        };
        std::thread::Builder::new().name("reaper".to_owned()).spawn(reap).map_err(failed)?;
        Ok(Self { pidfd, stage })
    }

    /// Returns how the program has ended, once none of its processes is left.
    pub(crate) fn end(&self) -> Option<End> {
        match *lock(&self.stage) {
            Stage::Running => None,
            Stage::Gone(end) => Some(end),
        }
    }

    /// Executes a step of the end of the program.
    pub(crate) fn take(&self, step: Step) {
        let stage = lock(&self.stage);
        if *stage != Stage::Running {
            return;
        }
        let signal = match step {
            Step::Interrupt => Signal::INT,
            Step::Terminate => Signal::TERM,
            Step::Kill => return kill_children(),
        };
        // A suspended program needs SIGCONT after the signal.
        for signal in [signal, Signal::CONT] {
            pidfd_send_signal(&self.pidfd, signal).unwrap_or_default();
        }
    }
}

/// Waits until the program has ended, then kills and reaps all processes that it has left. Returns the end of the program.
fn reap(program: Pid) -> End {
    let mut end = None;
    loop {
        match rustix::process::wait(WaitOptions::empty()) {
            Ok(Some((pid, status))) if pid == program => end = Some(End::of(status)),
            Ok(_) | Err(Errno::INTR) => {}
            // No child is left.
            Err(_) => return end.unwrap_or(End::Exit(-1)),
        }
        // When a child dies, its children become children of this process, so each pass finds new ones.
        if end.is_some() {
            kill_children();
        }
    }
}

/// Kills the children of this process. If the kernel has no lists of children, the parent of this process ends them.
fn kill_children() {
    let threads = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    for thread in threads {
        let list = std::fs::read_to_string(thread.path().join("children")).unwrap_or_default();
        for pid in list.split_whitespace().filter_map(|pid| Pid::from_raw(pid.parse().ok()?)) {
            rustix::process::kill_process(pid, Signal::KILL).unwrap_or_default();
        }
    }
}

impl End {
    fn of(status: WaitStatus) -> Self {
        match (status.exit_status(), status.terminating_signal()) {
            (Some(code), _) => Self::Exit(code),
            (None, Some(signal)) => Self::Signal(signal),
            (None, None) => Self::Exit(-1),
        }
    }

    /// Ends this process in the same way, so that the node of the host sees the end of the program as its own.
    pub(crate) fn take_over(self) -> ! {
        match self {
            Self::Exit(code) => std::process::exit(code),
            Self::Signal(number) => {
                let none = Rlimit { current: Some(0), maximum: Some(0) };
                // The core of the program has been written; a core of this process would not help.
                rustix::process::setrlimit(Resource::Core, none).unwrap_or_default();
                if let Some(signal) = Signal::from_named_raw(number) {
                    // The runtime of Rust handles the first SIGSEGV, and then removes its handler.
                    for _ in 0..2 {
                        rustix::process::kill_process(rustix::process::getpid(), signal).unwrap_or_default();
                    }
                }
                std::process::exit(128 + number)
            }
        }
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exit(code) => write!(f, "exit code {code}"),
            Self::Signal(number) => match signal_name(*number) {
                Some(name) => f.write_str(name),
                None => write!(f, "signal {number}"),
            },
        }
    }
}
