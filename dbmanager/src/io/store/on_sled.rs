//! The store of a robot: sled 0.34.7, pinned, with what that lacks on Linux.
//!
//! Its `flush` ends in `sync_file_range`, which never makes the drive empty its cache: of 100 simulated power cuts 99 lost
//! writes that had been acknowledged. So a commit is one batch, `flush`, and then our own `fdatasync` of its data file
//! (`tests/power_cut.rs` shows both). It never syncs the files it makes first (`conf`), nor its directory: every opening
//! does. It never syncs blobs, which it makes of long values: records are stored in pieces of 4 KiB, and a blob is an error.
//! It may panic over a damaged file, or wait for ever for a write that has failed (`watch`): both become errors.

use super::watch::Watch;
use super::witness::{self, Life, Trust};
use super::{Store, StoreError};
use crate::logic::record::{Batch, Records};
use comms::io::clock::{self, Wakeup};
use std::fs::{self, File, TryLockError};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The longest piece of a record. A leaf of the engine's tree may hold 17 of them, and a page over 128 KiB becomes a blob.
const PIECE_SIZE: usize = 4 << 10;
/// Bytes of the store that sled may keep in memory. The replica has all of it in memory anyway.
const CACHE_SIZE: u64 = 16 << 20;
/// Says whose store it is, and in which layout. No record has such a name: those begin with their length.
const GUARD: (&[u8], &[u8]) = (b"\xff\xffdca-dbmanager", b"1");
/// Which store it is, and in how many lives it was written to.
const LIFE: &[u8] = b"\xff\xfflife";
/// How long a store that was closed may still be locked, and how often to look.
const CLOSED_WITHIN: Duration = Duration::from_secs(1);
const ASK_AGAIN_AFTER: Duration = Duration::from_millis(5);
/// How many damaged stores are put aside before somebody has to look.
const ASIDE_MAX: u32 = 100;

/// A store in a directory, and its witness beside it.
#[derive(Debug)]
pub struct DirStore {
    path: PathBuf,
    /// Before the engine, which it holds too.
    watch: Watch,
    engine: sled::Db,
    data: File,
    trust: Trust,
    /// The present life, until the witness knows of it.
    unsworn: Option<Life>,
    poisoned: bool,
}

