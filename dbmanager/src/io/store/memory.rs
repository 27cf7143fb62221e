//! A store without a disk: for a database that does not have to outlive its program, and for tests.

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
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError> {
        self.records.iter().for_each(|(name, record)| take(name, record));
        Ok(())
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        batch.apply(&mut self.records);
        Ok(())
    }
}
