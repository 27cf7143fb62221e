//! A store on redb: one file.
//!
//! *A commit.* The engine copies each changed page to a place that the last state does not use, and writes it there. Then
//! it writes the first sector of the file, which has two slots for the root of a state. The root of the new state goes
//! into the slot that the last state does not use, and a mark tells which slot is the newest. One `fdatasync` follows.
//! Each parent stores a checksum of 128 bits beside the number of a page. Each slot has such a checksum of its root, and
//! another checksum of the slot itself. After a power cut, any of these writes may be present or missing. If all are
//! present, the file has the new state. Otherwise some checksum does not fit, and the other slot leads to the last state,
//! of which no page was touched. So one sync is enough. Two phases (`set_two_phase_commit`) would cost a second sync, and
//! would help only against an attacker who chooses both the values and the order of the drive's writes. When the file
//! grows, it is synced before any content depends on the new length.
//!
//! *Additions.* The engine checks checksums only if it was not closed properly, and may panic over damage; this adapter
//! checks all of them at every opening. The engine never syncs the folder. Every opening of a store syncs the folder. The engine
//! treats an empty file as a new one; this adapter does not if a witness shows that the file had content.

use super::dir::{Opened, Records};
use super::witness::{self, Life};
use super::{StoreError, damaged, file_error, shielded};
use crate::logic::record::Batch;
use redb::backends::FileBackend;
use redb::{Database, ReadableDatabase, ReadableTable, TableDefinition};
use std::fs::{File, TryLockError};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// The file in the folder of a store.
pub(super) const DATA: &str = "records.redb";
/// The records, by name.
const RECORDS: TableDefinition<'static, &[u8], &[u8]> = TableDefinition::new("records");
/// Records about the store: its program, its layout, its number, and the number of lives in which it was written to.
const GUARD: TableDefinition<'static, &str, &[u8]> = TableDefinition::new("dca-dbmanager");
const LAYOUT: (&str, &[u8]) = ("layout", b"1");
const LIFE: &str = "life";
/// How many bytes of the file the engine may keep in memory. The replica keeps the whole content in memory anyway.
const CACHE_SIZE: usize = 1 << 20;
/// Sizes in the engine's file: the magic bytes at its beginning, the page with these bytes and the roots, and the longest
/// new file. Source: redb 4.5, `header.rs` and `page_manager.rs`.
const MAGIC_SIZE: usize = 9;
const HEAD_SIZE: usize = 4096;
const NEW_SIZE_MAX: u64 = 4 << 20;

/// An open store on redb.
#[derive(Debug)]
struct OnRedb {
    path: PathBuf,
    engine: Database,
}

impl Records for OnRedb {
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError> {
        read(&self.engine, take).map_err(|cause| store_error(&self.path, cause))
    }

    fn write(&mut self, life: Option<Life>, batch: &Batch) -> Result<(), StoreError> {
        write(&self.engine, life, batch).map_err(|cause| store_error(&self.path, cause))
    }

    /// A store that was not closed properly only takes a little longer to open.
    fn close(self: Box<Self>) {
        let Self { path, engine } = *self;
        let closed = shielded(&path, || engine.close().map_err(|cause| store_error(&path, cause.into())));
        if let Err(error) = closed {
            tracing::debug!(%error, "a store was not closed in order");
        }
    }
}

/// Opens the engine of the store in `path`.
pub(super) fn open(path: &Path) -> Result<Opened, StoreError> {
    let (engine, life) = open_engine(path, &path.join(DATA))?;
    Ok((Box::new(OnRedb { path: path.to_owned(), engine }), life))
}

/// Opens the engine, and checks every checksum in its file. Also returns the life that the store has recorded; none in a
/// new store.
fn open_engine(path: &Path, data: &Path) -> Result<(Database, Option<Life>), StoreError> {
    use redb::Error::{TableDoesNotExist, TableIsMultimap, TableTypeMismatch};
    let file = open_file(path, data)?;
    let mut builder = Database::builder();
    builder.set_cache_size(CACHE_SIZE).set_check_integrity_on_open(true);
    let engine = FileBackend::new(file).and_then(|file| builder.create_with_backend(file));
    let engine = engine.map_err(|cause| store_error(path, cause.into()))?;
    let found = match read_guard(&engine) {
        Err(TableDoesNotExist(_) | TableIsMultimap(_) | TableTypeMismatch { .. }) => {
            return Err(StoreError::Foreign { path: path.to_owned() });
        }
        found => found.map_err(|cause| store_error(path, cause))?,
    };
    let Some([layout, life]) = found else { return Ok((engine, None)) };
    if layout != LAYOUT.1 {
        return Err(StoreError::Foreign { path: path.to_owned() });
    }
    let life = Life::from_bytes(&life).ok_or_else(|| damaged(path, "it does not say which store it is"))?;
    Ok((engine, Some(life)))
}

/// Opens the file, and locks it. If the engine was interrupted while it made the file, the file is emptied again.
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

/// Returns whether a file has only a header without the magic bytes, which the engine writes last.
fn is_false_start(mut file: &File) -> io::Result<bool> {
    if file.metadata()?.len() > NEW_SIZE_MAX {
        return Ok(false);
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    let zero = |bytes: &[u8]| bytes.iter().all(|byte| *byte == 0);
    Ok(bytes.get(..MAGIC_SIZE).is_none_or(zero) && bytes.get(HEAD_SIZE..).is_none_or(zero))
}

/// Returns the layout and the life; `None` if the table does not exist.
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

/// Converts the engine's error into an error that users of the store understand.
#[expect(clippy::wildcard_enum_match_arm, reason = "most errors of the engine are about calls that are not made here")]
fn store_error(path: &Path, cause: redb::Error) -> StoreError {
    use io::ErrorKind::{InvalidData, UnexpectedEof};
    use redb::Error;
    match cause {
        Error::DatabaseAlreadyOpen | Error::LockProtocolMismatch => StoreError::Busy { path: path.to_owned() },
        Error::Corrupted(what) => damaged(path, &what),
        // This program has written only one version of the format.
        Error::UpgradeRequired(_) => damaged(path, &cause.to_string()),
        // The file is shorter than its header claims, or its header is not valid.
        Error::Io(cause) if matches!(cause.kind(), InvalidData | UnexpectedEof) => damaged(path, &cause.to_string()),
        Error::Io(cause) => file_error(path, cause),
        cause => file_error(path, io::Error::other(cause)),
    }
}
