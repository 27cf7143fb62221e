//! Asks executables which controller types they offer.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The most text an executable may answer.
const INTERFACE_MAX: u64 = 4 << 20;

/// Why an executable's controller types are not known.
#[derive(Debug, thiserror::Error)]
pub enum ProgramsError {
    /// It cannot be run.
    #[error("cannot run {program:?}: {cause}")]
    Run {
        /// Which.
        program: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It ran, and failed.
    #[error("{program:?} does not tell its interface: `{argument}` {status}")]
    Failed {
        /// Which.
        program: PathBuf,
        /// What it was asked.
        argument: &'static str,
        /// How it ended.
        status: std::process::ExitStatus,
    },
}

/// Returns the executable that stands beside this one.
pub fn beside(name: &str) -> PathBuf {
    let here = std::env::current_exe().ok().and_then(|exe| exe.parent().map(Path::to_path_buf));
    here.unwrap_or_default().join(name)
}

/// Returns the executables to ask: those given, or `dca-controller` beside this one if it is there.
pub fn chosen(given: &[PathBuf]) -> Vec<PathBuf> {
    let own = beside("dca-controller");
    if given.is_empty() && own.is_file() { vec![own] } else { given.to_vec() }
}

/// Returns the interfaces of every controller type an executable offers, as `module` blocks.
///
/// # Errors
/// It cannot be run, or fails.
pub fn interfaces(program: &Path) -> Result<String, ProgramsError> {
    ask(program, "--dca-interface")
}

/// Returns the names of the controller types an executable offers.
///
/// # Errors
/// It cannot be run, or fails.
pub fn types(program: &Path) -> Result<Vec<String>, ProgramsError> {
    Ok(ask(program, "--list")?.split_whitespace().map(str::to_owned).collect())
}

fn ask(program: &Path, argument: &'static str) -> Result<String, ProgramsError> {
    let run = |cause| ProgramsError::Run { program: program.to_owned(), cause };
    let mut child = Command::new(program)
        .arg(argument)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(run)?;
    let mut text = String::new();
    let read = child.stdout.take().map(|out| out.take(INTERFACE_MAX).read_to_string(&mut text));
    let status = child.wait().map_err(run)?;
    read.transpose().map_err(run)?;
    if status.success() {
        Ok(text)
    } else {
        Err(ProgramsError::Failed { program: program.to_owned(), argument, status })
    }
}
