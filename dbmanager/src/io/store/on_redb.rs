//! The store of a robot: a file of redb, and a witness beside its folder.
//!
//! *What a commit does.* The engine copies each page that changes to a place that the last state does not use, and
//! writes it; then, into the first sector of the file, the root of the new state, in the one of two slots that is not
//! the last state's, and which slot is the newest; then one `fdatasync`. Each page is named by its parent together with
//! a sum of 128 bits, each root by its slot, and each slot has a sum. After a power cut any of these writes may be
//! there and others not. If all are, that is the new state. If not, some sum does not fit, and the other slot leads to
//! the last state, of which no page was touched. So one sync is enough; two phases (`set_two_phase_commit`) would cost
//! a second one, and only help against somebody who chooses both the values and what the drive writes first. A file
//! grows, and is synced, before anything says that it is longer.
//!
//! *What is added.* The engine checks sums only when it was not closed in order, and may panic over what it then finds:
//! here every opening checks all of them, and a panic is an error. It never syncs the folder: every opening does. It
//! takes an empty file for a new one: not if there is a witness of what was in it. After an error it is closed, and has
//! to be opened anew.

use super::witness::{self, Life, Trust};
use super::{Store, StoreError};
use crate::logic::record::Batch;
use redb::backends::FileBackend;
use redb::{Database, ReadableDatabase, ReadableTable, TableDefinition};
use std::fs::{self, File, TryLockError};
use std::io::{self, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

/// The file in the folder of a store.
const DATA: &str = "records.redb";
/// Files of the engine that earlier versions of this program had.
const OUTDATED: [&str; 2] = ["conf", "db"];
/// The records, by name.
const RECORDS: TableDefinition<'static, &[u8], &[u8]> = TableDefinition::new("records");
/// Says whose store it is, in which layout, which one, and in how many lives it was written to.
const GUARD: TableDefinition<'static, &str, &[u8]> = TableDefinition::new("dca-dbmanager");
const LAYOUT: (&str, &[u8]) = ("layout", b"1");
const LIFE: &str = "life";
/// Bytes of the file that the engine may keep in memory. The replica has all that is in it in memory anyway.
const CACHE_SIZE: usize = 1 << 20;
/// The longest name of a record, and the longest record: far more than a replica ever writes.
const NAME_SIZE_MAX: usize = 32 << 10;
const RECORD_SIZE_MAX: usize = 64 << 20;
/// Of the engine's file: what it is, the page with that and the roots, and how long a new one is at the most.
/// Source: redb 4.5, `header.rs` and `page_manager.rs`.
const MAGIC_SIZE: usize = 9;
const HEAD_SIZE: usize = 4096;
const NEW_SIZE_MAX: u64 = 4 << 20;
/// How many damaged stores are put aside before somebody has to look.
const ASIDE_MAX: u32 = 100;

/// A store in a directory, and its witness beside it.
#[derive(Debug)]
pub struct DirStore {
    path: PathBuf,
    /// Gone after an error.
    engine: Option<Database>,
    trust: Trust,
    /// The present life, until the witness knows of it.
    unsworn: Option<Life>,
}

impl DirStore {
    /// Opens the store in this directory, or makes one. Everything in it is durable when this returns.
    ///
    /// # Errors
    /// If the directory cannot be used, is open already, or is damaged.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let file_error = |cause| file_error(path, cause);
        fs::create_dir_all(path).map_err(file_error)?;
        let data = path.join(DATA);
        let was_there = data.try_exists().map_err(file_error)?;
        if !was_there && OUTDATED.iter().any(|name| path.join(name).exists()) {
            return Err(StoreError::Outdated { path: path.to_owned() });
        }
        let (engine, known) = shielded(path, || open_engine(path, &data))?;
        let mut store = Self { path: path.to_owned(), engine: Some(engine), trust: Trust::New, unsworn: None };
        [data.as_path(), path, parent(path)].into_iter().try_for_each(sync)?;
        let life = match known {
            Some(life) => life,
            None if was_there && witness::exists(path) => return Err(damaged(path, "it is empty, and was not")),
            None => {
                let life = Life::new().map_err(file_error)?;
                store.apply(Some(life), &Batch::default())?;
                life
            }
        };
        store.trust = witness::ask(path, life, &data).map_err(file_error)?;
        store.unsworn = Some(Life { boots: life.boots.saturating_add(1), ..life });
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

    /// Makes changes durable, or closes the engine.
    fn apply(&mut self, life: Option<Life>, batch: &Batch) -> Result<(), StoreError> {
        let engine = self.engine.take().ok_or_else(|| poisoned(&self.path))?;
        let done = shielded(&self.path, || {
            check_sizes(batch)?;
            write(&engine, life, batch).map_err(|cause| told(&self.path, cause))
        });
        match done {
            Ok(()) => self.engine = Some(engine),
            Err(_) => close(&self.path, engine),
        }
        done
    }

    /// Tells the witness about this life, if it does not know. Whatever made the store doubtful stays so until the
    /// replica has written what it does about it.
    fn swear(&mut self) -> Result<(), StoreError> {
        if let Some(life) = self.unsworn {
            let sworn = witness::swear(&self.path, life, &self.path.join(DATA));
            sworn.map_err(|cause| file_error(&self.path, cause))?;
            self.unsworn = None;
        }
        Ok(())
    }
}

impl Store for DirStore {
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError> {
        let engine = self.engine.as_ref().ok_or_else(|| poisoned(&self.path))?;
        shielded(&self.path, || read(engine, take).map_err(|cause| told(&self.path, cause)))
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.apply(self.unsworn, batch)?;
        let sworn = self.swear();
        if sworn.is_err()
            && let Some(engine) = self.engine.take()
        {
            close(&self.path, engine);
        }
        sworn
    }
}

impl Drop for DirStore {
    fn drop(&mut self) {
        if let Some(engine) = self.engine.take() {
            close(&self.path, engine);
        }
    }
}

/// Opens the engine, and checks every sum in its file; returns what the store says of its life, if it is not new.
fn open_engine(path: &Path, data: &Path) -> Result<(Database, Option<Life>), StoreError> {
    use redb::Error::{TableDoesNotExist, TableIsMultimap, TableTypeMismatch};
    let file = open_file(path, data)?;
    let mut builder = Database::builder();
    builder.set_cache_size(CACHE_SIZE).set_check_integrity_on_open(true);
    let engine = FileBackend::new(file).and_then(|file| builder.create_with_backend(file));
    let engine = engine.map_err(|cause| told(path, cause.into()))?;
    let found = match read_guard(&engine) {
        Err(TableDoesNotExist(_) | TableIsMultimap(_) | TableTypeMismatch { .. }) => {
            return Err(StoreError::Foreign { path: path.to_owned() });
        }
        found => found.map_err(|cause| told(path, cause))?,
    };
    let Some([layout, life]) = found else { return Ok((engine, None)) };
    if layout != LAYOUT.1 {
        return Err(StoreError::Foreign { path: path.to_owned() });
    }
    let life = Life::from_bytes(&life).ok_or_else(|| damaged(path, "it does not say which store it is"))?;
    Ok((engine, Some(life)))
}

/// Opens the file, locked. One in which the engine had only begun when it was cut off is empty again.
fn open_file(path: &Path, data: &Path) -> Result<File, StoreError> {
    let file_error = |cause| file_error(path, cause);
    let opened = File::options().read(true).write(true).create(true).truncate(false).open(data);
    let file = opened.map_err(file_error)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(StoreError::Busy { path: path.to_owned() }),
        Err(TryLockError::Error(cause)) => return Err(file_error(cause)),
    }
    if !witness::exists(path) && is_false_start(&file).map_err(file_error)? {
        file.set_len(0).map_err(file_error)?;
    }
    Ok(file)
}

