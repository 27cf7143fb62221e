//! `dca fix`: applies every fix that is likely right.

use crate::{Controllers, check};
use node::console::{self, Failure};
use std::path::PathBuf;

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
    let is_changed = check::fix(&arguments.file, &arguments.controllers)?;
    check::load(&arguments.file, &arguments.controllers, false)?;
    let file = arguments.file.display();
    console::say(&format!("{file}: {}", if is_changed { "fixed" } else { "nothing to fix" }));
    Ok(())
}
