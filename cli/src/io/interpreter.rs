//! Asks the Python interpreters of this machine which package `dca` they load.

use crate::logic::checkup::{Interpreter, Package};
use comms::logic::human::cause;
use node::io::programs::{ANSWER_WITHIN, ask_with_trouble};
use std::path::Path;

/// The interpreter of the virtual environment that `dca new --python` makes in this folder.
const OF_VENV: &str = ".venv/bin/python";
/// The interpreter that runs a module without a virtual environment.
const OF_PATH: &str = "python3";
/// Prints the version of the interpreter, and then the version and the folder of its package. The first line is printed
/// even if loading the package crashes.
const LOOK: &str = "import sys
print('.'.join(map(str, sys.version_info[:3])), flush=True)
import dca, os
print(dca.__version__, os.path.dirname(dca.__file__), sep='\\n')
";

/// Returns the interpreter of the virtual environment in this folder, or else the interpreter of `PATH`. Returns nothing without Python.
pub(super) fn found() -> Vec<Interpreter> {
    let venv = Path::new(OF_VENV);
    // A dangling link is also treated as an environment: the finding then says what is wrong with the link.
    let path = if venv.symlink_metadata().is_ok() { venv } else { Path::new(OF_PATH) };
    Some(look(path)).into_iter().filter(|one| path == venv || one.version.is_ok()).collect()
}

/// Asks an interpreter for its version and its package.
fn look(path: &Path) -> Interpreter {
    let (shown, is_of_venv) = (path.display().to_string(), path == Path::new(OF_VENV));
    let told = match ask_with_trouble(path, &["-c", LOOK], ANSWER_WITHIN) {
        Ok(told) => told,
        Err(error) => {
            let (version, package) = (Err(cause(&error)), Err("it does not start".to_owned()));
            return Interpreter { path: shown, is_of_venv, version, package };
        }
    };
    let mut lines = told.text.lines().map(str::to_owned);
    let version = lines.next().ok_or_else(|| format!("it ends with {}", told.status));
    let package = match (lines.next(), lines.next()) {
        (Some(version), Some(folder)) => Ok(Package { version, folder }),
        _ => Err(told.trouble.lines().last().map_or_else(|| told.status.to_string(), str::to_owned)),
    };
    Interpreter { path: shown, is_of_venv, version, package }
}
