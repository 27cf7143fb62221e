//! The state directory: the data that must survive a node, in a folder of the user with a folder for each node.
//!
//! ```text
//! BASE/                     /var/lib/dca for root; $XDG_STATE_HOME/dca or ~/.local/state/dca for others; or `--state`
//!   r1/                     one node, 0700
//!     db/                   its copy of the database
//!     journal               the deployments it has committed
//!     running/              those that have their home here and run, for a node that begins after a reboot
//!     stopped               those of other homes that were stopped while these were away
//! ```

use crate::io::folder::{self, FolderError};
use crate::io::run_dir;
use anyhow::Context;
use comms::io::file;
use std::ffi::OsString;
use std::fs::{DirBuilder, Metadata};
use std::io::ErrorKind;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

/// The option that names the base.
pub const OPTION: &str = "--state";
/// The file in the run folder of a node that names the folder with its state.
const TOLD: &str = "state";
/// The longest path of a state folder, in bytes. Source: limits.h, Linux.
const TOLD_MAX: usize = 4096;

/// Returns the folder of a node in `base`, or else in the system's folder for state. Makes the folder if necessary.
///
/// # Errors
/// No folder is known, or it cannot be made although the disk can be written.
pub fn take(base: Option<&Path>, name: &str) -> anyhow::Result<PathBuf> {
    let base = match base {
        Some(base) => base.to_owned(),
        None => default_base().context("the database has no folder; choose a folder with `--state`")?,
    };
    let folder = std::path::absolute(&base)?.join(name);
    let made = DirBuilder::new().recursive(true).mode(0o700).create(&folder);
    match made {
        // A node that cannot write still runs: its database then reports why it takes no writes.
        Err(error) if error.kind() == ErrorKind::ReadOnlyFilesystem => {}
        made => made.map_err(|cause| folder::refused(&folder, cause, OPTION))?,
    }
    // The base may be a link that an administrator has made. The node's own folder must not be a link.
    let is_own = |found: Metadata| found.is_dir() && found.uid() == rustix::process::getuid().as_raw();
    anyhow::ensure!(
        std::fs::symlink_metadata(&folder).map_or(true, is_own),
        "the folder `{}` is a link or belongs to another user; choose another folder with `--state`",
        folder.display()
    );
    Ok(folder)
}

/// Returns the system's folder for the states of this user's nodes.
pub fn default_base() -> Option<PathBuf> {
    if rustix::process::getuid().is_root() {
        return Some(PathBuf::from("/var/lib/dca"));
    }
    let folder = |name| std::env::var_os(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
    folder("XDG_STATE_HOME").or_else(|| Some(folder("HOME")?.join(".local/state"))).map(|base| base.join("dca"))
}

/// Writes the path of a node's state into its run folder. Commands of this user read it there.
///
/// # Errors
/// The disk refuses.
pub(crate) fn tell(run: &Path, state: &Path) -> Result<(), FolderError> {
    let path = run.join(TOLD);
    let written = file::write(&path, state.as_os_str().as_bytes());
    written.map_err(|cause| FolderError::kept(&path, cause, run_dir::OPTION))
}

/// Returns the path of a node's state, as noted in its run folder in `base`. Returns nothing if no such node has run
/// there, or if it has no state.
pub fn told(base: &Path, name: &str) -> Option<PathBuf> {
    // The name comes from a person, so it must not lead to another folder.
    let plain = Path::new(name).components().eq([std::path::Component::Normal(name.as_ref())]);
    let path = file::bytes(&base.join(name).join(TOLD), TOLD_MAX).ok().filter(|path| plain && !path.is_empty())?;
    Some(PathBuf::from(OsString::from_vec(path)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{chown, symlink};

    #[test]
    fn a_folder_that_is_a_link_or_somebody_else_s_is_refused() {
        let base = std::env::temp_dir().join(format!("dca-state-{}", std::process::id()));
        let own = take(Some(&base), "c1").unwrap();
        assert_eq!(own, base.join("c1"));
        symlink(&own, base.join("c2")).unwrap();
        let refused = "is a link or belongs to another user; choose another folder with `--state`";
        assert!(take(Some(&base), "c2").unwrap_err().to_string().ends_with(refused));
        if rustix::process::getuid().is_root() {
            chown(&own, Some(12345), None).unwrap();
            assert!(take(Some(&base), "c1").unwrap_err().to_string().ends_with(refused));
        } else {
            println!("skipped: needs root to make a folder of somebody else");
        }
        std::fs::remove_dir_all(&base).unwrap();
    }
}
