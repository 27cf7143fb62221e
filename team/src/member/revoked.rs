//! The revocations of a team: those that this node receives, stores and passes on. Memory and disk hold the same
//! sets, unless the disk refuses. Then the received sets still apply, and are written at the next message.

use super::{Member, REVOKED, judge};
use crate::audit::{self, AuditEntry};
use crate::folder;
use anyhow::{Context as _, anyhow, bail, ensure};
use std::path::Path;
use trust::audit::Decision;
use trust::identity::KeyId;
use trust::revocation::{ADMINS_BYTES_MAX, Received, RevocationError, Revocations, RevokedSet, SET_MAX, SETS_MAX};
use trust::team::Team;

/// The most bytes of revocations that are stored, or received at once.
pub(crate) const REVOKED_BYTES_MAX: usize = 4 << 20;
// The stored sets always fit, including the length of each set, so they can be read again.
const _: () = assert!(SETS_MAX * SET_MAX + ADMINS_BYTES_MAX + (128 << 10) <= REVOKED_BYTES_MAX);

/// The beginning of an audit record about a revocation.
const REVOKE: &str = "revoke: number ";

/// Returns the stored revocations of the team.
///
/// # Errors
/// If the file cannot be read, is invalid, or is missing although this node has received revocations. Without the
/// file the node would trust revoked members.
pub(super) fn open(folder: &Path, team: &Team, node: KeyId) -> anyhow::Result<Revocations> {
    let path = folder.join(REVOKED);
    let help =
        "copy this file from another node of the team (its lines are signed), or take this node into its team again";
    if let Some(sets) = folder::read(&path, REVOKED_BYTES_MAX)? {
        return revocations(&sets, team).with_context(|| format!("`{}` is broken: {help}", path.display()));
    }
    ensure!(path.symlink_metadata().is_err(), "`{}` is a link that leads nowhere: {help}", path.display());
    ensure!(
        !audit::mentions(folder, node, REVOKE),
        "`{}` is missing, but the audit log says that this node has received revocations: {help}",
        path.display()
    );
    Ok(Revocations::default())
}

impl Member {
    /// Adds a set of revocations by the team or an admin. Returns whether it was new.
    ///
    /// # Errors
    /// If the set is not validly signed, or does not fit; then nothing has changed. Or if the disk
    /// refuses; then the set applies until the node ends.
    pub fn revoke(&self, set: RevokedSet) -> anyhow::Result<bool> {
        let (number, count) = (set.number(), set.keys().len());
        let mut revoked = self.revoked();
        let mut with = revoked.clone();
        if with.receive(set, &judge(&self.team, &revoked))? == Received::Known {
            return Ok(false);
        }
        let written = folder::write(&self.folder.join(REVOKED), &form(&with));
        *revoked = with;
        drop(revoked);
        self.cards.judge_again();
        if let Err(error) = self.share_again() {
            tracing::error!(
                error = format!("{error:#}"),
                "cannot tell programs of another user which keys are revoked"
            );
        }
        let what = format!("{REVOKE}{number}, keys {count}");
        self.record(AuditEntry { decision: Decision::Done, who: "the team".to_owned(), what, reason: String::new() });
        self.changes.send_replace(());
        written.map(|()| true)
    }

    /// Writes the sets to the disk, if the file differs from them.
    fn keep(&self, revoked: &Revocations) -> anyhow::Result<()> {
        let (path, bytes) = (self.folder.join(REVOKED), form(revoked));
        // The file may have been replaced by an older one, or the disk may have refused a write.
        let is_kept = folder::read(&path, REVOKED_BYTES_MAX).is_ok_and(|kept| kept.is_some_and(|kept| *kept == bytes));
        if is_kept || revoked.sets().is_empty() { Ok(()) } else { folder::write(&path, &bytes) }
    }

    /// Adds these sets; returns all sets that the node holds. They are on the disk when this returns.
    ///
    /// # Errors
    /// The errors of [`Self::revoke()`], for any set; the other sets are still added.
    pub fn tell_revoked(&self, told: &[Vec<u8>]) -> anyhow::Result<Vec<Vec<u8>>> {
        let taken = |set: &Vec<u8>| -> anyhow::Result<bool> { self.revoke(RevokedSet::from_bytes(set)?) };
        // Each set is added, even if others fail.
        let mut all = Ok(());
        for set in told {
            all = all.and(taken(set).map(drop));
        }
        all?;
        let revoked = self.revoked();
        self.keep(&revoked)?;
        Ok(revoked.sets().iter().map(RevokedSet::to_bytes).collect())
    }

    /// Adds the revocations of another node. Returns whether any of them was new.
    pub(super) fn hear_sets(&self, revocations: &[u8]) -> bool {
        let sets = from_form(revocations).unwrap_or_else(|error| {
            tracing::warn!(error = format!("{error:#}"), "revocations of a node cannot be read");
            Vec::new()
        });
        let before = self.revoked().clone();
        for set in sets {
            match self.revoke(set) {
                Ok(_) => {}
                // The signer of this set is revoked here; such a set may be lost.
                Err(error)
                    if matches!(error.downcast_ref(), Some(RevocationError::Signer | RevocationError::Trust(_))) =>
                {
                    tracing::debug!(error = format!("{error:#}"), "cannot accept revocations");
                }
                Err(error) => {
                    tracing::error!(error = format!("{error:#}"), "cannot accept or store revocations");
                }
            }
        }
        let revoked = self.revoked();
        if let Err(error) = self.keep(&revoked) {
            tracing::error!(error = format!("{error:#}"), "revocations are not on the disk");
        }
        revoked.sets() != before.sets()
    }
}

/// Returns the bytes in which sets of revocations are stored and sent.
pub(super) fn form(revoked: &Revocations) -> Vec<u8> {
    let sets: Vec<Vec<u8>> = revoked.sets().iter().map(RevokedSet::to_bytes).collect();
    postcard::to_stdvec(&sets).unwrap_or_default()
}

/// Reads sets of revocations from these bytes.
fn from_form(bytes: &[u8]) -> anyhow::Result<Vec<RevokedSet>> {
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
