//! `dca fix`: applies every fix that is likely right.

use crate::cli::{Controllers, Failure, check, output};
use anyhow::{Context as _, anyhow};
use std::path::{Path, PathBuf};

/// What `dca fix` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    #[command(flatten)]
    controllers: Controllers,
}

/// Runs the verb; what is left to say about the spec is said.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let is_changed = apply(&arguments.file, &arguments.controllers)?;
    check::load(&arguments.file, &arguments.controllers, false)?;
    let file = arguments.file.display();
    output::say(&format!("{file}: {}", if is_changed { "fixed" } else { "nothing to fix" }));
    Ok(())
}

/// Rewrites the file if there is something to fix.
pub(crate) fn apply(file: &Path, controllers: &Controllers) -> Result<bool, Failure> {
    if check::is_standard_input(file) {
        return Err(anyhow!("standard input cannot be rewritten; give a file").into());
    }
    let spec = check::read(file)?;
    let interfaces = check::others(&spec, controllers)?;
    let fixed = language::fix(&spec, &interfaces, &check::options(file, false));
    let is_changed = fixed != spec.text;
    if is_changed {
        std::fs::write(file, fixed).with_context(|| format!("writing the spec `{}`", file.display()))?;
    }
    Ok(is_changed)
}
