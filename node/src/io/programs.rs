//! Asks executables about themselves, such as for the controller types that they offer.

use anyhow::Context;
use comms::logic::human::span;
use language::AskedModule;
use language::plan::words;
use rustix::fs::{Access, access};
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// The longest answer of an executable, in bytes.
const INTERFACE_MAX: u64 = 4 << 20;
/// The argument that asks an executable for its interfaces.
const INTERFACE: &str = "--dca-interface";
/// How much of the standard error of a failing program is read, in bytes.
const TROUBLE_MAX: u64 = 64 << 10;
/// How many of these lines are shown to people.
const TROUBLE_LINES: usize = 5;
/// How long a program in Python may take for an answer.
const PYTHON_WITHIN: Duration = Duration::from_secs(5);
/// The variable that tells a program the version of the DCA that starts it. A program in Python compares this version with its package's.
pub(crate) const VERSION_VARIABLE: &str = "DCA_VERSION";
/// How long an executable may take for an answer.
pub const ANSWER_WITHIN: Duration = Duration::from_secs(10);

/// Why the controller types of an executable could not be read.
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
    #[error("`{program}` did not print its interface: `{argument}` {status}")]
    Failed {
        /// The path of the program.
        program: PathBuf,
        /// The argument with which it was asked.
        argument: &'static str,
        /// Its exit status.
        status: ExitStatus,
    },
    /// The program has answered, but its answer contains no type.
    #[error("`{program}` offers no controller type: `{argument}` prints no `module`")]
    Nothing {
        /// The path of the program.
        program: PathBuf,
        /// The argument with which it was asked.
        argument: &'static str,
    },
    /// The program in Python of a module ran, and failed.
    #[error("`{module}` did not print its interface: `{command} {argument}` {status}{}", ends(.trouble))]
    Python {
        /// The module.
        module: String,
        /// How it was started.
        command: String,
        /// The argument with which it was asked.
        argument: &'static str,
        /// Its exit status.
        status: ExitStatus,
        /// The last lines on its standard error.
        trouble: String,
    },
    /// The program runs but writes no answer.
    #[error("`{program}` did not print its interface: `{argument}` has no answer within {}", span(*.within))]
    Silent {
        /// The path of the program.
        program: PathBuf,
        /// The argument with which it was asked.
        argument: &'static str,
        /// The time that it had.
        within: Duration,
    },
}

/// Returns the path of an executable in the folder of this one.
pub fn beside(name: &str) -> PathBuf {
    let here = std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_path_buf));
    here.unwrap_or_default().join(name)
}

/// Checks that `dca-shim` is in the folder of this executable. Without it, no program can be started.
///
/// # Errors
/// The error contains the path where the shim is missing or cannot be executed.
pub fn check_shim() -> anyhow::Result<()> {
    let shim = beside("dca-shim");
    let why = || format!("no program starts without `{}`: put `dca-shim` of the same build there", shim.display());
    access(&shim, Access::EXEC_OK).with_context(why)
}

/// Returns the executables to ask: those given, or else `dca-controller` in the folder of this executable, if it exists.
pub fn chosen(given: &[PathBuf]) -> Vec<PathBuf> {
    let own = beside("dca-controller");
    if given.is_empty() && own.is_file() { vec![own] } else { given.to_vec() }
}

/// Returns the interfaces of all controller types that an executable offers, as `module` blocks.
///
/// # Errors
/// The executable cannot be run, fails, offers nothing, or does not answer within 10 s.
pub fn interfaces(program: &Path) -> Result<String, ProgramsError> {
    let mut command = Command::new(program);
    command.arg(INTERFACE).stderr(Stdio::null());
    match checked(command, program, ANSWER_WITHIN)? {
        Answer { status, .. } if !status.success() => {
            Err(ProgramsError::Failed { program: program.to_owned(), argument: INTERFACE, status })
        }
        Answer { text, .. } => Ok(text),
    }
}

/// Asks the program in Python of a module for its interfaces. It runs in the environment that the module sets.
///
/// # Errors
/// The program cannot be run, fails, offers nothing, or does not answer within 5 s.
pub fn interfaces_of(module: &AskedModule) -> Result<String, ProgramsError> {
    let mut words = words(&module.exec).unwrap_or_default();
    // The last word is the name of the module, which is not needed here.
    words.pop();
    let Some((program, rest)) = words.split_first() else { return Ok(String::new()) };
    let mut command = Command::new(program);
    command.args(rest).arg(INTERFACE).envs(&module.environment.variables).stderr(Stdio::piped());
    command.env(VERSION_VARIABLE, env!("CARGO_PKG_VERSION"));
    if let Some(folder) = &module.environment.directory {
        command.current_dir(folder);
    }
    match checked(command, Path::new(program), PYTHON_WITHIN)? {
        Answer { status, trouble, .. } if !status.success() => {
            let (module, command) = (module.name.clone(), words.join(" "));
            Err(ProgramsError::Python { module, command, argument: INTERFACE, status, trouble })
        }
        Answer { text, .. } => Ok(text),
    }
}

