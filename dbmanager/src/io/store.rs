//! The store: records that survive a power cut once [`Store::commit`] has returned.
//!
//! After an error a store is poisoned: a repeated sync may succeed although the pages are lost (fsyncgate). The owner
//! reopens the store, which syncs and checks everything. A store that cannot be opened because of its content is put
//! aside by renaming. It is never deleted, so that it can be examined.

mod dir;
pub mod memory;
mod on_redb;
mod on_sled;
mod watch;
mod witness;

pub use dir::{DirStore, Engine};
pub use witness::{Doubt, Trust};

use crate::logic::record::{Batch, Records, StoredRecords};
use comms::io::file;
use std::fs::File;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Somewhere to keep records.
pub trait Store {
    /// Visits every record with its name. Names of the same length are visited in their order.
    ///
    /// # Errors
    /// If reading fails, or the content was changed since it was written.
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError>;

    /// Writes a batch, as a whole or not at all. It is durable when this returns.
    ///
    /// # Errors
    /// If the batch may not be durable. The store is poisoned then.
    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError>;

    /// Reads everything, for a replica.
    ///
    /// # Errors
    /// The errors of [`Store::each`]. The replica itself reports mistakes in the content.
    fn read(&self) -> Result<StoredRecords, StoreError> {
        let mut reading = StoredRecords::default();
        self.each(&mut |name, record| reading.take(name, record))?;
        Ok(reading)
    }

    /// Returns all records unchanged.
    ///
    /// # Errors
    /// The errors of [`Store::each`].
    fn load(&self) -> Result<Records, StoreError> {
        let mut records = Records::new();
        self.each(&mut |name, record| drop(records.insert(name.to_vec(), record.to_vec())))?;
        Ok(records)
    }
}

/// Why an operation of a store has failed.
#[derive(Debug, Error)]
pub enum StoreError {
    /// A file or directory cannot be used.
    #[error("store `{path}`: {cause}")]
    File {
        /// The file or directory.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
    },
    /// An entry of the store's folder is not a regular file.
    #[error("cannot use `{path}`, where the store keeps a file: {cause}; remove it, or choose another folder")]
    NoFile {
        /// The path of the entry.
        path: PathBuf,
        /// The kind of the entry.
        cause: io::Error,
    },
    /// Another program has the store open.
    #[error("the store `{path}` is open already; end the other program that uses it, or choose another folder")]
    Busy {
        /// The directory of the store.
        path: PathBuf,
    },
    /// The folder has files, but they belong to another program, or have another layout.
    #[error("`{path}` is not a store of this program; choose another folder")]
    Foreign {
        /// The directory of the store.
        path: PathBuf,
    },
    /// The store was made with the other engine. The engine of a folder cannot be changed.
    #[error(
        "the store `{path}` is kept by {found}, not by {wanted}; start without `--store`, or move the folder away: then a new store \
         is made, and data that other robots have comes back from them"
    )]
    Engine {
        /// The directory of the store.
        path: PathBuf,
        /// The engine of the store.
        found: Engine,
        /// The requested engine.
        wanted: Engine,
    },
    /// A record was changed since it was written.
    #[error("the store `{path}` is damaged: {what}")]
    Damaged {
        /// The directory of the store.
        path: PathBuf,
        /// The mismatch.
        what: String,
    },
    /// A record or its name is too long.
    #[error("a record of {size} bytes is too long for the store")]
    Long {
        /// The size of the record or name.
        size: usize,
    },
    /// The store is poisoned by an earlier error.
    #[error("the store `{path}` has failed before and has to be opened again")]
    Poisoned {
        /// The directory of the store.
        path: PathBuf,
    },
}

impl StoreError {
    /// Returns whether the remedy is to put the store aside, and to start again with the data of the other replicas.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Damaged { .. })
    }
}

/// Runs work that calls the engine. If the engine panics, its files are damaged.
fn shielded<T>(path: &Path, work: impl FnOnce() -> Result<T, StoreError>) -> Result<T, StoreError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let what = panic.downcast_ref::<String>().map(String::as_str);
        let what = what.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("the engine panicked");
        Err(damaged(path, what.lines().next().unwrap_or(what)))
    })
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn sync(path: &Path) -> Result<(), StoreError> {
    File::open(path).and_then(|file| file.sync_all()).map_err(|cause| file_error(path, cause))
}

/// Checks that a name belongs to a regular file or to nothing, before an engine opens it. Opening something else may
/// wait for ever.
fn check_file(path: &Path) -> Result<(), StoreError> {
    file::check(path).map_err(|cause| StoreError::NoFile { path: path.to_owned(), cause })
}

/// Checks every entry in a folder, and below it, in the same way.
fn check_files(folder: &Path) -> Result<(), StoreError> {
    let file_error = |cause| file_error(folder, cause);
    for entry in std::fs::read_dir(folder).map_err(file_error)? {
        let entry = entry.map_err(file_error)?;
        let path = entry.path();
        if entry.file_type().map_err(file_error)?.is_dir() {
            check_files(&path)?;
        } else if !path.is_dir() {
            check_file(&path)?;
        }
    }
    Ok(())
}

fn file_error(path: &Path, cause: io::Error) -> StoreError {
    StoreError::File { path: path.to_owned(), cause }
}

fn damaged(path: &Path, what: &str) -> StoreError {
    StoreError::Damaged { path: path.to_owned(), what: what.to_owned() }
}

fn poisoned(path: &Path) -> StoreError {
    StoreError::Poisoned { path: path.to_owned() }
}
