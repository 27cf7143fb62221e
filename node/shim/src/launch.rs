//! The last step before a program with limits or a sandbox: a separate process takes the limits, gives up its rights
//! and becomes the program.
//!
//! So the program never runs without its limits, not even for an instant, and the shim itself has none of them. A refusal of the
//! kernel is left in the instance directory as one sentence, which the shim reports.

use crate::judged;
use crate::sandbox;
use comms::io::file::{self, Privacy};
use comms::logic::human::cause;
use rustix::process::{Resource, Rlimit, setpriority_process, setrlimit};
use shim::protocol::{Judged, LAUNCH, Limits, REFUSED_FILE, Sandbox, ShimStart};
use std::ffi::OsString;
use std::io::{self, Write as _};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

/// The exit code of a launch that was refused; the file with the reason is beside it.
const REFUSED: u8 = 126;
/// Executes a command with a scheduling class. Source: chrt(1), util-linux.
const CHRT: &str = "chrt";

/// Returns whether a program is started without limits and with all rights.
fn is_plain(start: &ShimStart) -> bool {
    start.limits == Limits::default() && start.groups.is_empty() && start.sandbox == Sandbox::default()
}

/// Returns the command to execute instead of the program: the program itself, unless it has limits or a sandbox.
pub(crate) fn command(start: &ShimStart) -> io::Result<(OsString, Vec<OsString>)> {
    let plain = || start.command.iter().map(OsString::from);
    if is_plain(start) {
        return Ok((plain().next().unwrap_or_default(), plain().skip(1).collect()));
    }
    let launch = ShimStart { environment: Vec::new(), ..start.clone() };
    let arguments = std::iter::once(OsString::from(LAUNCH)).chain(launch.arguments()).collect();
    Ok((std::env::current_exe()?.into_os_string(), arguments))
}

/// Returns the environment of the program, or of the launch that is executed in its place and gives the program its
/// own.
pub(crate) fn variables(start: &ShimStart, more: Vec<(&'static str, String)>) -> Vec<(String, String)> {
    let more = more.into_iter().map(|(name, value)| (name.to_owned(), value));
    let environment = start.environment.iter().cloned().chain(more).collect();
    let start = ShimStart { environment, ..start.clone() };
    if is_plain(&start) {
        return start.environment;
    }
    start.variables().map(|(name, value)| (name, value.to_owned())).collect()
}

/// The longest reason, in bytes.
const REASON_MAX: usize = 64 << 10;

/// Becomes the program; returns only if that is refused.
pub(crate) fn launch(start: &ShimStart) -> ExitCode {
    // The file for the reason is made now, because the sandbox may forbid that later. An empty file is not a reason.
    let early =
        (start.sandbox != Sandbox::default()).then(|| file::created(&start.dir.join(REFUSED_FILE), Privacy::Usual));
    let reason = limit(start).map_or_else(|reason| reason, |next| execute(&next, start));
    let written = early.map_or_else(
        || file::write(&start.dir.join(REFUSED_FILE), reason.as_bytes()),
        |file| file?.write_all(reason.as_bytes()),
    );
    if let Err(error) = written {
        super::complain(&format!("dca-shim: cannot write why the program was refused: {error}"));
    }
    ExitCode::from(REFUSED)
}

/// Why the program was not even started, if this exit code says so.
pub(crate) fn refusal(dir: &Path, code: i32) -> Option<String> {
    if code != i32::from(REFUSED) {
        return None;
    }
    let reason = String::from_utf8(file::bytes_itself(&dir.join(REFUSED_FILE), REASON_MAX).ok()?).ok()?;
    // The program itself has left with this code.
    Some(reason).filter(|reason| !reason.is_empty())
}

/// Tries, before a program waits at its gate, whether the kernel grants its limits, with a command that does nothing in
/// its place.
///
/// # Errors
/// Why it does not, in a sentence.
pub(crate) fn try_limits(start: &ShimStart) -> Result<(), String> {
    if is_plain(start) {
        return Ok(());
    }
    let sandbox = Sandbox { judged: None, ..start.sandbox.clone() };
    let trial = ShimStart { command: vec!["true".to_owned()], sandbox, ..start.clone() };
    let failed = |error: io::Error| format!("its limits cannot be tried: {}", cause(&error));
    let (program, arguments) = command(&trial).map_err(failed)?;
    let mut trial = Command::new(program);
    trial.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let code = trial.status().map_err(failed)?.code();
    let refusal = code.and_then(|code| refusal(&start.dir, code));
    // The refusal of a trial is not the program's own.
    std::fs::remove_file(start.dir.join(REFUSED_FILE)).unwrap_or_default();
    refusal.map_or(Ok(()), Err)
}

/// The command that a launch executes.
struct ToExecute<'a> {
    words: Vec<OsString>,
    /// The only file that may run for the first word of the command.
    judged: Option<&'a Judged>,
    /// Whether the command is another launch, of the same program.
    is_launch: bool,
}

