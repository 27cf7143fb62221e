//! A store on sled 0.34.7, a pinned version, with additions for Linux: a separate folder in the folder of the store.
//!
//! Additions to the engine:
//!
//! - Its `flush` ends with `sync_file_range`, which never makes the drive empty its cache: 99 of 100 simulated power cuts lost
//!   acknowledged writes. So a commit is one batch, `flush`, and then an `fdatasync` of the data file by this adapter.
//! - It never syncs the files that it makes first (`conf`), nor its directory; every opening of a store does.
//! - It never syncs blobs, which it makes of long values. So records are stored in pieces of 4 KiB, and a blob is an error.
//! - It may panic over a damaged file, or wait for ever for a failed write (`watch`). Both become errors.
//! - It gives up on a partly written snapshot. Such a snapshot is removed.

use super::dir::{Opened, Records};
use super::watch::Watch;
use super::witness::{self, Life};
use super::{StoreError, damaged, file_error, shielded};
use crate::logic::record::Batch;
use comms::io::clock::{self, Wakeup};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The engine's folder in the folder of a store.
pub(super) const FOLDER: &str = "records.sled";
pub(super) const DATA: &str = "db";
/// The longest piece of a record, in bytes. A leaf of the engine's tree may hold 17 pieces, and a page over 128 KiB becomes a blob.
const PIECE_SIZE: usize = 4 << 10;
/// How many bytes of the store sled may keep in memory. The replica keeps all of them in memory anyway.
const CACHE_SIZE: u64 = 4 << 20;
/// A record about the store: its program and its layout. No other record has such a name, since names of records begin with their
/// length.
const GUARD: (&[u8], &[u8]) = (b"\xff\xffdca-dbmanager", b"2");
/// The name of the record with the store's identity and its number of lives.
const LIFE: &[u8] = b"\xff\xfflife";
/// The greatest length of the data file of a new store, in bytes.
const NEW_SIZE_MAX: u64 = 4 << 20;
/// How long a store may remain locked after it was closed.
const CLOSED_WITHIN: Duration = Duration::from_secs(1);
const ASK_AGAIN_AFTER: Duration = Duration::from_millis(5);

/// An open store on sled.
#[derive(Debug)]
struct OnSled {
    path: PathBuf,
    /// Declared before the engine, so that it is dropped first: the watch also holds the engine.
    watch: Watch,
    engine: sled::Db,
    data: File,
}

/// Opens the engine of the store in `path`.
pub(super) fn open(path: &Path) -> Result<Opened, StoreError> {
    let file_error = |cause| file_error(path, cause);
    let folder = path.join(FOLDER);
    fs::create_dir_all(&folder).map_err(file_error)?;
    check_free(path, &folder.join(DATA))?;
    forget_half_snapshots(&folder).map_err(file_error)?;
    let (engine, life) = open_or_begin_again(path, &folder)?;
    let data = File::open(folder.join(DATA)).map_err(file_error)?;
    let watched = engine.clone();
    let watch = Watch::start(move || {
        let engine = watched.clone();
        async move { engine.flush_async().await }
    });
    let store = OnSled { path: path.to_owned(), watch: watch.map_err(file_error)?, engine, data };
    store.check_blobs()?;
    Ok((Box::new(store), life))
}

impl Records for OnSled {
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError> {
        let damaged = || damaged(&self.path, "pieces of a record are missing");
        let (mut record, mut left): ((Vec<u8>, Vec<u8>), u16) = Default::default();
        for entry in self.engine.iter() {
            let (key, piece) = entry.map_err(|cause| store_error(&self.path, cause))?;
            if key == GUARD.0 || key == LIFE {
                continue;
            }
            let (_, rest) = key.split_first_chunk::<2>().ok_or_else(damaged)?;
            let (name, number) = rest.split_last_chunk::<2>().ok_or_else(damaged)?;
            if u16::from_be_bytes(*number) == 0 && left == 0 {
                left = self.pieces(&piece)?;
                record = (name.to_vec(), piece.get(2..).unwrap_or_default().to_vec());
            } else if name == record.0 && left > 0 {
                record.1.extend_from_slice(&piece);
            } else {
                return Err(damaged());
            }
            left = left.checked_sub(1).ok_or_else(damaged)?;
            if left == 0 {
                take(&record.0, &record.1);
            }
        }
        if left == 0 { Ok(()) } else { Err(damaged()) }
    }

