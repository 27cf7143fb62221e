//! The errors for a folder that a person has named, and for a file that a node keeps in it, when they cannot be used. They name the
//! option for another folder.

use comms::io::file;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// Something else is in the place of the folder, or of a folder above it.
    #[error("{}; choose another folder with `{option}`", no_folder(.file))]
    File {
        /// The kind of file at the path.
        file: PathBuf,
        /// The option that names another.
        option: &'static str,
    },
    /// The system refuses.
    #[error("cannot make the folder `{path}`: {cause}; choose another folder with `{option}`")]
    Make {
        /// The path.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
        /// The option that names another.
        option: &'static str,
    },
    /// Something else has the name of a node's file, or the system refuses.
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
    /// Returns why a file that a node keeps in a folder cannot be used.
    pub fn kept(path: &Path, cause: io::Error, option: &'static str) -> Self {
        Self::Kept { path: path.to_owned(), cause, option }
    }
}

/// Checks that a library's file in a folder is a regular file, or absent.
///
/// # Errors
/// It is something else.
pub fn check_kept(path: &Path, option: &'static str) -> Result<(), FolderError> {
    file::check(path).map_err(|cause| FolderError::kept(path, cause, option))
}

/// Syncs a folder's entry of a file to the disk: that the file was made, renamed or removed.
///
/// # Errors
/// The system refuses.
pub(crate) fn sync_entry(file: &Path) -> io::Result<()> {
    file.parent().map_or(Ok(()), |folder| fs::File::open(folder)?.sync_all())
}

/// The folder in which this process was started: programs run there, and in no other.
#[derive(Clone, Debug)]
pub(crate) struct StartFolder(PathBuf);

impl StartFolder {
    /// Returns the present folder of this process, or the root if it has none any more.
    pub(crate) fn here() -> Self {
        Self(std::env::current_dir().unwrap_or_else(|_gone| PathBuf::from("/")))
    }

    /// Returns the folder of a program that names one, or this one.
    ///
    /// # Errors
    /// This one was removed: for a person.
    pub(crate) fn of(&self, directory: Option<&str>) -> Result<PathBuf, String> {
        match directory.map(Path::new) {
            Some(directory) if directory.is_absolute() => Ok(directory.to_owned()),
            Some(directory) => Ok(self.path()?.join(directory)),
            None => self.path(),
        }
    }

    /// Returns its path. The path changes when the folder, or one above it, is moved.
    ///
    /// # Errors
    /// It was removed, perhaps with another one in its place: for a person.
    pub(crate) fn path(&self) -> Result<PathBuf, String> {
        // Outside of the mounted tree the kernel has no whole path.
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
/// It is not there, or not a folder: for a person.
pub(crate) fn check_directory(folder: &Path) -> Result<(), String> {
    match fs::metadata(folder) {
        Ok(found) if found.is_dir() => Ok(()),
        Ok(_) => Err(format!("its program cannot run there: {}", no_folder(folder))),
        Err(cause) => Err(format!("its program cannot run in the folder `{}`: {cause}", folder.display())),
    }
}

/// Returns the text that a file is in the place of a folder.
pub fn no_folder(file: &Path) -> String {
    format!("`{}` is a file, where a folder is expected", file.display())
}

/// Checks that nothing else is in the place of a present or future folder.
///
/// # Errors
/// Something else is there.
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
