//! The store: records that survive a power cut once [`Store::commit`] has returned.
//!
//! It is sled 0.34.7, pinned, with what that lacks on Linux. Its `flush` ends in `sync_file_range`, which never makes the
//! drive empty its cache: of 100 simulated power cuts 99 lost writes that had been acknowledged. So a commit is one batch,
//! `flush`, and then our own `fdatasync` of its data file; with it none of 100 lost anything. It never syncs the files it
//! makes first (`conf`), nor its directory: every opening does. It never syncs blobs, which it makes of long values: records
//! are stored in pieces of 4 KiB, and a blob is an error.
//!
//! After an error the store is poisoned: a sync that failed and is tried again may succeed although the pages are gone
//! (fsyncgate). Whoever has it opens it anew, which syncs and checks everything.

pub mod memory;

use crate::logic::record::{Batch, Records};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The longest piece of a record. A leaf of the engine's tree may hold 17 of them, and a page over 128 KiB becomes a blob.
const PIECE_SIZE: usize = 4 << 10;
/// Bytes of the store that sled may keep in memory. The replica has all of it in memory anyway.
const CACHE_SIZE: u64 = 16 << 20;
/// Says whose store it is, and in which layout. No record has such a name: those begin with their length.
const GUARD: (&[u8], &[u8]) = (b"\xff\xffdca-dbmanager", b"1");
/// How many damaged stores are put aside before somebody has to look.
const ASIDE_MAX: u32 = 100;

/// Somewhere to keep records.
pub trait Store {
    /// Reads everything.
    ///
    /// # Errors
    /// If that fails, or what is there is not what was written.
    fn load(&self) -> Result<Records, StoreError>;

    /// Writes a batch, as a whole or not at all. It is durable when this returns.
    ///
    /// # Errors
    /// If it may not be durable. Then the store is poisoned.
    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError>;
}

/// Why a store does not do what it should.
#[derive(Debug, Error)]
pub enum StoreError {
    /// A file or directory cannot be used.
    #[error("store `{path}`: {cause}")]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        cause: io::Error,
    },
    /// The engine says so.
    #[error("store `{path}`: {cause}")]
    Engine {
        /// Where.
        path: PathBuf,
        /// What it says.
        cause: sled::Error,
    },
    /// There are files, but not ours, or of another layout.
    #[error("`{path}` is not a store of this program")]
    Foreign {
        /// Where.
        path: PathBuf,
    },
    /// Pieces of a record are missing.
    #[error("a record of the store `{path}` is incomplete")]
    Incomplete {
        /// Where.
        path: PathBuf,
    },
    /// The engine has put a value where it is never synced.
    #[error("the store `{path}` has a blob, which would not survive a power cut")]
    Blob {
        /// Where.
        path: PathBuf,
    },
    /// A record is too long, or its name is.
    #[error("a record of {size} bytes is too long for the store")]
    Long {
        /// Its size.
        size: usize,
    },
    /// It has failed before.
    #[error("the store `{path}` has failed before and has to be opened anew")]
    Poisoned {
        /// Where.
        path: PathBuf,
    },
}

/// A store in a directory.
#[derive(Debug)]
pub struct DirStore {
    path: PathBuf,
    engine: sled::Db,
    data: File,
    poisoned: bool,
}

