//! Asks executables what they are, such as which controller types they offer.

use anyhow::Context;
use comms::logic::human::span;
use rustix::fs::{Access, access};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// The most text an executable may answer.
const INTERFACE_MAX: u64 = 4 << 20;
/// How long an executable may take for an answer.
pub const ANSWER_WITHIN: Duration = Duration::from_secs(10);

/// Why an executable's controller types are not known.
#[derive(Debug, thiserror::Error)]
pub enum ProgramsError {
    /// The program cannot be run.
    #[error("cannot run `{program}`: {cause}")]
    Run {
        /// The path of the program.
        program: PathBuf,
        /// The error of the system.
        cause: io::Error,
    },
    /// The program ran, and failed.
    #[error("`{program}` does not tell its interface: `{argument}` {status}")]
    Failed {
        /// The path of the program.
        program: PathBuf,
        /// The argument that asks it.
        argument: &'static str,
        /// How it ended.
        status: ExitStatus,
    },
    /// The program answers, and its answer names no type.
    #[error("`{program}` offers no controller type: `{argument}` prints no `module`")]
    Nothing {
        /// The path of the program.
        program: PathBuf,
        /// The argument that asks it.
        argument: &'static str,
    },
    /// The program runs, and writes nothing.
    #[error("`{program}` does not tell its interface: `{argument}` has no answer within {}", span(*.within))]
    Silent {
        /// The path of the program.
        program: PathBuf,
        /// The argument that asks it.
        argument: &'static str,
        /// The time given.
        within: Duration,
    },
}

/// Returns the executable that stands beside this one.
pub fn beside(name: &str) -> PathBuf {
    let here = std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_path_buf));
    here.unwrap_or_default().join(name)
}

/// Checks that `dca-shim`, without which no program starts, stands beside this executable.
///
/// # Errors
/// Names the path at which it is missing or cannot be executed.
pub fn check_shim() -> anyhow::Result<()> {
    let shim = beside("dca-shim");
    let why = || format!("no program starts without `{}`: put `dca-shim` of the same build there", shim.display());
    access(&shim, Access::EXEC_OK).with_context(why)
}

/// Returns the executables to ask: those given, or `dca-controller` beside this one if it is there.
pub fn chosen(given: &[PathBuf]) -> Vec<PathBuf> {
    let own = beside("dca-controller");
    if given.is_empty() && own.is_file() { vec![own] } else { given.to_vec() }
}

/// Returns the interfaces of every controller type an executable offers, as `module` blocks.
///
/// # Errors
/// It cannot be run, fails, offers nothing, or does not answer within 10 s.
pub fn interfaces(program: &Path) -> Result<String, ProgramsError> {
    let argument = "--dca-interface";
    let path = program.to_owned();
    match ask(program, &[argument], ANSWER_WITHIN) {
        Ok((_, status)) if !status.success() => Err(ProgramsError::Failed { program: path, argument, status }),
        Ok((text, _)) if text.trim().is_empty() => Err(ProgramsError::Nothing { program: path, argument }),
        Ok((text, _)) => Ok(text),
        Err(cause) if cause.kind() == io::ErrorKind::TimedOut => {
            Err(ProgramsError::Silent { program: path, argument, within: ANSWER_WITHIN })
        }
        Err(cause) => Err(ProgramsError::Run { program: path, cause }),
    }
}

/// Runs a program; returns what it prints and how it ends. One that has not ended within this time is killed.
///
/// # Errors
/// `TimedOut`: it has not ended in time. Else it cannot be run, or prints no text.
pub fn ask(program: &Path, arguments: &[&str], within: Duration) -> io::Result<(String, ExitStatus)> {
    let child = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    // Names this very child, also once the thread has seen its end.
    let pidfd = pidfd_open(Pid::from_child(&child), PidfdFlags::empty())?;
    let (heard_tx, heard) = sync_channel(1);
    let hearing = move || drop(heard_tx.send(hear(child)));
    // Nobody joins it: what the child has started may hold its output open for longer than anybody waits.
    let started = std::thread::Builder::new().name("ask".to_owned()).spawn(hearing);
    let answer = started.map(|_| heard.recv_timeout(within).ok());
    if !matches!(answer, Ok(Some(_))) {
        // One that has just ended needs no signal.
        pidfd_send_signal(&pidfd, Signal::KILL).unwrap_or_default();
    }
    let silent = || io::Error::new(io::ErrorKind::TimedOut, format!("no answer within {}", span(within)));
    answer?.ok_or_else(silent)?
}

/// Reads what a program says until its end, and how that was.
fn hear(mut child: Child) -> io::Result<(String, ExitStatus)> {
    let mut text = String::new();
    // Dropping the pipe ends a program that says more.
    let read = child.stdout.take().map(|out| out.take(INTERFACE_MAX).read_to_string(&mut text));
    let status = child.wait()?;
    read.transpose()?;
    Ok((text, status))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_does_not_answer_is_not_waited_for() {
        let silent = ask(Path::new("sleep"), &["3600"], Duration::from_millis(20)).unwrap_err();
        assert_eq!((silent.kind(), &*silent.to_string()), (io::ErrorKind::TimedOut, "no answer within 20 ms"));
        assert_eq!(ask(Path::new("echo"), &["word"], ANSWER_WITHIN).unwrap().0, "word\n");
    }
}
