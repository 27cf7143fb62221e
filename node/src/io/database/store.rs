//! Where a node's database lies: a folder, or only memory.

use super::Options;
use anyhow::Context;
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::io::store::{DirStore, Store, StoreError, Trust};
use dbmanager::logic::mutant::Mutant;
use dbmanager::logic::record::{Batch, OpenError, Reading};
use dbmanager::logic::replica::{Config, Replica};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// How many bytes of transactions are kept although everybody has them, so that they can be looked at.
const LOG_SIZE: usize = 64 << 20;

/// A store, and what it takes to open it again.
pub(super) struct Place {
    robot: String,
    folder: Option<PathBuf>,
    store: Option<Box<dyn Store + Send>>,
}

impl Place {
    /// Opens the store; returns the replica that is in it. One that is damaged is put aside, and a new one begins, which
    /// gets everything that others have.
    pub(super) fn open(options: &Options) -> anyhow::Result<(Self, Replica)> {
        let folder = options.folder.as_ref().map(|folder| folder.join("db"));
        let mut place = Self { robot: options.robot.clone(), folder, store: None };
        let replica = place.reopen()?;
        Ok((place, replica))
    }

    /// Returns the folder, for a person; nothing for a store in memory.
    pub(super) fn name(&self) -> Option<String> {
        self.folder.as_ref().map(|folder| folder.display().to_string())
    }

    /// Writes a batch; it is durable when this returns.
    pub(super) fn commit(&mut self, batch: &Batch) -> anyhow::Result<()> {
        self.store.as_mut().context("the store is not open")?.commit(batch)?;
        Ok(())
    }

    /// Opens the store again, after letting go of it.
    pub(super) fn reopen(&mut self) -> anyhow::Result<Replica> {
        self.store = None;
        let Some(folder) = self.folder.clone() else {
            self.store = Some(Box::new(MemoryStore::default()));
            return Ok(Replica::open(self.config()?, Reading::default())?);
        };
        match self.open_folder(&folder) {
            Ok(replica) => Ok(replica),
            Err(error) if is_damage(&error) => {
                let aside = DirStore::put_aside(&folder)?;
                tracing::error!(
                    store = %folder.display(), aside = %aside.display(), error = format!("{error:#}"),
                    "the store is damaged and was put aside; what other robots have comes back from them"
                );
                self.open_folder(&folder)
            }
            Err(error) => Err(error),
        }
    }

    fn open_folder(&mut self, folder: &Path) -> anyhow::Result<Replica> {
        let store =
            DirStore::open(folder).context("the database cannot be opened (`--state` chooses another folder)")?;
        let (config, stored) = (self.config()?, store.read()?);
        let replica = match store.trust() {
            Trust::New | Trust::Kept => Replica::open(config, stored)?,
            Trust::Doubtful(doubt) => {
                tracing::warn!(%doubt, "the store may be a copy: the database goes on under a new origin");
                Replica::open_copied(config, stored)?
            }
        };
        self.store = Some(Box::new(store));
        Ok(replica)
    }

    fn config(&self) -> anyhow::Result<Config> {
        let mut seed = [0; 8];
        let read = File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut seed));
        read.context("reading a random number from the system")?;
        let seed = u64::from_le_bytes(seed);
        Ok(Config { robot: self.robot.clone(), seed, log_size: LOG_SIZE, mutant: Mutant::None })
    }
}

/// Returns whether a store does not open because of what is in it. Another robot's store is none of ours to move.
fn is_damage(error: &anyhow::Error) -> bool {
    error.downcast_ref().is_some_and(StoreError::is_damage)
        || matches!(error.downcast_ref(), Some(OpenError::Record { .. } | OpenError::Damaged { .. }))
}