    fn write(&mut self, life: Option<Life>, batch: &Batch) -> Result<(), StoreError> {
        let mut changes = sled::Batch::default();
        if let Some(life) = life {
            changes.insert(GUARD.0, GUARD.1);
            changes.insert(LIFE, life.to_bytes());
        }
        for (name, record) in &batch.0 {
            let before = match self.engine.get(piece_name(name, 0)?).map_err(|cause| store_error(&self.path, cause))? {
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
        let failed = |cause| store_error(&self.path, cause);
        let write = || {
            self.engine.apply_batch(changes).map_err(failed)?;
            self.engine.flush().map_err(failed)
        };
        self.watch.during(write)?;
        self.data.sync_data().map_err(|cause| file_error(&self.path, cause))?;
        self.check_blobs()
    }

    /// The engine closes when it is dropped.
    fn close(self: Box<Self>) {}
}

impl OnSled {
    /// Returns the number of pieces of a record, which is stored in its first piece.
    fn pieces(&self, first: &[u8]) -> Result<u16, StoreError> {
        let count = first.first_chunk().map(|count| u16::from_be_bytes(*count));
        count.ok_or_else(|| damaged(&self.path, "a piece of a record is too short"))
    }

    fn check_blobs(&self) -> Result<(), StoreError> {
        let blobs = match fs::read_dir(self.path.join(FOLDER).join("blobs")) {
            Ok(mut blobs) => blobs.next().is_some(),
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => false,
            Err(cause) => return Err(file_error(&self.path, cause)),
        };
        let blob = || damaged(&self.path, "it has a blob, which would not survive a power cut");
        if blobs { Err(blob()) } else { Ok(()) }
    }
}

/// Opens the engine. Also returns the life that the store has recorded; none in a new store.
fn open_engine(path: &Path, folder: &Path) -> Result<(sled::Db, Option<Life>), StoreError> {
    let failed = |cause| store_error(path, cause);
    let config = sled::Config::new().path(folder).flush_every_ms(None).cache_capacity(CACHE_SIZE);
    let engine = config.open().map_err(failed)?;
    let life = match engine.get(GUARD.0).map_err(failed)? {
        Some(found) if found.as_ref() == GUARD.1 => {
            let life = engine.get(LIFE).map_err(failed)?.and_then(|life| Life::from_bytes(&life));
            Some(life.ok_or_else(|| damaged(path, "it does not say which store it is"))?)
        }
        None if engine.is_empty() => None,
        Some(_) | None => return Err(StoreError::Foreign { path: path.to_owned() }),
    };
    Ok((engine, life))
}

/// Checks that no process has the store open. The engine takes the same lock, but its error looks like others. It releases the lock
/// on a separate thread, some time after it was closed.
fn check_free(path: &Path, data: &Path) -> Result<(), StoreError> {
    let file = match File::open(data) {
        Ok(file) => file,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(cause) => return Err(file_error(path, cause)),
    };
    let until = clock::now() + CLOSED_WITHIN;
    loop {
        match file.try_lock() {
            // Closing the file would not be enough: a program that another thread is just starting may briefly hold the file as
            // well.
            Ok(()) => return file.unlock().map_err(|cause| file_error(path, cause)),
            Err(TryLockError::WouldBlock) if clock::now() < until => {
                Wakeup::default().wait(Some(clock::now() + ASK_AGAIN_AFTER));
            }
            Err(TryLockError::WouldBlock) => return Err(StoreError::Busy { path: path.to_owned() }),
            Err(TryLockError::Error(cause)) => return Err(file_error(path, cause)),
        }
    }
}

/// Opens the engine. If it was interrupted while it made its first files, these are put aside, and it begins again.
fn open_or_begin_again(path: &Path, folder: &Path) -> Result<(sled::Db, Option<Life>), StoreError> {
    let opened = shielded(path, || open_engine(path, folder));
    let size = folder.join(DATA).metadata().map_or(0, |file| file.len());
    // Without a witness no commit was acknowledged yet.
    if opened.as_ref().is_err_and(StoreError::is_damage) && !witness::exists(path) && size <= NEW_SIZE_MAX {
        let aside = folder.with_extension("begun");
        let cleared = if aside.exists() { fs::remove_dir_all(&aside) } else { Ok(()) };
        let moved = cleared.and_then(|()| fs::rename(folder, &aside)).and_then(|()| fs::create_dir(folder));
        moved.map_err(|cause| file_error(path, cause))?;
        return open_engine(path, folder);
    }
    opened
}

/// Removes incomplete snapshots of the engine's page table, which it was writing when it was interrupted. It would fail on them.
fn forget_half_snapshots(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name().as_encoded_bytes().ends_with(b".generating") {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// Converts the engine's error into an error that users of the store understand.
fn store_error(path: &Path, cause: sled::Error) -> StoreError {
    let sled::Error::Io(cause) = cause else { return damaged(path, &cause.to_string()) };
    // The engine reports the system errors of its threads as text.
    let text = cause.to_string();
    let full = text.contains("StorageFull");
    file_error(path, if full { io::Error::new(io::ErrorKind::StorageFull, text) } else { cause })
}

/// Returns the name of a piece. It begins with the length, so that the pieces of different records do not mix.
fn piece_name(name: &[u8], number: u16) -> Result<Vec<u8>, StoreError> {
    let length = u16::try_from(name.len()).ok().filter(|length| *length < u16::MAX);
    let length = length.ok_or(StoreError::Long { size: name.len() })?;
    Ok([&length.to_be_bytes(), name, &number.to_be_bytes()].concat())
}
