//! The same store on sled 0.34.7, as a reference: an engine of another design. It is no part of a robot any more.
//!
//! Its `flush` ends in `sync_file_range`, which never makes the drive empty its cache, so a commit ends in our own
//! `fdatasync`; it never syncs the files that it makes first, so the opening does. Values over some 16 KiB become files
//! that nobody syncs: a store for robots would have to cut them into pieces.

use dbmanager::io::store::{Store, StoreError};
use dbmanager::logic::record::Batch;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// A store in a folder.
#[derive(Debug)]
pub(crate) struct SledStore {
    path: PathBuf,
    engine: sled::Db,
    data: File,
}

impl SledStore {
    pub(crate) fn open(path: &Path) -> Result<Self, StoreError> {
        let told = |cause| told(path, cause);
        let engine = sled::Config::new().path(path).flush_every_ms(None).cache_capacity(16 << 20).open();
        let engine = engine.map_err(|cause| told(cause.into()))?;
        let sync = |path: &Path| File::open(path)?.sync_all();
        for entry in fs::read_dir(path).map_err(told)? {
            sync(&entry.map_err(told)?.path()).map_err(told)?;
        }
        sync(path).map_err(told)?;
        sync(path.parent().unwrap_or(Path::new("."))).map_err(told)?;
        let data = File::open(path.join("db")).map_err(told)?;
        Ok(Self { path: path.to_owned(), engine, data })
    }
}

impl Store for SledStore {
    fn each(&self, take: &mut dyn FnMut(&[u8], &[u8])) -> Result<(), StoreError> {
        for entry in self.engine.iter() {
            let (name, record) = entry.map_err(|cause| told(&self.path, cause.into()))?;
            take(&name, &record);
        }
        Ok(())
    }

    fn commit(&mut self, batch: &Batch) -> Result<(), StoreError> {
        let mut changes = sled::Batch::default();
        for (name, record) in &batch.0 {
            match record {
                Some(record) => changes.insert(&name[..], &record[..]),
                None => changes.remove(&name[..]),
            }
        }
        let flushed = self.engine.apply_batch(changes).and_then(|()| self.engine.flush());
        flushed.map_err(|cause| told(&self.path, cause.into()))?;
        self.data.sync_data().map_err(|cause| told(&self.path, cause))
    }
}

fn told(path: &Path, cause: io::Error) -> StoreError {
    StoreError::File { path: path.to_owned(), cause }
}
