//! The signed heads of audit logs that a node keeps: those of others, signed by itself, and its own, signed by others.

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

/// Returns the stored signed heads of audit logs. If they are lost, nothing is mistaken: others have theirs.
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
    /// Publishes the position of this node's audit log; none without a log.
    pub fn audit_position(&self) -> Option<watch::Receiver<Option<Position>>> {
        self.audit.as_ref().map(Audit::position)
    }

    /// Signs the position of this node's audit log, for others to countersign.
    pub fn sign_position(&self, position: Position) -> Head {
        Head::sign(position, crate::now(), &self.keys)
    }

    /// Signs the position of another node's audit log, as signed by that node. Blocks.
    ///
    /// # Errors
    /// The log was cut off or rewritten since this node has signed it last, it is not that node's own, or the disk refuses.
    pub fn countersign(&self, head: &Head, of: &Name) -> anyhow::Result<Head> {
        ensure!(head.position().log == head.by(), "the head of its log is signed by another node");
        let mut heads = self.heads.lock().unwrap_or_else(PoisonError::into_inner);
        let mut with = heads.clone();
        let (head, is_new) = with.countersign(head, of, crate::now(), self.name(), &self.keys)?;
        if is_new {
            // On the disk first, so that a restart cannot lead to a different signature for the same position.
            folder::write(&self.folder.join(HEADS), with.to_text().as_bytes())?;
            *heads = with;
        }
        Ok(head)
    }

    /// Keeps another node's signature on this one's audit log. Blocks.
    ///
    /// # Errors
    /// The head belongs to another log, finds no room, or the disk refuses.
    pub fn keep_head(&self, head: Head, name: &Name) -> anyhow::Result<()> {
        ensure!(head.position().log == self.id() && head.by() != self.id(), "it is the head of another log");
        let mut heads = self.heads.lock().unwrap_or_else(PoisonError::into_inner);
        let mut with = heads.clone();
        if with.keep(head, name)? {
            folder::write(&self.folder.join(HEADS), with.to_text().as_bytes())?;
            *heads = with;
        }
        Ok(())
    }
}
