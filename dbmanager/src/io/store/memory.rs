//! A store without a disk, for tests and simulations; it can be told to fail.

use crate::io::store::{Store, StoreError};
use crate::logic::record::{Batch, Records};
use std::path::PathBuf;

/// Records in memory.
#[derive(Clone, Debug, Default)]
pub struct MemoryStore {
    records: Records,
    commits_left: Option<usize>,
}

impl MemoryStore {
    /// Returns a store with these records.
    pub fn new(records: Records) -> Self {
        Self { records, commits_left: None }
    }

    /// Lets every commit after the next `commits` fail.
    #[must_use]
    pub fn failing_after(mut self, commits: usize) -> Self {
        self.commits_left = Some(commits);
        self
    }
}

impl Store for MemoryStore {
    fn load(&self) -> Result<Records, StoreError> {
        Ok(self.records.clone())
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        if let Some(left) = &mut self.commits_left {
            *left = left.checked_sub(1).ok_or_else(|| StoreError::Poisoned { path: PathBuf::from("memory") })?;
        }
        batch.apply(&mut self.records);
        Ok(())
    }
}