/// Takes the limits, and gives up the rights; returns the command to execute.
fn limit(start: &ShimStart) -> Result<ToExecute<'_>, String> {
    let limits = &start.limits;
    let caps = [
        (Resource::As, limits.memory, "B of memory"),
        (Resource::Cpu, limits.cpu.map(|time| time.as_secs()), "s of processor time"),
        (Resource::Nofile, limits.files, "open files"),
        (Resource::Fsize, limits.file_size, "B in a file"),
    ];
    let mut command: Vec<OsString> = start.command.iter().map(OsString::from).collect();
    // A group of version 1 that shares out processors may have nothing of the real-time share: that shows from inside.
    let (sharing, others): (Vec<&PathBuf>, Vec<&PathBuf>) =
        start.groups.iter().partition(|group| group.join("cpu.rt_runtime_us").is_file());
    sharing.iter().try_for_each(|group| join(group))?;
    if let Some(realtime) = limits.realtime {
        let priority = realtime.priority.to_string();
        let class = [CHRT, "--fifo", &priority].map(str::to_owned);
        if is_allowed(&class) {
            if start.sandbox != Sandbox::default() {
                // Setting the class needs rights that the program does not have, so the other limits are set after it.
                let others = others.into_iter().cloned().collect();
                let limits = Limits { realtime: None, ..start.limits.clone() };
                let (program, arguments) = self::command(&ShimStart { limits, groups: others, ..start.clone() })
                    .map_err(|error| format!("it cannot be started in its class: {}", cause(&error)))?;
                let words = class.map(OsString::from).into_iter().chain([program]).chain(arguments).collect();
                return Ok(ToExecute { words, judged: None, is_launch: true });
            }
            command.splice(0..0, class.map(OsString::from));
        } else if realtime.is_optional {
            super::complain(&format!("dca-shim: no real-time priority {priority} on this host; it runs without"));
        } else if !sharing.is_empty() {
            return Err(format!(
                "real-time priority {priority} is refused: the kernel has none for a program with `cores` on this host; \
                 leave `cores` away, or `realtime {priority} optional` runs without"
            ));
        } else {
            return Err(format!(
                "real-time priority {priority} is refused: it needs `CAP_SYS_NICE` or an `rtprio` limit, and `{CHRT}`; \
                 `realtime {priority} optional` runs without"
            ));
        }
    }
    if let Some(nice) = limits.nice {
        setpriority_process(None, nice.into())
            .map_err(|error| format!("niceness {nice} is refused: {}", cause(&error.into())))?;
    }
    others.iter().try_for_each(|group| join(group))?;
    for (resource, value, what) in caps {
        // At the soft limit of its time a program gets SIGXCPU, which shows the reason of its end; at the hard one
        // SIGKILL.
        let maximum = value.map(|value| value + u64::from(resource == Resource::Cpu));
        let limit = Rlimit { current: value, maximum };
        if let (Some(value), Err(error)) = (value, value.map_or(Ok(()), |_| setrlimit(resource, limit))) {
            return Err(format!("a limit of {value} {what} is refused: {}", cause(&error.into())));
        }
    }
    sandbox::enter(&start.sandbox, [&start.dir, &start.working_directory])?;
    Ok(ToExecute { words: command, judged: start.sandbox.judged.as_ref(), is_launch: false })
}

/// Joins a control group.
fn join(group: &Path) -> Result<(), String> {
    let (file, pid) = (group.join("cgroup.procs"), std::process::id().to_string());
    std::fs::write(&file, pid).map_err(|error| format!("cannot write `{}`: {}", file.display(), cause(&error)))
}

/// Whether this user may start programs of that class: tried with a command that does nothing.
fn is_allowed(class: &[String]) -> bool {
    let mut words = class.iter();
    let Some(program) = words.next() else { return false };
    let mut trial = Command::new(program);
    trial.args(words).arg("true").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    trial.status().is_ok_and(|status| status.success())
}

fn execute(ToExecute { words, judged, is_launch }: &ToExecute<'_>, start: &ShimStart) -> String {
    let Some((name, arguments)) = words.split_first() else { return "there is no program".to_owned() };
    let opened = match judged.map(judged::open).transpose() {
        Ok(opened) => opened,
        Err(reason) => return reason,
    };
    let mut next = opened.as_ref().map_or_else(|| Command::new(name), |opened| Command::new(opened.path()));
    next.arg0(name).args(arguments);
    if !is_launch {
        // From here on the variables of the program may take effect.
        next.env_clear().envs(start.environment.iter().map(|(name, value)| (name, value)));
    }
    let error = next.exec();
    format!("cannot execute `{}`: {}", name.display(), cause(&error))
}
