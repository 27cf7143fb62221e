//! The revocations of a team: those that this node receives, stores and passes on. Memory and disk hold the same
//! sets, unless the disk refuses. Then the received sets still apply, and are written at the next message.

use super::{REVOKED, judge};
use crate::audit;
use crate::folder;
use anyhow::{Context as _, anyhow, bail, ensure};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use trust::identity::KeyId;
use trust::revocation::{ADMINS_BYTES_MAX, Received, Revocations, RevokedSet, SET_MAX, SETS_MAX};
use trust::team::Team;

/// The most bytes of revocations that are stored, or received at once.
pub(crate) const REVOKED_BYTES_MAX: usize = 4 << 20;
// The stored sets always fit, including the length of each set, so they can be read again.
const _: () = assert!(SETS_MAX * SET_MAX + ADMINS_BYTES_MAX + (128 << 10) <= REVOKED_BYTES_MAX);

/// The beginning of an audit record about a revocation.
pub(super) const REVOKE: &str = "revoke: number ";

/// The revocations in memory, and the file that holds them.
#[derive(Debug)]
pub(super) struct RevokedFile {
    path: PathBuf,
    sets: Mutex<Revocations>,
}

impl RevokedFile {
    /// Reads the stored revocations of the team.
    ///
    /// # Errors
    /// If the file cannot be read, is invalid, or is missing although this node has received revocations. Without the
    /// file the node would trust revoked members.
    pub(super) fn open(folder: &Path, team: &Team, node: KeyId) -> anyhow::Result<Self> {
        let path = folder.join(REVOKED);
        let help = "copy this file from another node of the team (its lines are signed), or take this node into its team \
                    again";
        let sets = if let Some(sets) = folder::read(&path, REVOKED_BYTES_MAX)? {
            revocations(&sets, team).with_context(|| format!("`{}` is broken: {help}", path.display()))?
        } else {
            ensure!(path.symlink_metadata().is_err(), "`{}` is a link that leads nowhere: {help}", path.display());
            ensure!(
                !audit::mentions(folder, node, REVOKE),
                "`{}` is missing, but the audit log says that this node has received revocations: {help}",
                path.display()
            );
            Revocations::default()
        };
        Ok(Self { path, sets: Mutex::new(sets) })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the revocations.
    pub(super) fn sets(&self) -> MutexGuard<'_, Revocations> {
        // A set is added as a whole, so the sets are valid even after a panic.
        self.sets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a set. None if it is known; else whether the disk has taken it. The set applies even if the disk has not.
    ///
    /// # Errors
    /// If the set is not validly signed, or does not fit. Then nothing has changed.
    pub(super) fn add(&self, set: RevokedSet, team: &Team) -> anyhow::Result<Option<anyhow::Result<()>>> {
        let mut sets = self.sets();
        let mut with = sets.clone();
        if with.receive(set, &judge(team, &sets))? == Received::Known {
            return Ok(None);
        }
        let written = folder::write(&self.path, &form(&with));
        *sets = with;
        Ok(Some(written))
    }

    /// Writes the sets to the disk, if the file differs from them. Returns the sets.
    ///
    /// # Errors
    /// If the disk refuses.
    pub(super) fn keep(&self) -> anyhow::Result<Revocations> {
        let sets = self.sets();
        let bytes = form(&sets);
        // The file may have been replaced by an older one, or the disk may have refused a write.
        let kept = folder::read(&self.path, REVOKED_BYTES_MAX);
        let is_kept = kept.is_ok_and(|kept| kept.is_some_and(|kept| *kept == bytes));
        if !is_kept && !sets.sets().is_empty() {
            folder::write(&self.path, &bytes)?;
        }
        Ok(sets.clone())
    }
}

/// Returns the bytes in which sets of revocations are stored and sent.
pub(super) fn form(revoked: &Revocations) -> Vec<u8> {
    let sets: Vec<Vec<u8>> = revoked.sets().iter().map(RevokedSet::to_bytes).collect();
    postcard::to_stdvec(&sets).unwrap_or_default()
}

/// Reads sets of revocations from these bytes.
pub(super) fn from_form(bytes: &[u8]) -> anyhow::Result<Vec<RevokedSet>> {
    if bytes.len() > REVOKED_BYTES_MAX {
        bail!("there are too many revocations");
    }
    let sets: Vec<Vec<u8>> =
        postcard::from_bytes(bytes).map_err(|_form| anyhow!("it was cut off, or is not a list of revocations"))?;
    let read = |set: Vec<u8>| {
        if set.len() > SET_MAX {
            bail!("a set of revocations is too long");
        }
        Ok(RevokedSet::from_bytes(&set)?)
    };
    sets.into_iter().map(read).collect()
}

/// Returns the stored revocations of a team.
pub(crate) fn revocations(bytes: &[u8], team: &Team) -> anyhow::Result<Revocations> {
    let mut revoked = Revocations::default();
    for set in from_form(bytes)? {
        // Sets of an earlier team of this node are ignored.
        if let Err(error) = revoked.restore(set, team) {
            tracing::warn!(%error, "a stored set of revocations is ignored");
        }
    }
    Ok(revoked)
}
