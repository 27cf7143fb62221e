//! `dca types`: prints the record types of a spec for programs. So a message that two languages share is written only once.

use crate::Values;
use crate::check;
use crate::logic::record_types::{Language, printed};
use anyhow::anyhow;
use node::console::{self, Failure};
use std::path::PathBuf;

/// The arguments of `dca types`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    /// Print dataclasses for the package `dca` of Python
    #[arg(long, required_unless_present = "rust", conflicts_with = "rust")]
    python: bool,
    /// Print structs for the crate `controllers` of Rust
    #[arg(long)]
    rust: bool,
    #[command(flatten)]
    values: Values,
}

/// Runs the verb. The spec may name programs that do not exist yet: they need the printed types. But the spec has to be readable.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let spec = check::read_with(&arguments.file, &arguments.values)?;
    let mut sources = check::files(&spec);
    sources.insert(0, spec);
    for source in &sources {
        // A part of the spec that cannot be read may contain a type.
        if let Err(found) = language::format(source) {
            console::note(&language::render(&found, source, &[], check::style()));
            return Err(Failure::Reported);
        }
    }
    let types = language::record_types(&sources);
    if types.is_empty() {
        let file = arguments.file.display();
        return Err(anyhow!("`{file}` declares no record type; one is `type Range = {{ distance: Length }};`").into());
    }
    let language = if arguments.rust { Language::Rust } else { Language::Python };
    let text = printed(&types, language).map_err(|why| anyhow!(why))?;
    console::say(text.trim_end());
    Ok(())
}
