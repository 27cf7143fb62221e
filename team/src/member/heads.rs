//! The signed heads of audit logs that a node stores: heads of others, signed by this node, and its own, signed by others.

use super::HEADS;
use crate::folder;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use trust::heads::{Heads, TEXT_MAX};

/// The heads in memory and on the disk, which are the same.
#[derive(Debug)]
pub(super) struct HeadsFile {
    path: PathBuf,
    heads: Mutex<Heads>,
}

impl HeadsFile {
    /// Reads the heads in a folder. If they are lost, no harm is done: the other nodes have them as well.
    pub(super) fn open(folder: &Path) -> Self {
        let path = folder.join(HEADS);
        let read = folder::read(&path, TEXT_MAX).and_then(|bytes| {
            let text = String::from_utf8(bytes.map_or_else(Vec::new, |bytes| bytes.to_vec()))?;
            Ok(Heads::from_text(&text)?)
        });
        let heads = read.unwrap_or_else(|error| {
            tracing::error!(
                error = format!("{error:#}"),
                "the signed heads of audit logs cannot be read; new heads are signed"
            );
            Heads::default()
        });
        Self { path, heads: Mutex::new(heads) }
    }

    /// Changes the heads with `change`, which also returns whether anything is new. The change is on the disk before it
    /// counts, so that a restart cannot lead to a different signature for the same position. Blocks.
    ///
    /// # Errors
    /// If `change` or the disk refuses. The heads are as before then.
    pub(super) fn change<T>(&self, change: impl FnOnce(&mut Heads) -> anyhow::Result<(T, bool)>) -> anyhow::Result<T> {
        let mut heads = self.heads.lock().unwrap_or_else(PoisonError::into_inner);
        let mut with = heads.clone();
        let (result, is_new) = change(&mut with)?;
        if is_new {
            folder::write(&self.path, with.to_text().as_bytes())?;
            *heads = with;
        }
        Ok(result)
    }
}
