//! The signed heads of audit logs that a node stores: heads of others, signed by this node, and its own, signed by others.

use super::{HEADS, Member};
use crate::audit::Audit;
use crate::folder;
use anyhow::ensure;
use std::path::Path;
use std::sync::PoisonError;
use tokio::sync::watch;
use trust::audit::{Head, Position};
use trust::heads::{Heads, TEXT_MAX};
use trust::name::Name;

/// Returns the stored signed heads of audit logs. If they are lost, no harm is done: the other nodes have them as well.
pub(super) fn open(folder: &Path) -> Heads {
    let path = folder.join(HEADS);
    let read = folder::read(&path, TEXT_MAX).and_then(|bytes| {
        let text = String::from_utf8(bytes.map_or_else(Vec::new, |bytes| bytes.to_vec()))?;
        Ok(Heads::from_text(&text)?)
    });
    read.unwrap_or_else(|error| {
        tracing::error!(
            error = format!("{error:#}"),
            "the signed heads of audit logs cannot be read; new heads are signed"
        );
        Heads::default()
    })
}

impl Member {
    /// Returns a receiver of the position of this node's audit log; none without a log.
    pub fn audit_position(&self) -> Option<watch::Receiver<Option<Position>>> {
        self.audit.as_ref().map(Audit::position)
    }

    /// Signs the position of this node's audit log, for others to countersign.
    pub fn sign_position(&self, position: Position) -> Head {
        Head::sign(position, crate::now(), &self.keys)
    }

    /// Signs the position of another node's audit log, which that node has signed. Blocks.
    ///
    /// # Errors
    /// If the log was cut off or rewritten since this node last signed it, the log belongs to another node, or the disk
    /// refuses.
    pub fn countersign(&self, head: &Head, of: &Name) -> anyhow::Result<Head> {
        ensure!(head.position().log == head.by(), "the head of its log is signed by another node");
        let mut heads = self.heads.lock().unwrap_or_else(PoisonError::into_inner);
        let mut with = heads.clone();
        let (head, is_new) = with.countersign(head, of, crate::now(), self.name(), &self.keys)?;
        if is_new {
            // Written to the disk first, so that a restart cannot lead to a different signature for the same position.
            folder::write(&self.folder.join(HEADS), with.to_text().as_bytes())?;
            *heads = with;
        }
        Ok(head)
    }

    /// Stores another node's signature on this node's audit log. Blocks.
    ///
    /// # Errors
    /// If the head belongs to another log, the table is full, or the disk refuses.
    pub fn keep_head(&self, head: Head, name: &Name) -> anyhow::Result<()> {
        ensure!(head.position().log == self.id() && head.by() != self.id(), "the head belongs to another log");
        let mut heads = self.heads.lock().unwrap_or_else(PoisonError::into_inner);
        let mut with = heads.clone();
        if with.keep(head, name)? {
            folder::write(&self.folder.join(HEADS), with.to_text().as_bytes())?;
            *heads = with;
        }
        Ok(())
    }
}
