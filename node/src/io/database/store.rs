//! Where a node's database is stored: in a folder, or only in memory.
//!
//! If the folder of a store is gone, the store takes no writes. While the node runs, no empty store replaces it: the
//! acknowledged data is only in memory, and a new store would hide this. A store on a read-only disk is read from a
//! copy, so that the node can start and answer reads.

use super::Options;
use super::presence::Presence;
use anyhow::{Context, bail};
use comms::io::entropy;
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::io::store::{DirStore, Engine, Store, StoreError, Trust};
use dbmanager::logic::record::{Batch, OpenError, StoredRecords};
use dbmanager::logic::replica::{Config, Replica};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// How many bytes of transactions are kept for the history, although every member already has them.
const LOG_SIZE: usize = 64 << 20;

/// A store, and the options to open it again.
pub(super) struct Place {
    robot: String,
    folder: Option<PathBuf>,
    /// The engine of a new store.
    engine: Option<Engine>,
    store: Option<Box<dyn Store + Send>>,
    /// The identity of the files when the store was last opened.
    presence: Option<Presence>,
}

/// The place of a store, its replica, and a reason if the store takes no writes.
pub(super) type Opened = (Place, Replica, Option<String>);

impl Place {
    /// Opens the store, and returns its replica. A damaged store is put aside and replaced by a new one, which gets the
    /// data of the other robots. If the disk takes no writes, the store is only read.
    pub(super) fn open(options: &Options) -> anyhow::Result<Opened> {
        let folder = options.folder.as_ref().map(|folder| folder.join("db"));
        let engine = options.store.or_else(|| folder.as_deref().and_then(Engine::of));
        let mut place = Self { robot: options.robot.clone(), folder, engine, store: None, presence: None };
        match (place.reopen(), place.folder.clone()) {
            (Ok(replica), _) => Ok((place, replica, None)),
            (Err(error), Some(folder)) if is_unwritable(&error) => {
                let replica = place.read_only(&folder, &options.scratch);
                let replica = replica.with_context(|| super::words(&error))?;
                Ok((place, replica, Some(super::words(&error))))
            }
            (Err(error), _) => Err(error),
        }
    }

    /// Returns the folder and its engine, for a person; nothing for a store in memory.
    pub(super) fn name(&self) -> Option<String> {
        let engine = self.engine.unwrap_or_default();
        self.folder.as_ref().map(|folder| format!("{} ({engine})", folder.display()))
    }

    /// Writes a batch, which is durable when this returns.
    pub(super) fn commit(&mut self, batch: &Batch) -> anyhow::Result<()> {
        self.store.as_mut().context("the store is not open")?.commit(batch)?;
        // If the folder is gone, the engine writes to files that no later start can find.
        self.check()
    }

    /// Checks whether the store is still where it was opened.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        if self.presence.as_ref().is_none_or(Presence::holds) { Ok(()) } else { self.gone() }
    }

    fn gone(&self) -> anyhow::Result<()> {
        let folder = self.folder.as_deref().unwrap_or(Path::new("")).display();
        bail!(
            "the folder of the store, {folder}, was deleted or moved while the node was running, so its data is only in \
             memory; move the folder back, or save the output of `dca db export` and start the node again"
        )
    }

    /// Closes the store, and opens it again.
    pub(super) fn reopen(&mut self) -> anyhow::Result<Replica> {
        self.store = None;
        if self.presence.as_ref().is_some_and(|presence| !presence.is_replaced()) {
            self.gone()?;
        }
        let Some(folder) = self.folder.clone() else {
            self.store = Some(Box::new(MemoryStore::default()));
            return Ok(Replica::open(self.config()?, StoredRecords::default())?);
        };
        match self.open_folder(&folder) {
            Ok(replica) => Ok(replica),
            Err(error) if is_damage(&error) => {
                let aside = DirStore::put_aside(&folder)?;
                tracing::error!(
                    store = %folder.display(), aside = %aside.display(), error = format!("{error:#}"),
                    "the store is damaged and was put aside; data that other robots have comes back from them"
                );
                self.open_folder(&folder)
            }
            Err(error) => Err(error),
        }
    }

    fn open_folder(&mut self, folder: &Path) -> anyhow::Result<Replica> {
        let store = DirStore::open_on(self.engine, folder)
            .context("the database cannot be opened (`--state` chooses another folder)")?;
        self.engine = Some(store.engine());
        let (config, stored) = (self.config()?, store.read()?);
        let replica = match store.trust() {
            Trust::New | Trust::Kept => Replica::open(config, stored)?,
            Trust::Doubtful(doubt) => {
                tracing::warn!(%doubt, "the store may be a copy: the database continues under a new id");
                Replica::open_copied(config, stored)?
            }
        };
        self.presence = Some(Presence::of(folder).context("looking at the files of the store")?);
        self.store = Some(Box::new(store));
        Ok(replica)
    }

    /// Returns the replica of a store that cannot be opened in its place. Reads a copy of the store; if there is no
    /// store, returns a new replica.
    fn read_only(&self, folder: &Path, scratch: &Path) -> anyhow::Result<Replica> {
        if !folder.exists() {
            return Ok(Replica::open(self.config()?, StoredRecords::default())?);
        }
        let copy = scratch.join("db-copy");
        let read = copy_files(folder, &copy).context("copying the store to read it").and_then(|()| {
            let store = DirStore::open(&copy)?;
            Ok(Replica::open(self.config()?, store.read()?)?)
        });
        // The copy is not needed any more, and does no harm if it cannot be removed.
        drop(fs::remove_dir_all(&copy));
        read
    }

    fn config(&self) -> anyhow::Result<Config> {
        let seed = entropy::number().context("reading a random number from the system")?;
        Ok(Config { robot: self.robot.clone(), seed, log_size: LOG_SIZE })
    }
}

