//! A store without a disk: for a database that need not outlive its program, and for tests.

use crate::io::store::{Store, StoreError};
use crate::logic::record::{Batch, Records};

/// Records in memory.
#[derive(Clone, Debug, Default)]
pub struct MemoryStore {
    records: Records,
}

impl MemoryStore {
    /// Returns a store with these records.
    pub fn new(records: Records) -> Self {
        Self { records }
    }
}

impl Store for MemoryStore {
    fn load(&self) -> Result<Records, StoreError> {
        Ok(self.records.clone())
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        batch.apply(&mut self.records);
        Ok(())
    }
}