/// Runs a program that is asked for its interface, and checks its answer.
fn checked(command: Command, program: &Path, within: Duration) -> Result<Answer, ProgramsError> {
    let path = program.to_owned();
    match run(command, within) {
        Ok(answer) if answer.status.success() && answer.text.trim().is_empty() => {
            Err(ProgramsError::Nothing { program: path, argument: INTERFACE })
        }
        Ok(answer) => Ok(answer),
        Err(cause) if cause.kind() == io::ErrorKind::TimedOut => {
            Err(ProgramsError::Silent { program: path, argument: INTERFACE, within })
        }
        Err(cause) => Err(ProgramsError::Run { program: path, cause }),
    }
}

/// Returns the last output of a program, in a form that can be appended to how it ended.
fn ends(trouble: &str) -> String {
    if trouble.is_empty() { String::new() } else { format!(":\n{trouble}") }
}

/// Runs a program. Returns its output and its exit status. Kills the program if it has not ended within this time.
///
/// # Errors
/// `TimedOut`: the program has not ended in time. Otherwise it cannot be run, or does not print text.
pub fn ask(program: &Path, arguments: &[&str], within: Duration) -> io::Result<(String, ExitStatus)> {
    let mut command = Command::new(program);
    command.args(arguments).stderr(Stdio::null());
    run(command, within).map(|Answer { text, status, .. }| (text, status))
}

/// Does the same, and also returns the last lines on its standard error.
///
/// # Errors
/// The same as for [`ask`].
pub fn ask_with_trouble(program: &Path, arguments: &[&str], within: Duration) -> io::Result<Answer> {
    let mut command = Command::new(program);
    command.args(arguments).stderr(Stdio::piped());
    run(command, within)
}

/// The answer of a program.
#[derive(Clone, Debug)]
pub struct Answer {
    /// The text on its standard output.
    pub text: String,
    /// The last lines on its standard error, if that is a pipe.
    pub trouble: String,
    /// Its exit status.
    pub status: ExitStatus,
}

fn run(mut command: Command, within: Duration) -> io::Result<Answer> {
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
    // This descriptor still refers to this child after the thread has seen its end.
    let pidfd = pidfd_open(Pid::from_child(&child), PidfdFlags::empty())?;
    let (heard_tx, heard) = sync_channel(1);
    let hearing = move || drop(heard_tx.send(hear(child)));
    // The thread is not joined: children of the program may keep its output open for a long time.
    let started = std::thread::Builder::new().name("ask".to_owned()).spawn(hearing);
    let answer = started.map(|_| heard.recv_timeout(within).ok());
    if !matches!(answer, Ok(Some(_))) {
        // The program may have just ended, and then needs no signal.
        pidfd_send_signal(&pidfd, Signal::KILL).unwrap_or_default();
    }
    let silent = || io::Error::new(io::ErrorKind::TimedOut, format!("no answer within {}", span(within)));
    answer?.ok_or_else(silent)?
}

/// Reads the output of a program to its end. Returns the output and the exit status.
fn hear(mut child: Child) -> io::Result<Answer> {
    let (mut text, mut trouble) = (String::new(), Vec::new());
    let (out, errors) = (child.stdout.take(), child.stderr.take());
    let read = std::thread::scope(|scope| {
        scope.spawn(|| errors.map(|errors| errors.take(TROUBLE_MAX).read_to_end(&mut trouble)));
        // If a program prints more than this, dropping the pipe ends it.
        out.map(|out| out.take(INTERFACE_MAX).read_to_string(&mut text))
    });
    let status = child.wait()?;
    read.transpose()?;
    let trouble = String::from_utf8_lossy(&trouble);
    let lines: Vec<&str> = trouble.trim_end().lines().collect();
    let trouble = lines[lines.len().saturating_sub(TROUBLE_LINES)..].join("\n");
    Ok(Answer { text, trouble, status })
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::plan::Environment;

    #[test]
    fn a_program_that_does_not_answer_is_not_waited_for() {
        let silent = ask(Path::new("sleep"), &["3600"], Duration::from_millis(20)).unwrap_err();
        assert_eq!((silent.kind(), &*silent.to_string()), (io::ErrorKind::TimedOut, "no answer within 20 ms"));
        assert_eq!(ask(Path::new("echo"), &["word"], ANSWER_WITHIN).unwrap().0, "word\n");
    }

    #[test]
    fn a_program_of_a_module_is_asked_in_its_environment() {
        let asked = |script: &str| {
            let mut environment = Environment { directory: Some("/".to_owned()), ..Environment::default() };
            environment.variables.insert("DOOR".to_owned(), "locked".to_owned());
            interfaces_of(&AskedModule { name: "Keep".to_owned(), exec: format!("sh -c '{script}' Keep"), environment })
        };
        assert_eq!(asked("echo $DOOR $PWD $0").unwrap(), "locked / --dca-interface\n");
        let failed = asked("echo Traceback >&2; echo oh dear >&2; exit 3").unwrap_err().to_string();
        assert!(failed.ends_with("exit status: 3:\nTraceback\noh dear"), "{failed}");
        assert!(matches!(asked("exit 0"), Err(ProgramsError::Nothing { .. })));
    }
}