/// Returns whether there is nothing in a file but a head that does not say yet what it is: the engine writes that last.
fn is_false_start(mut file: &File) -> io::Result<bool> {
    if file.metadata()?.len() > NEW_SIZE_MAX {
        return Ok(false);
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    let zero = |bytes: &[u8]| bytes.iter().all(|byte| *byte == 0);
    Ok(bytes.get(..MAGIC_SIZE).is_none_or(zero) && bytes.get(HEAD_SIZE..).is_none_or(zero))
}

/// Returns layout and life; `None` if there is no table at all.
fn read_guard(engine: &Database) -> Result<Option<[Vec<u8>; 2]>, redb::Error> {
    let txn = engine.begin_read()?;
    if txn.list_tables()?.next().is_none() {
        return Ok(None);
    }
    let guard = txn.open_table(GUARD)?;
    let get = |name| guard.get(name).map(|found| found.map_or_else(Vec::new, |found| found.value().to_vec()));
    Ok(Some([get(LAYOUT.0)?, get(LIFE)?]))
}

fn read(engine: &Database, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), redb::Error> {
    for entry in engine.begin_read()?.open_table(RECORDS)?.iter()? {
        let (name, record) = entry?;
        take(name.value(), record.value());
    }
    Ok(())
}

fn write(engine: &Database, life: Option<Life>, batch: &Batch) -> Result<(), redb::Error> {
    let txn = engine.begin_write()?;
    if let Some(life) = life {
        let mut guard = txn.open_table(GUARD)?;
        drop(guard.insert(LAYOUT.0, LAYOUT.1)?);
        drop(guard.insert(LIFE, &life.to_bytes()[..])?);
    }
    let mut records = txn.open_table(RECORDS)?;
    for (name, record) in &batch.0 {
        match record {
            Some(record) => drop(records.insert(&name[..], &record[..])?),
            None => drop(records.remove(&name[..])?),
        }
    }
    drop(records);
    Ok(txn.commit()?)
}

/// Closes the engine: a store that is not closed in order is only opened a little more slowly.
fn close(path: &Path, engine: Database) {
    let closed = shielded(path, || engine.close().map_err(|cause| told(path, cause.into())));
    if let Err(error) = closed {
        tracing::debug!(%error, "a store was not closed in order");
    }
}

fn check_sizes(batch: &Batch) -> Result<(), StoreError> {
    let long = |(name, record): (&Vec<u8>, &Option<Vec<u8>>)| {
        let size = record.as_ref().map_or(0, Vec::len);
        (name.len() > NAME_SIZE_MAX || size > RECORD_SIZE_MAX).then_some(StoreError::Long { size: name.len() + size })
    };
    batch.0.iter().find_map(long).map_or(Ok(()), Err)
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
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "most of what the engine may say is about calls that nobody makes here"
)]
fn told(path: &Path, cause: redb::Error) -> StoreError {
    use io::ErrorKind::{InvalidData, UnexpectedEof};
    use redb::Error;
    match cause {
        Error::DatabaseAlreadyOpen | Error::LockProtocolMismatch => StoreError::Busy { path: path.to_owned() },
        Error::Corrupted(what) => damaged(path, &what),
        // There is but one version of the format that this program ever wrote.
        Error::UpgradeRequired(_) => damaged(path, &cause.to_string()),
        // The file is shorter than it says, or does not say what it is.
        Error::Io(cause) if matches!(cause.kind(), InvalidData | UnexpectedEof) => damaged(path, &cause.to_string()),
        Error::Io(cause) => file_error(path, cause),
        cause => file_error(path, io::Error::other(cause)),
    }
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

fn poisoned(path: &Path) -> StoreError {
    StoreError::Poisoned { path: path.to_owned() }
}
