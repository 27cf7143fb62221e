//! `dca man`: writes the pages for `man`, one for each verb.

use crate::Command;
use crate::help::with_help;
use crate::json::with_json;
use anyhow::{Context as _, anyhow};
use clap::CommandFactory as _;
use node::console::{self, Failure};
use node::io::folder::no_folder;
use std::fs;
use std::path::{Path, PathBuf};

/// The arguments of `dca man`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The folder for the pages, which is made if necessary: `man -l FOLDER/dca-run.1` shows a page; `man` finds all
    /// pages in `~/.local/share/man/man1`
    folder: PathBuf,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let folder = &arguments.folder;
    if folder.exists() && !folder.is_dir() {
        return Err(anyhow!(no_folder(folder)).into());
    }
    let count = write(folder).with_context(|| format!("writing the pages to `{}`", folder.display()))?;
    console::say(&format!("{}: {count} pages; try `man -l {0}/dca.1`", folder.display()));
    Ok(())
}

/// Writes the pages of `dca`, of each verb and of `dca-node`. Returns the number of pages.
fn write(folder: &Path) -> std::io::Result<usize> {
    fs::create_dir_all(folder)?;
    let mut count = 0;
    // A page has the name of its command: `dca-db-put.1`.
    let dca = with_json(with_help(Command::command())).disable_help_subcommand(true);
    // The pages are the same for every machine, so they name neither the commit nor the architecture.
    let mut next: Vec<_> =
        [dca, node::command::command()].map(|command| command.version(env!("CARGO_PKG_VERSION"))).into();
    while let Some(mut command) = next.pop() {
        command.build();
        next.extend(
            command.get_subcommands().filter(|inner| !inner.is_hide_set() && inner.get_name() != "help").cloned(),
        );
        let name = command.get_display_name().unwrap_or(command.get_name()).to_owned();
        let mut page = Vec::new();
        clap_mangen::Man::new(command).title(name.as_str()).render(&mut page)?;
        fs::write(folder.join(format!("{name}.1")), page)?;
        count += 1;
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_verb_has_a_page() {
        let folder = std::env::temp_dir().join(format!("dca-man-{}", std::process::id()));
        let count = write(&folder).unwrap();
        let page = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(fs::read_dir(&folder).unwrap().count(), count);
        assert!(page("dca.1").contains("dca\\-run(1)"), "{}", page("dca.1"));
        assert!(page("dca-check.1").contains("\\-\\-format"), "{}", page("dca-check.1"));
        assert!(page("dca-db-put.1").replace('\\', "").contains("dca-db-put"), "{}", page("dca-db-put.1"));
        assert!(page("dca-node.1").contains("\\-\\-insecure\\-lan"));
        assert!(!page("dca.1").contains("commit"), "{}", page("dca.1"));
        fs::remove_dir_all(folder).unwrap();
    }
}
