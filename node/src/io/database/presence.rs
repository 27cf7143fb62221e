//! Checks that a store is still where it was opened. An engine continues to write to files that have been deleted or
//! moved, and the next start would not find these changes.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The beginning of the names of an engine's temporary files.
const PASSING: &str = "snap.";

/// The folder and the files of a store, each with its device and its inode.
#[derive(Debug)]
pub(super) struct Presence(Vec<(PathBuf, (u64, u64))>);

impl Presence {
    /// Notes the present files.
    pub(super) fn of(folder: &Path) -> io::Result<Self> {
        let mut all = Vec::new();
        gather(folder, &mut all)?;
        Ok(Self(all))
    }

    /// Returns whether all of them still exist, and are the same files.
    pub(super) fn holds(&self) -> bool {
        self.0.iter().all(|(path, known)| identity(path).is_ok_and(|identity| identity == *known))
    }

    /// Returns whether all of them exist, but some are other files.
    pub(super) fn is_replaced(&self) -> bool {
        self.0.iter().all(|(path, _)| path.exists())
    }
}

/// Adds a folder and its files. Some engines have a folder inside it.
fn gather(folder: &Path, all: &mut Vec<(PathBuf, (u64, u64))>) -> io::Result<()> {
    all.push((folder.to_owned(), identity(folder)?));
    for entry in fs::read_dir(folder)? {
        let (path, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
        if path.is_dir() {
            gather(&path, all)?;
        } else if path.is_file() && !name.to_string_lossy().starts_with(PASSING) {
            let identity = identity(&path)?;
            all.push((path, identity));
        }
    }
    Ok(())
}

fn identity(path: &Path) -> io::Result<(u64, u64)> {
    fs::metadata(path).map(|meta| (meta.dev(), meta.ino()))
}
