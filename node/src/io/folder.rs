//! The error for a folder that a person has named and that cannot be used. It names the option for another folder.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Why a folder cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// Something else is where it would be, or where a folder above it would be.
    #[error("{}; choose another with `{option}`", no_folder(.file))]
    File {
        /// The kind of file that is there.
        file: PathBuf,
        /// The option that names another.
        option: &'static str,
    },
    /// The system refuses.
    #[error("cannot make the folder `{path}`: {cause}; choose another with `{option}`")]
    Make {
        /// The path.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
        /// The option that names another.
        option: &'static str,
    },
}

/// Says that a file stands where a folder is expected.
pub fn no_folder(file: &Path) -> String {
    format!("`{}` is a file, where a folder is expected", file.display())
}

/// Checks that nothing else stands where a folder is, or is going to be.
///
/// # Errors
/// Something does.
pub fn check(path: &Path, option: &'static str) -> Result<(), FolderError> {
    let is_other = |part: &&Path| fs::metadata(part).is_ok_and(|found| !found.is_dir());
    match path.ancestors().find(is_other) {
        Some(file) => Err(FolderError::File { file: file.to_owned(), option }),
        None => Ok(()),
    }
}

/// Returns why a folder was not made.
pub fn refused(path: &Path, cause: io::Error, option: &'static str) -> FolderError {
    check(path, option).err().unwrap_or_else(|| FolderError::Make { path: path.to_owned(), cause, option })
}
