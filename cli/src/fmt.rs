//! `dca fmt`: formats specs.

use crate::check;
use crate::io::whole_file;
use anyhow::Context as _;
use language::{Source, format, render};
use node::console::{self, Failure};
use node::logic::table::counted;
use serde_json::json;
use std::path::PathBuf;

/// The arguments of `dca fmt`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The specs; `-` is standard input, formatted to standard output
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Change nothing; name the files that would change, and fail if there are any
    #[arg(long)]
    check: bool,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (mut is_fine, mut changed, mut unreadable) = (true, Vec::new(), Vec::new());
    for file in &arguments.files {
        let source = check::read(file)?;
        let Some(text) = formatted(&source) else {
            is_fine = false;
            unreadable.push(source.name);
            continue;
        };
        let is_input = check::is_standard_input(file);
        if is_input && !arguments.check {
            console::say(&text);
            continue;
        }
        if text == source.text {
            continue;
        }
        if arguments.check {
            is_fine = false;
            if !console::is_json() {
                console::say(&format!("{} is not formatted", source.name));
            }
        } else {
            whole_file::put(file, text.as_bytes()).context("writing the spec")?;
        }
        changed.push(source.name);
    }
    // The formatted text of standard input is an answer of its own.
    if console::is_json() && (arguments.check || !arguments.files.iter().any(|file| check::is_standard_input(file))) {
        let what = if arguments.check { "not formatted" } else { "changed" };
        let unread = if unreadable.is_empty() { "" } else { "; others cannot be read" };
        let text = format!("{}: {what}{unread}", counted(changed.len(), "file"));
        console::answer(&json!({ "text": text, "files": changed, "unreadable": unreadable }));
    }
    if is_fine { Ok(()) } else { Err(Failure::Reported) }
}

/// Returns the formatted text; if it cannot be formatted, prints the reason.
fn formatted(source: &Source) -> Option<String> {
    match format(source) {
        Ok(text) => Some(text),
        Err(found) => {
            console::note(&render(&found, source, &[], check::style()));
            console::note(&format!("{}: not formatted, since it cannot be read", source.name));
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(files: Vec<PathBuf>, check: bool) -> bool {
        match run(&Arguments { files, check }) {
            Ok(()) => false,
            Err(Failure::Reported | Failure::ReportedUnreachable | Failure::Limited) => true,
            Err(Failure::Refused(error) | Failure::Usage(error) | Failure::Unreachable(error)) => panic!("{error:#}"),
        }
    }

    #[test]
    fn a_file_is_rewritten_unless_it_is_only_checked() {
        let folder = std::env::temp_dir().join(format!("dca-fmt-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("a.dca");
        std::fs::write(&file, "process  main() { }").unwrap();
        assert!(told(vec![file.clone()], true));
        assert!(!told(vec![file.clone()], false));
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "process main(){}\n");
        assert!(!told(vec![file.clone()], true));
        std::fs::write(&file, "process main( {").unwrap();
        assert!(told(vec![file], false));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
