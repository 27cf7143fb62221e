//! Certificates that members renew for each other. Other nodes renew the certificate of this node.
//! This node renews the certificates of other nodes, if its role allows this.

use super::{CREDENTIAL, Member};
use crate::audit::AuditEntry;
use crate::folder;
use crate::program::{Circle, ProgramKeys};
use crate::visitor::VisitorIdentity;
use anyhow::{Context as _, ensure};
use std::path::{Path, PathBuf};
use std::sync::{MutexGuard, PoisonError};
use trust::audit::Decision;
use trust::delegation::Delegation;
use trust::identity::SecretKeys;
use trust::name::UnixTime;
use trust::renewal;
use trust::role::{Action, Kind};
use trust::team::Credential;

/// The credentials that this node gives to visitors and programs on its machine.
#[derive(Debug)]
pub(super) struct Vouched {
    /// The keys of visitors.
    keys: SecretKeys,
    /// The file for visitors, and the file for programs.
    files: [PathBuf; 2],
}

impl Member {
    /// Makes an identity for visitors from this machine, and writes it to the file `visitors`. Writes the credentials for the node's
    /// programs to the file `programs`. Both are rewritten when this node's certificate is renewed.
    ///
    /// # Errors
    /// If the disk refuses, or the system has no random bytes.
    pub fn vouch(&self, visitors: &Path, programs: &Path) -> anyhow::Result<()> {
        let files = [visitors.to_owned(), programs.to_owned()];
        let vouched = Vouched { keys: SecretKeys::generate(&mut crate::random()?), files };
        self.write(&vouched)?;
        *self.vouched.lock().unwrap_or_else(PoisonError::into_inner) = Some(vouched);
        Ok(())
    }

    fn write(&self, Vouched { keys, files: [visitors, programs] }: &Vouched) -> anyhow::Result<()> {
        let (newest, revoked) = (self.newest().clone(), self.revoked.path());
        let delegation = Delegation::sign(*keys.public().signing(), "", crate::now(), &self.keys, newest.clone());
        folder::write(programs, &Circle::bytes(&self.team, &newest, revoked)?)?;
        self.share_again()?;
        VisitorIdentity::keep(visitors, keys, &self.team, &delegation, revoked)
    }

    /// Also writes the programs' credentials to this file, and the revocations beside it, for the group of the user that the programs
    /// run as. That user cannot enter the node's folders. Later changes are written to both files as well. Blocks.
    ///
    /// # Errors
    /// If the disk refuses, or this process is not root.
    pub fn share(&self, file: &Path, gid: u32) -> anyhow::Result<()> {
        let shared = Some((file.to_owned(), gid));
        let is_known = *self.shared() == shared && file.is_file();
        *self.shared() = shared;
        if is_known { Ok(()) } else { self.share_again() }
    }

    /// Rewrites the files shared with programs of another user, if there are any.
    pub(super) fn share_again(&self) -> anyhow::Result<()> {
        let Some((file, gid)) = self.shared().clone() else { return Ok(()) };
        let (newest, revoked) = (self.newest().clone(), file.with_file_name(super::REVOKED));
        folder::write_for_group(&revoked, &super::revoked::form(&self.revoked.sets()), gid)?;
        folder::write_for_group(&file, &Circle::bytes(&self.team, &newest, &revoked)?, gid)
    }

    fn shared(&self) -> MutexGuard<'_, Option<(PathBuf, u32)>> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Vouches for a program that this node has started, by the public keys that the program has made. Returns the proof for others;
    /// none if the bytes are not keys.
    pub fn vouch_for(&self, keys: &[u8], program: &str) -> Option<Vec<u8>> {
        let newest = self.newest().clone();
        let key = ProgramKeys::signing_of(keys)?;
        Some(Delegation::sign(key, program, crate::now(), &self.keys, newest).to_bytes())
    }

    /// Returns the node's credential with the newest renewal.
    pub(super) fn newest(&self) -> MutexGuard<'_, Credential> {
        // The credential is replaced as a whole, so it is valid even after a panic.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the time until which this node's certificate is valid, without the grace period, and the time from which
    /// the node asks other nodes for a renewal. The second time is none if it cannot be renewed any more.
    pub fn validity(&self) -> (UnixTime, Option<UnixTime>) {
        let credential = self.newest().clone();
        self.with_judge(|judge| (renewal::end(&credential, judge), renewal::due(&credential, judge)))
    }

    /// Returns whether this node's role permits it to renew certificates of others.
    pub fn may_renew(&self) -> bool {
        self.credential.certificate().claims().role.may(Action::Renew)
    }

    /// Renews the certificate of another node; returns the bytes of that node's credential.
    ///
    /// # Errors
    /// If this node may not renew, or the other node is not trusted, or is valid for long enough.
    pub fn renew(&self, credential: &[u8]) -> anyhow::Result<Vec<u8>> {
        let asker = Credential::from_bytes(credential).context("it shows no credential")?;
        let own = self.newest().clone();
        let renewed = self.with_judge(|judge| renewal::renew(Kind::Node, &asker, &self.keys, &own, judge))?;
        self.note_renewal("a node", &renewed);
        Ok(renewed.to_bytes())
    }

    /// Renews the certificate of a user who has signed the request; returns the bytes of the user's credential.
    ///
    /// # Errors
    /// If this node may not renew, the request is not signed by the user, or the user is not trusted or is valid for long enough.
    pub fn renew_user(&self, ask: &[u8]) -> anyhow::Result<Vec<u8>> {
        ensure!(self.may_renew(), "`{}` may not renew", self.name());
        let asker = renewal::asked(ask, crate::now())?;
        let own = self.newest().clone();
        let renewed = self.with_judge(|judge| renewal::renew(Kind::User, &asker, &self.keys, &own, judge))?;
        self.note_renewal(asker.certificate().claims().name.as_str(), &renewed);
        Ok(renewed.to_bytes())
    }

    /// Stores a renewal that another node has made for this node. Returns whether it is valid for longer now. Blocks.
    ///
    /// # Errors
    /// If the renewal is not valid for longer than the present one, or the disk refuses.
    pub fn take_renewal(&self, offered: &[u8], by: &str) -> anyhow::Result<bool> {
        let offered = Credential::from_bytes(offered).context("it is not a credential")?;
        let own = self.newest().clone();
        if own == offered {
            return Ok(false);
        }
        self.with_judge(|judge| renewal::accept(&own, &offered, judge))?;
        folder::write(&self.folder.join(CREDENTIAL), &offered.to_bytes())?;
        *self.newest() = offered.clone();
        self.note_renewal(by, &offered);
        // The credentials of the node's programs contain the node's credential.
        let vouched = self.vouched.lock().unwrap_or_else(PoisonError::into_inner);
        vouched.as_ref().map_or(Ok(()), |vouched| self.write(vouched))?;
        Ok(true)
    }

    fn note_renewal(&self, by: &str, credential: &Credential) {
        let name = &credential.certificate().claims().name;
        let until = self.with_judge(|judge| renewal::end(credential, judge));
        let what = format!("renew the certificate of `{name}` until {}", until.0);
        let (who, reason) = (by.to_owned(), String::new());
        self.record(AuditEntry { decision: Decision::Done, who, what, reason });
    }

    /// Returns the bytes of the newest known credentials: the node's own credential, and the credentials that other nodes have shown.
    pub fn known_credentials(&self) -> Vec<Vec<u8>> {
        let own = self.newest().to_bytes();
        std::iter::once(own).chain(self.cards.all().iter().map(Credential::to_bytes)).collect()
    }
}
