//! The errors for a folder that a user has named, and for a node's file in such a folder, if it cannot be used. They
//! name the option for another folder.

use comms::io::file;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// Something else is in the place of the folder, or of one of its parents.
    #[error("{}; choose another folder with `{option}`", no_folder(.file))]
    File {
        /// The path of the other file.
        file: PathBuf,
        /// The option that names another folder.
        option: &'static str,
    },
    /// The system refuses to make the folder.
    #[error("cannot make the folder `{path}`: {cause}; choose another folder with `{option}`")]
    Make {
        /// The path.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
        /// The option that names another folder.
        option: &'static str,
    },
    /// Something else has the name of a node's file, or the system refuses to open the file.
    #[error("cannot use the file `{path}`: {cause}; remove it, or choose another folder with `{option}`")]
    Kept {
        /// The path.
        path: PathBuf,
        /// The kind of the other file, or the error of the system.
        cause: io::Error,
        /// The option that names another folder.
        option: &'static str,
    },
}

impl FolderError {
    /// Returns the error that a node's file in a folder cannot be used.
    pub fn kept(path: &Path, cause: io::Error, option: &'static str) -> Self {
        Self::Kept { path: path.to_owned(), cause, option }
    }
}

/// Checks that a library's file in a folder is a regular file, or does not exist.
///
/// # Errors
/// The file is something else.
pub fn check_kept(path: &Path, option: &'static str) -> Result<(), FolderError> {
    file::check(path).map_err(|cause| FolderError::kept(path, cause, option))
}

/// Syncs the entry of a file in its folder to the disk, after the file was made, renamed or removed.
///
/// # Errors
/// The system refuses.
pub(crate) fn sync_entry(file: &Path) -> io::Result<()> {
    file.parent().map_or(Ok(()), |folder| fs::File::open(folder)?.sync_all())
}

/// The folder in which this process was started. Programs run there if they name no other folder.
#[derive(Clone, Debug)]
pub(crate) struct StartFolder(PathBuf);

impl StartFolder {
    /// Returns the present folder of this process, or the root if that folder does not exist any more.
    pub(crate) fn here() -> Self {
        Self(std::env::current_dir().unwrap_or_else(|_gone| PathBuf::from("/")))
    }

    /// Returns the folder that a program names, or else this folder.
    ///
    /// # Errors
    /// This folder was removed. The text is for a person.
    pub(crate) fn of(&self, directory: Option<&str>) -> Result<PathBuf, String> {
        match directory.map(Path::new) {
            Some(directory) if directory.is_absolute() => Ok(directory.to_owned()),
            Some(directory) => Ok(self.path()?.join(directory)),
            None => self.path(),
        }
    }

    /// Returns the path of the folder. It changes when the folder or one of its parents is moved.
    ///
    /// # Errors
    /// The folder was removed, perhaps with another one in its place. The text is for a person.
    pub(crate) fn path(&self) -> Result<PathBuf, String> {
        // If the folder is outside of the mounted tree, the kernel has no complete path for it.
        let present = std::env::current_dir().ok().filter(|path| path.is_absolute());
        present.ok_or_else(|| {
            format!(
                "the folder `{}`, in which its node was started, was removed or replaced; start the node again, in a folder that stays",
                self.0.display()
            )
        })
    }
}

/// Checks that a program can run in a folder. Blocks.
///
/// # Errors
/// The path does not exist, or is not a folder. The text is for a person.
pub(crate) fn check_directory(folder: &Path) -> Result<(), String> {
    match fs::metadata(folder) {
        Ok(found) if found.is_dir() => Ok(()),
        Ok(_) => Err(format!("its program cannot run there: {}", no_folder(folder))),
        Err(cause) => Err(format!("its program cannot run in the folder `{}`: {cause}", folder.display())),
    }
}

/// Returns the message that something else is in the place of a folder.
pub fn no_folder(file: &Path) -> String {
    format!("`{}` is a file, where a folder is expected", file.display())
}

/// Checks that nothing else is in the place of a folder, which need not exist yet.
///
/// # Errors
/// Something else is in its place.
pub fn check(path: &Path, option: &'static str) -> Result<(), FolderError> {
    let is_other = |part: &&Path| fs::metadata(part).is_ok_and(|found| !found.is_dir());
    match path.ancestors().find(is_other) {
        Some(file) => Err(FolderError::File { file: file.to_owned(), option }),
        None => Ok(()),
    }
}

/// Returns the error that a folder could not be made.
pub fn refused(path: &Path, cause: io::Error, option: &'static str) -> FolderError {
    check(path, option).err().unwrap_or_else(|| FolderError::Make { path: path.to_owned(), cause, option })
}
