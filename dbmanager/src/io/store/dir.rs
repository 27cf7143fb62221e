//! The store of a robot: a folder with the records, kept by one of two engines, and a witness beside the folder.
//!
//! The engine is chosen when the folder is made; the names of the entries show which one it is. This module and the
//! adapters add what the engines lack. Opening checks the content and makes it durable, including the names of files. A
//! panic becomes an error. After an error the engine is closed, and the store has to be reopened.

use super::witness::{self, Life, Trust};
use super::{Store, StoreError, check_file, check_files, damaged, file_error};
use super::{on_redb, on_sled, parent, poisoned, shielded, sync};
use crate::logic::record::Batch;
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The longest name of a record, and the longest record, in bytes: far more than a replica writes.
const NAME_SIZE_MAX: usize = 32 << 10;
const RECORD_SIZE_MAX: usize = 64 << 20;
/// How many damaged stores are put aside before a person has to look at them.
const ASIDE_MAX: u32 = 100;

/// The engine that keeps the records of a store on the disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// redb 4: one file of pages; a changed page is copied.
    #[default]
    Redb,
    /// sled 0.34: a log of changes.
    Sled,
}

/// The operations of an engine's adapter.
pub(super) trait Records: fmt::Debug + Send {
    /// As [`Store::each`].
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError>;

    /// Writes a batch like [`Store::commit`], and with it the present life, if that is new.
    fn write(&mut self, life: Option<Life>, batch: &Batch) -> Result<(), StoreError>;

    /// Closes the engine in order, if possible.
    fn close(self: Box<Self>);
}

/// An opened engine, and the life that the store has recorded; none in a new store.
pub(super) type Opened = (Box<dyn Records>, Option<Life>);

/// A store in a directory, and its witness next to it.
#[derive(Debug)]
pub struct DirStore {
    path: PathBuf,
    engine: Engine,
    /// The engine; none after an error.
    records: Option<Box<dyn Records>>,
    trust: Trust,
    /// The present life, until it is written to the witness.
    unattested: Option<Life>,
}

impl Engine {
    /// Both engines.
    pub const ALL: [Self; 2] = [Self::Redb, Self::Sled];

    /// Returns the name by which users choose the engine.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Redb => "redb",
            Self::Sled => "sled",
        }
    }

    /// Returns the name of the engine's file or folder in the folder of a store.
    const fn place(self) -> &'static str {
        match self {
            Self::Redb => on_redb::DATA,
            Self::Sled => on_sled::FOLDER,
        }
    }

    /// Returns the file with the records of the store in `path`.
    pub fn data(self, path: &Path) -> PathBuf {
        match self {
            Self::Redb => path.join(on_redb::DATA),
            Self::Sled => path.join(on_sled::FOLDER).join(on_sled::DATA),
        }
    }

    /// Returns the engine of the store in a folder; `None` if the store does not exist yet.
    pub fn of(path: &Path) -> Option<Self> {
        Self::ALL.into_iter().find(|engine| path.join(engine.place()).exists())
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Engine {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let named = Self::ALL.into_iter().find(|engine| engine.name() == text);
        named.ok_or_else(|| "an engine is `redb` or `sled`".to_owned())
    }
}