impl DirStore {
    /// Opens the store in this directory, or makes one. Everything in it is durable when this returns.
    ///
    /// # Errors
    /// If the directory cannot be used, is open already, or is damaged.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let file_error = |cause| file_error(path, cause);
        fs::create_dir_all(path).map_err(file_error)?;
        let data_path = path.join("db");
        check_free(path, &data_path)?;
        let (engine, known) = shielded(path, || open_engine(path))?;
        sync_all(path)?;
        let data = File::open(&data_path).map_err(file_error)?;
        let trust = match known {
            None => Trust::New,
            Some(life) => witness::ask(path, life, &data_path).map_err(file_error)?,
        };
        let life = known.map_or_else(Life::new, Ok).map_err(file_error)?;
        let unsworn = Some(Life { boots: life.boots.saturating_add(1), ..life });
        let watched = engine.clone();
        let watch = Watch::start(move || {
            let engine = watched.clone();
            async move { engine.flush_async().await }
        });
        let watch = watch.map_err(file_error)?;
        let store = Self { path: path.to_owned(), watch, engine, data, trust, unsworn, poisoned: false };
        if known.is_none() {
            let mut first = sled::Batch::default();
            first.insert(GUARD.0, GUARD.1);
            first.insert(LIFE, life.to_bytes());
            store.apply(first)?;
        }
        store.check_blobs()?;
        Ok(store)
    }

    /// Returns whether the replica in it may go on under the origin that it has.
    pub fn trust(&self) -> Trust {
        self.trust
    }

    /// Puts a damaged store aside, under a name beside its own that is returned. Nothing is deleted.
    ///
    /// # Errors
    /// If it cannot be renamed.
    pub fn put_aside(path: &Path) -> Result<PathBuf, StoreError> {
        let name = |number| path.with_extension(format!("aside-{number}"));
        let free = (1..=ASIDE_MAX).map(name).find(|aside| !aside.exists());
        let full = || io::Error::other("too many damaged stores lie beside it; look at them, and remove them");
        let aside = free.ok_or_else(|| file_error(path, full()))?;
        fs::rename(path, &aside).map_err(|cause| file_error(path, cause))?;
        sync(parent(path))?;
        Ok(aside)
    }

    fn write(&mut self, batch: &Batch) -> Result<(), StoreError> {
        let mut changes = sled::Batch::default();
        if let Some(life) = self.unsworn {
            changes.insert(LIFE, life.to_bytes());
        }
        for (name, record) in &batch.0 {
            let before = match self.engine.get(piece_name(name, 0)?).map_err(|cause| told(&self.path, cause))? {
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
        self.apply(changes)?;
        // Whatever made the store doubtful stays so until the replica has written what it does about it.
        if let Some(life) = self.unsworn {
            let sworn = witness::swear(&self.path, life, &self.path.join("db"));
            sworn.map_err(|cause| file_error(&self.path, cause))?;
            self.unsworn = None;
        }
        Ok(())
    }

    /// Makes changes durable.
    fn apply(&self, changes: sled::Batch) -> Result<(), StoreError> {
        let told = |cause| told(&self.path, cause);
        let write = || {
            self.engine.apply_batch(changes).map_err(told)?;
            self.engine.flush().map_err(told)
        };
        self.watch.during(|| shielded(&self.path, write))?;
        self.data.sync_data().map_err(|cause| file_error(&self.path, cause))?;
        self.check_blobs()
    }

    fn read(&self) -> Result<Records, StoreError> {
        let damaged = || damaged(&self.path, "pieces of a record are missing");
        let mut records = Records::new();
        let mut left = 0;
        for entry in self.engine.iter() {
            let (key, piece) = entry.map_err(|cause| told(&self.path, cause))?;
            if key == GUARD.0 || key == LIFE {
                continue;
            }
            let (_, rest) = key.split_first_chunk::<2>().ok_or_else(damaged)?;
            let (name, number) = rest.split_last_chunk::<2>().ok_or_else(damaged)?;
            if u16::from_be_bytes(*number) == 0 {
                if left != 0 {
                    return Err(damaged());
                }
                left = self.pieces(&piece)?.saturating_sub(1);
                records.insert(name.to_vec(), piece[2..].to_vec());
            } else {
                left = left.checked_sub(1).ok_or_else(damaged)?;
                records.get_mut(name).ok_or_else(damaged)?.extend_from_slice(&piece);
            }
        }
        if left == 0 { Ok(records) } else { Err(damaged()) }
    }

    /// Returns of how many pieces a record consists, as its first says.
    fn pieces(&self, first: &[u8]) -> Result<u16, StoreError> {
        let count = first.first_chunk().map(|count| u16::from_be_bytes(*count));
        count.ok_or_else(|| damaged(&self.path, "a piece of a record is too short"))
    }

    fn check_blobs(&self) -> Result<(), StoreError> {
        let blobs = match fs::read_dir(self.path.join("blobs")) {
            Ok(mut blobs) => blobs.next().is_some(),
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => false,
            Err(cause) => return Err(file_error(&self.path, cause)),
        };
        let blob = || damaged(&self.path, "it has a blob, which would not survive a power cut");
        if blobs { Err(blob()) } else { Ok(()) }
    }
}

impl Store for DirStore {
    fn load(&self) -> Result<Records, StoreError> {
        shielded(&self.path, || self.read())
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

/// Opens the engine; returns what the store says of its life, if it is not new.
fn open_engine(path: &Path) -> Result<(sled::Db, Option<Life>), StoreError> {
    let told = |cause| told(path, cause);
    let config = sled::Config::new().path(path).flush_every_ms(None).cache_capacity(CACHE_SIZE);
    let engine = config.open().map_err(told)?;
    let life = match engine.get(GUARD.0).map_err(told)? {
        Some(found) if found.as_ref() == GUARD.1 => {
            let life = engine.get(LIFE).map_err(told)?.and_then(|life| Life::from_bytes(&life));
            Some(life.ok_or_else(|| damaged(path, "it does not say which store it is"))?)
        }
        None if engine.is_empty() => None,
        Some(_) | None => return Err(StoreError::Foreign { path: path.to_owned() }),
    };
    Ok((engine, life))
}

/// Checks that nobody has the store open. The engine takes the same lock, but says nothing that could be told from others;
/// and it lets go of it on a thread of its own, some time after it was closed, without a word.
fn check_free(path: &Path, data: &Path) -> Result<(), StoreError> {
    let file = match File::open(data) {
        Ok(file) => file,
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(cause) => return Err(file_error(path, cause)),
    };
    let until = clock::now() + CLOSED_WITHIN;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(()),
            Err(TryLockError::WouldBlock) if clock::now() < until => {
                Wakeup::default().wait(Some(clock::now() + ASK_AGAIN_AFTER));
            }
            Err(TryLockError::WouldBlock) => return Err(StoreError::Busy { path: path.to_owned() }),
            Err(TryLockError::Error(cause)) => return Err(file_error(path, cause)),
        }
    }
}

/// Runs what calls the engine. A panic in there is about files that are not as it left them.
fn shielded<T>(path: &Path, work: impl FnOnce() -> Result<T, StoreError>) -> Result<T, StoreError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let what = panic.downcast_ref::<String>().map(String::as_str);
        let what = what.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("the engine panicked");
        Err(damaged(path, what.lines().next().unwrap_or(what)))
    })
}

/// Returns what the engine's error means for who uses the store.
fn told(path: &Path, cause: sled::Error) -> StoreError {
    let sled::Error::Io(cause) = cause else { return damaged(path, &cause.to_string()) };
    file_error(path, cause)
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
    sync(parent(path))
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn sync(path: &Path) -> Result<(), StoreError> {
    File::open(path).and_then(|file| file.sync_all()).map_err(|cause| file_error(path, cause))
}

fn file_error(path: &Path, cause: io::Error) -> StoreError {
    StoreError::File { path: path.to_owned(), cause }
}

fn damaged(path: &Path, what: &str) -> StoreError {
    StoreError::Damaged { path: path.to_owned(), what: what.to_owned() }
}
