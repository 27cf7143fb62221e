//! `dca fix`: applies the fixes of a spec that leave no other reading.

use crate::{Controllers, Values, check};
use node::console::{self, Failure};
use std::path::PathBuf;

/// The arguments of `dca fix`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    #[command(flatten)]
    controllers: Controllers,
}

/// Runs the verb, and prints the remaining diagnostics of the spec.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let is_changed = check::fix(&arguments.file, &arguments.controllers)?;
    check::load(&arguments.file, &arguments.controllers, &Values::default(), false)?;
    let file = arguments.file.display();
    console::say(&format!("{file}: {}", if is_changed { "fixed" } else { "nothing to fix" }));
    Ok(())
}