impl DirStore {
    /// Opens the store in this directory, or makes one with the default engine. Everything in it is durable when this
    /// returns.
    ///
    /// # Errors
    /// If the directory cannot be used, is already open, or is damaged.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        Self::open_on(None, path)
    }

    /// Opens the store like [`DirStore::open`]; a new store is made with `engine`.
    ///
    /// # Errors
    /// The errors of [`DirStore::open`], and if the store has another engine.
    pub fn open_on(engine: Option<Engine>, path: &Path) -> Result<Self, StoreError> {
        let file_error = |cause| file_error(path, cause);
        fs::create_dir_all(path).map_err(file_error)?;
        let found = Engine::of(path);
        if let (Some(found), Some(wanted)) = (found, engine)
            && found != wanted
        {
            return Err(StoreError::Engine { path: path.to_owned(), found, wanted });
        }
        let engine = found.or(engine).unwrap_or_default();
        let data = engine.data(path);
        check_files(path)?;
        check_file(&data)?;
        witness::check(path)?;
        let was_there = data.try_exists().map_err(file_error)?;
        let (records, known) = shielded(path, || match engine {
            Engine::Redb => on_redb::open(path),
            Engine::Sled => on_sled::open(path),
        })?;
        let mut store =
            Self { path: path.to_owned(), engine, records: Some(records), trust: Trust::New, unattested: None };
        sync_all(path)?;
        sync(parent(path))?;
        let life = match known {
            Some(life) => life,
            None if was_there && witness::exists(path) => {
                return Err(damaged(path, "it is empty, but it was not empty before"));
            }
            None => {
                let life = Life::new().map_err(file_error)?;
                store.apply(Some(life), &Batch::default())?;
                life
            }
        };
        store.trust =
            witness::ask(path, life, &data).map_err(|cause| super::file_error(&witness::path(path), cause))?;
        store.unattested = Some(Life { boots: life.boots.saturating_add(1), ..life });
        Ok(store)
    }

    /// Returns the engine of the store.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Returns whether the replica in the store may continue under its present origin.
    pub fn trust(&self) -> Trust {
        self.trust
    }

    /// Puts a damaged store aside by renaming it; returns the new name, beside the old one. Nothing is deleted.
    ///
    /// # Errors
    /// If the store cannot be renamed.
    pub fn put_aside(path: &Path) -> Result<PathBuf, StoreError> {
        let name = |number| path.with_extension(format!("aside-{number}"));
        let free = (1..=ASIDE_MAX).map(name).find(|aside| !aside.exists());
        let full = || io::Error::other("too many damaged stores are in the same folder; check and remove these stores");
        let aside = free.ok_or_else(|| file_error(path, full()))?;
        fs::rename(path, &aside).map_err(|cause| file_error(path, cause))?;
        sync(parent(path))?;
        Ok(aside)
    }

    /// Makes changes durable. After an error it closes the engine.
    fn apply(&mut self, life: Option<Life>, batch: &Batch) -> Result<(), StoreError> {
        let mut records = self.records.take().ok_or_else(|| poisoned(&self.path))?;
        let done = shielded(&self.path, || {
            check_sizes(batch)?;
            records.write(life, batch)
        });
        match done {
            Ok(()) => self.records = Some(records),
            Err(_) => records.close(),
        }
        done
    }

    /// Writes this life to the witness, if the witness does not have it yet. Before that, the replica has written its
    /// reaction to a doubt to the disk, so the reason for the doubt is not lost.
    fn attest(&mut self) -> Result<(), StoreError> {
        if let Some(life) = self.unattested {
            let attested = witness::attest(&self.path, life, &self.engine.data(&self.path));
            attested.map_err(|cause| file_error(&witness::path(&self.path), cause))?;
            self.unattested = None;
        }
        Ok(())
    }
}

impl Store for DirStore {
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError> {
        let records = self.records.as_ref().ok_or_else(|| poisoned(&self.path))?;
        shielded(&self.path, || records.each(take))
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.apply(self.unattested, batch)?;
        let attested = self.attest();
        if attested.is_err()
            && let Some(records) = self.records.take()
        {
            records.close();
        }
        attested
    }
}

impl Drop for DirStore {
    fn drop(&mut self) {
        if let Some(records) = self.records.take() {
            records.close();
        }
    }
}

/// Makes every file below a directory durable, and also the directories themselves.
fn sync_all(path: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(path).map_err(|cause| file_error(path, cause))? {
        let entry = entry.map_err(|cause| file_error(path, cause))?;
        let kind = entry.file_type().map_err(|cause| file_error(path, cause))?;
        if kind.is_dir() {
            sync_all(&entry.path())?;
        } else if kind.is_file() {
            sync(&entry.path())?;
        }
    }
    sync(path)
}

fn check_sizes(batch: &Batch) -> Result<(), StoreError> {
    let long = |(name, record): (&Vec<u8>, &Option<Vec<u8>>)| {
        let size = record.as_ref().map_or(0, Vec::len);
        (name.len() > NAME_SIZE_MAX || size > RECORD_SIZE_MAX).then_some(StoreError::Long { size: name.len() + size })
    };
    batch.0.iter().find_map(long).map_or(Ok(()), Err)
}