/// Copies a folder.
fn copy_files(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            copy_files(&entry.path(), &to.join(entry.file_name()))?;
        } else if entry.file_type()?.is_file() {
            fs::copy(entry.path(), to.join(entry.file_name()))?;
        }
    }
    Ok(())
}

/// Returns whether a store cannot be opened because its disk takes no writes.
fn is_unwritable(error: &anyhow::Error) -> bool {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    let unwritable =
        |cause: &io::Error| matches!(cause.kind(), FileTooLarge | ReadOnlyFilesystem | StorageFull | QuotaExceeded);
    matches!(error.downcast_ref(), Some(StoreError::File { cause, .. }) if unwritable(cause))
}

/// Returns whether a store cannot be opened because its content is damaged. A store of another robot is not damaged,
/// and must not be moved.
fn is_damage(error: &anyhow::Error) -> bool {
    error.downcast_ref().is_some_and(StoreError::is_damage)
        || matches!(error.downcast_ref(), Some(OpenError::Record { .. } | OpenError::Damaged { .. }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(name: &str) -> (PathBuf, Options) {
        let base = std::env::temp_dir().join(format!("dca-place-{name}-{}", std::process::id()));
        fs::create_dir_all(&base).unwrap();
        let (robot, team, folder, scratch) = ("r1".into(), "dca".into(), Some(base.clone()), base.join("scratch"));
        let proof = String::new();
        (base, Options { robot, team, folder, scratch, store: None, proof, member: None, founds: false })
    }

    #[test]
    fn what_goes_into_a_folder_that_is_gone_is_not_committed() {
        let (base, options) = options("gone");
        let (folder, away) = (base.join("db"), base.join("away"));
        let ways: [(&str, &dyn Fn()); 3] = [
            ("moved", &|| fs::rename(&folder, &away).unwrap()),
            ("deleted", &|| fs::remove_dir_all(&folder).unwrap()),
            ("replaced", &|| {
                fs::remove_dir_all(&folder).unwrap();
                fs::create_dir(&folder).unwrap();
            }),
        ];
        for (way, take_away) in ways {
            let (mut place, ..) = Place::open(&options).unwrap();
            place.commit(&Batch::default()).unwrap();
            place.check().unwrap();
            take_away();
            let refused = place.commit(&Batch::default()).unwrap_err().to_string();
            assert!(refused.contains("deleted or moved"), "{way}: {refused}");
            assert!(place.check().is_err() && place.reopen().is_err(), "{way}: no empty one takes its place");
            if way == "moved" {
                fs::rename(&away, &folder).unwrap();
                place.reopen().unwrap();
                place.commit(&Batch::default()).unwrap();
            }
        }
        fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn a_copy_is_read_and_nothing_stays_of_it() {
        let (base, options) = options("copy");
        let (mut place, ..) = Place::open(&options).unwrap();
        place.commit(&Batch::default()).unwrap();
        for folder in ["db", "nowhere"] {
            place.read_only(&base.join(folder), &options.scratch).unwrap();
            assert!(!options.scratch.join("db-copy").exists());
        }
        drop(place);
        fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn the_manual_states_the_bound_of_the_log() {
        let pages = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/src/database/");
        for page in ["model.md", "using.md"] {
            let text = fs::read_to_string(format!("{pages}{page}")).unwrap();
            assert!(text.contains(&format!("{} MiB", LOG_SIZE >> 20)), "{page}");
        }
    }
}
