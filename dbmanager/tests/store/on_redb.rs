//! The same store on redb, as a reference: an engine of another design, that syncs by itself. It is no part of a robot.

use dbmanager::io::store::{Store, StoreError};
use dbmanager::logic::record::{Batch, Records};
use redb::{Database, DatabaseError, ReadableDatabase, ReadableTable, TableDefinition};
use std::io;
use std::path::{Path, PathBuf};

const RECORDS: TableDefinition<'static, &[u8], &[u8]> = TableDefinition::new("records");

/// A store in a file.
#[derive(Debug)]
pub(crate) struct RedbStore {
    path: PathBuf,
    engine: Database,
}

impl RedbStore {
    pub(crate) fn open(path: &Path) -> Result<Self, StoreError> {
        let told = |cause: redb::Error| told(path, cause);
        let engine = Database::create(path).map_err(|cause| {
            let busy = matches!(cause, DatabaseError::DatabaseAlreadyOpen);
            if busy { StoreError::Busy { path: path.to_owned() } } else { told(cause.into()) }
        })?;
        let txn = engine.begin_write().map_err(|cause| told(cause.into()))?;
        drop(txn.open_table(RECORDS).map_err(|cause| told(cause.into()))?);
        txn.commit().map_err(|cause| told(cause.into()))?;
        Ok(Self { path: path.to_owned(), engine })
    }

    fn read(&self) -> Result<Records, redb::Error> {
        let table = self.engine.begin_read()?.open_table(RECORDS)?;
        let entries =
            table.iter()?.map(|entry| entry.map(|(name, record)| (name.value().into(), record.value().into())));
        Ok(entries.collect::<Result<_, _>>()?)
    }

    fn write(&self, batch: &Batch) -> Result<(), redb::Error> {
        let txn = self.engine.begin_write()?;
        let mut table = txn.open_table(RECORDS)?;
        for (name, record) in &batch.0 {
            match record {
                Some(record) => drop(table.insert(&name[..], &record[..])?),
                None => drop(table.remove(&name[..])?),
            }
        }
        drop(table);
        Ok(txn.commit()?)
    }
}

impl Store for RedbStore {
    fn load(&self) -> Result<Records, StoreError> {
        self.read().map_err(|cause| told(&self.path, cause))
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.write(batch).map_err(|cause| told(&self.path, cause))
    }
}

fn told(path: &Path, cause: redb::Error) -> StoreError {
    let path = path.to_owned();
    if let redb::Error::Corrupted(what) = cause {
        return StoreError::Damaged { path, what };
    }
    let cause = if let redb::Error::Io(cause) = cause { cause } else { io::Error::other(cause) };
    StoreError::File { path, cause }
}