impl DirStore {
    /// Opens the store in this directory, or makes one. Everything in it is durable when this returns.
    ///
    /// # Errors
    /// If the directory cannot be used, is open already, or is damaged.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let engine_error = |cause| StoreError::Engine { path: path.to_owned(), cause };
        fs::create_dir_all(path).map_err(|cause| file_error(path, cause))?;
        let config = sled::Config::new().path(path).flush_every_ms(None).cache_capacity(CACHE_SIZE);
        let engine = config.open().map_err(engine_error)?;
        let guard = engine.get(GUARD.0).map_err(engine_error)?;
        match guard {
            Some(found) if found.as_ref() == GUARD.1 => {}
            None if engine.is_empty() => {
                engine.insert(GUARD.0, GUARD.1).map_err(engine_error)?;
                engine.flush().map_err(engine_error)?;
            }
            Some(_) | None => return Err(StoreError::Foreign { path: path.to_owned() }),
        }
        sync_all(path)?;
        let data_path = path.join("db");
        let data = File::open(&data_path).map_err(|cause| file_error(&data_path, cause))?;
        let store = Self { path: path.to_owned(), engine, data, poisoned: false };
        store.check_blobs()?;
        Ok(store)
    }

    /// Puts a damaged store aside, under a name beside its own that is returned. Nothing is deleted.
    ///
    /// # Errors
    /// If it cannot be renamed.
    pub fn put_aside(path: &Path) -> Result<PathBuf, StoreError> {
        let name = |number| path.with_extension(format!("aside-{number}"));
        let free = (1..=ASIDE_MAX).map(name).find(|aside| !aside.exists());
        let aside = free.ok_or_else(|| file_error(path, io::ErrorKind::StorageFull.into()))?;
        fs::rename(path, &aside).map_err(|cause| file_error(path, cause))?;
        if let Some(parent) = path.parent() {
            sync(parent)?;
        }
        Ok(aside)
    }

    fn write(&self, batch: &Batch) -> Result<(), StoreError> {
        let engine_error = |cause| StoreError::Engine { path: self.path.clone(), cause };
        let mut changes = sled::Batch::default();
        for (name, record) in &batch.0 {
            let before = match self.engine.get(piece_name(name, 0)?).map_err(engine_error)? {
                Some(first) => self.pieces(&first)?,
                None => 0,
            };
            let bytes = record.as_deref().unwrap_or_default();
            let pieces: Vec<&[u8]> = bytes.chunks(PIECE_SIZE).collect();
            let long = |_cause| StoreError::Long { size: bytes.len() };
            let count = if record.is_some() { u16::try_from(pieces.len().max(1)).map_err(long)? } else { 0 };
            for number in 0..count {
                let piece = pieces.get(usize::from(number)).copied().unwrap_or_default();
                let head = if number == 0 { count.to_be_bytes().to_vec() } else { Vec::new() };
                changes.insert(piece_name(name, number)?, [&head, piece].concat());
            }
            for number in count..before {
                changes.remove(piece_name(name, number)?);
            }
        }
        self.engine.apply_batch(changes).map_err(engine_error)?;
        self.engine.flush().map_err(engine_error)?;
        self.data.sync_data().map_err(|cause| file_error(&self.path, cause))?;
        self.check_blobs()
    }

    /// Returns of how many pieces a record consists, as its first says.
    fn pieces(&self, first: &[u8]) -> Result<u16, StoreError> {
        let count = first.first_chunk().map(|count| u16::from_be_bytes(*count));
        count.ok_or_else(|| StoreError::Incomplete { path: self.path.clone() })
    }

    fn check_blobs(&self) -> Result<(), StoreError> {
        let blobs = match fs::read_dir(self.path.join("blobs")) {
            Ok(mut blobs) => blobs.next().is_some(),
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => false,
            Err(cause) => return Err(file_error(&self.path, cause)),
        };
        if blobs { Err(StoreError::Blob { path: self.path.clone() }) } else { Ok(()) }
    }
}

impl Store for DirStore {
    fn load(&self) -> Result<Records, StoreError> {
        let incomplete = || StoreError::Incomplete { path: self.path.clone() };
        let mut records = Records::new();
        let mut left = 0;
        for entry in self.engine.iter() {
            let (key, piece) = entry.map_err(|cause| StoreError::Engine { path: self.path.clone(), cause })?;
            if key == GUARD.0 {
                continue;
            }
            let (_, rest) = key.split_first_chunk::<2>().ok_or_else(incomplete)?;
            let (name, number) = rest.split_last_chunk::<2>().ok_or_else(incomplete)?;
            if u16::from_be_bytes(*number) == 0 {
                if left != 0 {
                    return Err(incomplete());
                }
                left = self.pieces(&piece)?.saturating_sub(1);
                records.insert(name.to_vec(), piece[2..].to_vec());
            } else {
                left = left.checked_sub(1).ok_or_else(incomplete)?;
                records.get_mut(name).ok_or_else(incomplete)?.extend_from_slice(&piece);
            }
        }
        if left == 0 { Ok(records) } else { Err(incomplete()) }
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        if self.poisoned {
            return Err(StoreError::Poisoned { path: self.path.clone() });
        }
        self.poisoned = true;
        self.write(batch)?;
        self.poisoned = false;
        Ok(())
    }
}

/// Returns the name of a piece. The length goes first, so that no record's pieces are among another's.
fn piece_name(name: &[u8], number: u16) -> Result<Vec<u8>, StoreError> {
    let length = u16::try_from(name.len()).ok().filter(|length| *length < u16::MAX);
    let length = length.ok_or(StoreError::Long { size: name.len() })?;
    Ok([&length.to_be_bytes(), name, &number.to_be_bytes()].concat())
}

/// Makes every file below a directory durable, the directories themselves, and the name of the first.
fn sync_all(path: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(path).map_err(|cause| file_error(path, cause))? {
        let entry = entry.map_err(|cause| file_error(path, cause))?;
        if entry.file_type().map_err(|cause| file_error(path, cause))?.is_dir() {
            sync_all(&entry.path())?;
        } else {
            sync(&entry.path())?;
        }
    }
    sync(path)?;
    match path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        Some(parent) => sync(parent),
        None => sync(Path::new(".")),
    }
}

fn sync(path: &Path) -> Result<(), StoreError> {
    File::open(path).and_then(|file| file.sync_all()).map_err(|cause| file_error(path, cause))
}

fn file_error(path: &Path, cause: io::Error) -> StoreError {
    StoreError::File { path: path.to_owned(), cause }
}
