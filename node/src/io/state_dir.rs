//! Where a node keeps what must survive it: a folder for each node, below one for the user.
//!
//! ```text
//! BASE/                     /var/lib/dca for root; $XDG_STATE_HOME/dca or ~/.local/state/dca for others; or `--state`
//!   r1/                     one node, 0700
//!     db/                   its copy of the database
//!     journal               the deployments it has committed
//! ```

use anyhow::Context;
use std::fs::DirBuilder;
use std::io::ErrorKind;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// Returns the folder of a node below `base`, or below the one that the system has for such things; makes it.
///
/// # Errors
/// There is no such folder, or it cannot be made, though the disk can be written.
pub fn take(base: Option<&Path>, name: &str) -> anyhow::Result<PathBuf> {
    let base = match base {
        Some(base) => base.to_owned(),
        None => default_base().context("there is no folder to keep the database in; choose one with `--state`")?,
    };
    let folder = std::path::absolute(&base)?.join(name);
    let made = DirBuilder::new().recursive(true).mode(0o700).create(&folder);
    match made {
        // A node that can write nothing still runs: its database says why it takes no writes.
        Err(error) if error.kind() == ErrorKind::ReadOnlyFilesystem => {}
        made => made.with_context(|| format!("making the folder {folder:?}; choose another with `--state`"))?,
    }
    Ok(folder)
}

fn default_base() -> Option<PathBuf> {
    if rustix::process::getuid().is_root() {
        return Some(PathBuf::from("/var/lib/dca"));
    }
    let folder = |name| std::env::var_os(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
    folder("XDG_STATE_HOME").or_else(|| Some(folder("HOME")?.join(".local/state"))).map(|base| base.join("dca"))
}
