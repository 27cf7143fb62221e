//! A node as a member of its team.
//!
//! ```text
//! STATE/r1/team/          0700, beside the node's database; files 0600
//!   keys                  the node's secret keys, made here; they never leave it
//!   team                  the team's name and public keys
//!   credential            what shows that the node belongs to it; written last: without it the node is in no team
//!   revoked               whom the team has revoked, as far as this node has heard: all sets that it holds, unless the disk refused
//!   audit                 who was refused, and what was revoked
//!   founds                the node is the first of its team and has not begun the team's database yet
//!   heads                 where audit logs of others have come to, signed by this node, and its own, signed by others
//! STATE/r1/in-team        the name of the team in which the node ran last: without the folder above it does not start
//! ```

mod heads;
mod renewal;
mod revoked;
mod trail;

use crate::audit::{Audit, AuditEntry};
use crate::cards::Cards;
use crate::folder;
use anyhow::{Context as _, bail, ensure};
use comms::io::session::{Authenticator, Author, Digest, Identity, PublicKey};
use comms::logic::proof::Proof;
use heads::HeadsFile;
use renewal::Vouched;
use revoked::RevokedFile;
pub(crate) use revoked::{REVOKED_BYTES_MAX, revocations};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use tokio::sync::watch;
use trail::AuditTrail;
use trust::audit::{Decision, Head, Position};
use trust::identity::{KeyId, PublicKeys, SECRET_LEN, SIGNATURE_LEN, SecretKeys};
use trust::name::Name;
use trust::revocation::{RevocationError, Revocations, RevokedSet};
use trust::role::Kind;
use trust::seal::{Place, SealError, Sealed, Secret};
use trust::statement;
use trust::team::{CREDENTIAL_MAX, Credential, Judge, OFFLINE_GRACE, TEAM_MAX, Team};
use zeroize::Zeroizing;

/// The folder below the node's state.
pub const FOLDER: &str = "team";
const KEYS: &str = "keys";
const TEAM: &str = "team";
const CREDENTIAL: &str = "credential";
const REVOKED: &str = "revoked";
const FOUNDS: &str = "founds";
/// The file beside the folder that contains the name of the team.
const IN_TEAM: &str = "in-team";
/// The name of the file with signed heads of audit logs.
pub const HEADS: &str = "heads";
/// The most bytes that [`Member::begin`] writes, with a reserve for the file system.
pub const BEGIN_SIZE_MAX: usize = SECRET_LEN + TEAM_MAX + CREDENTIAL_MAX + (32 << 10);

/// A node in a team.
#[derive(Debug)]
pub struct Member {
    folder: PathBuf,
    keys: SecretKeys,
    team: Team,
    /// The credential at the start of this node.
    credential: Credential,
    /// The credential with the newest renewal.
    newest: Mutex<Credential>,
    /// The credentials for the node's programs and visitors, and the files from which these read them.
    vouched: Mutex<Option<Vouched>>,
    /// The file that programs of another user read, and the group of that user.
    shared: Mutex<Option<(PathBuf, u32)>>,
    revoked: RevokedFile,
    /// Changes with the revocations.
    changes: watch::Sender<()>,
    /// The credentials that other nodes have shown.
    cards: Cards,
    trail: AuditTrail,
    heads: HeadsFile,
}

impl Member {
    /// Returns the member for a node, read from the node's state folder; none if the node is not in a team.
    ///
    /// # Errors
    /// If a file cannot be read, or is invalid. Such a node must not run as if it were not in a team.
    pub fn open(state: &Path) -> anyhow::Result<Option<Self>> {
        let folder = state.join(FOLDER);
        let Some(credential) = folder::read(&folder.join(CREDENTIAL), CREDENTIAL_MAX)? else {
            // Any entry here shows that the node has been in a team, even a dangling link, for example to a disk that is not
            // mounted.
            ensure!(
                folder.symlink_metadata().is_err(),
                "`{}` is left from a joining that was cut short, or is a link that leads nowhere: join again with `dca team join`, or remove it \
                 to run without a team",
                folder.display()
            );
            refuse_without(state, &folder)?;
            return Ok(None);
        };
        let file = |name: &str, bytes_max| {
            let read = folder::read(&folder.join(name), bytes_max)?;
            read.with_context(|| {
                format!("`{}` is missing: take this node into its team again", folder.join(name).display())
            })
        };
        let broken =
            |name: &str| format!("`{}` is broken: take this node into its team again", folder.join(name).display());
        let keys = file(KEYS, SECRET_LEN)?;
        let keys = <&[u8; SECRET_LEN]>::try_from(&keys[..]).ok().with_context(|| broken(KEYS))?;
        let keys = SecretKeys::from_bytes(keys);
        let team = Team::from_bytes(&file(TEAM, TEAM_MAX)?).with_context(|| broken(TEAM))?;
        let credential = Credential::from_bytes(&credential).with_context(|| broken(CREDENTIAL))?;
        if credential.certificate().claims().keys != *keys.public() || credential.certificate().kind() != Kind::Node {
            bail!("{}", broken(CREDENTIAL));
        }
        note(state, &team);
        let revoked = RevokedFile::open(&folder, &team, keys.public().id())?;
        let audit = Audit::open(&folder, team.id(), keys.public().id());
        let audit =
            audit.inspect_err(|error| tracing::error!(error = format!("{error:#}"), "there is no audit log")).ok();
        let member = Self {
            heads: HeadsFile::open(&folder),
            folder,
            keys,
            team,
            newest: Mutex::new(credential.clone()),
            credential,
            vouched: Mutex::default(),
            shared: Mutex::default(),
            revoked,
            changes: watch::Sender::new(()),
            cards: Cards::default(),
            trail: AuditTrail::new(audit),
        };
        Ok(Some(member))
    }

    /// Returns whether a node is in a team; it only checks whether the credential exists.
    #[must_use]
    pub fn is_there(state: &Path) -> bool {
        state.join(FOLDER).join(CREDENTIAL).exists()
    }

    /// Writes the new identity of a node. If `founds`, the node is the first of its team, and begins the team's database when it
    /// starts.
    ///
    /// # Errors
    /// If the disk refuses. The node keeps its previous identity then.
    pub fn begin(
        state: &Path,
        keys: &SecretKeys,
        team: &Team,
        founds: bool,
        credential: &Credential,
    ) -> anyhow::Result<()> {
        let folder = state.join(FOLDER);
        folder::make(&folder)?;
        if founds {
            folder::write(&folder.join(FOUNDS), &[])?;
        } else {
            // This file belongs to an earlier team.
            drop(std::fs::remove_file(folder.join(FOUNDS)));
        }
        if !folder.join(REVOKED).is_file() {
            folder::write(&folder.join(REVOKED), &revoked::form(&Revocations::default()))?;
        }
        folder::write(&folder.join(KEYS), &*keys.to_bytes())?;
        folder::write(&folder.join(TEAM), &team.to_bytes())?;
        folder::write(&folder.join(CREDENTIAL), &credential.to_bytes())
    }

    /// Returns whether this node has to create the team's database.
    #[must_use]
    pub fn founds(&self) -> bool {
        self.folder.join(FOUNDS).is_file()
    }

    /// Removes the mark that this member has to create the team's database.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn has_founded(&self) -> std::io::Result<()> {
        std::fs::remove_file(self.folder.join(FOUNDS))
    }

    /// Returns the team.
    #[must_use]
    pub const fn team(&self) -> &Team {
        &self.team
    }

    /// Returns the name in the node's certificate.
    #[must_use]
    pub const fn name(&self) -> &Name {
        &self.credential.certificate().claims().name
    }

    /// Returns the id of the node's keys.
    pub fn id(&self) -> KeyId {
        self.keys.public().id()
    }

    /// Returns the folder with the node's keys.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Calls `judge` with the team, its revocations and the time.
    pub fn with_judge<T>(&self, judge: impl FnOnce(&Judge<'_>) -> T) -> T {
        let revoked = self.revoked.sets().clone();
        judge(&self.by(&revoked))
    }

    /// Checks that this node itself is trusted now.
    ///
    /// # Errors
    /// The reason, if it is not trusted.
    pub fn check(&self) -> anyhow::Result<()> {
        let revoked = self.revoked.sets();
        self.newest().check(&self.by(&revoked)).map(drop).context("this node is not trusted")
    }

    /// Signs a digest of data that this node writes.
    pub fn state(&self, digest: &Digest) -> [u8; SIGNATURE_LEN] {
        statement::sign(digest, &self.keys)
    }

    /// Returns the bytes of the node's credential.
    pub fn shown(&self) -> Vec<u8> {
        self.newest().to_bytes()
    }

    /// Returns the name and keys of the node of the team that has a credential. The credential may be of any age, and may have been
    /// revoked since: the node's earlier transactions remain valid.
    ///
    /// # Errors
    /// If the credential does not belong to a node of the team; the reason is for people.
    pub fn node_of(&self, credential: &[u8]) -> Result<(String, PublicKeys), String> {
        let credential = Credential::from_bytes(credential).map_err(|error| format!("a credential: {error}"))?;
        let claims = credential.certificate().claims();
        if credential.certificate().kind() != Kind::Node {
            return Err(format!("`{}` is not a node", claims.name));
        }
        let nobody = Revocations::default();
        let then = Judge { team: &self.team, revoked: &nobody, now: claims.not_before, grace: 0 };
        credential.check(&then).map_err(|error| error.to_string())?;
        Ok((claims.name.to_string(), claims.keys))
    }

    /// Opens a secret of the team's database that is sealed for this node.
    ///
    /// # Errors
    /// If the secret is not sealed for this node, or not for this key.
    pub fn unseal(&self, key: &str, sealed: &Sealed) -> Result<Secret, SealError> {
        sealed.open(&Place { team: self.team.id(), path: key }, &self.keys)
    }

    /// Writes a record to the audit log.
    pub fn record(&self, entry: AuditEntry) {
        self.trail.record(entry);
    }

    /// Notes that a message was refused: the action that it requested, and the reason. Returns whether the refusal
    /// should be recorded. Only one line per minute is recorded for each reason, and only a few reasons, so that
    /// repeated attempts do not fill the disk.
    pub fn refuse_message(&self, what: &str, why: &str) -> bool {
        self.trail.refuse_message(what, why)
    }

    /// Returns a receiver of the position of this node's audit log; none without a log.
    pub fn audit_position(&self) -> Option<watch::Receiver<Option<Position>>> {
        self.trail.position()
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
        self.heads.change(|heads| Ok(heads.countersign(head, of, crate::now(), self.name(), &self.keys)?))
    }

    /// Stores another node's signature on this node's audit log. Blocks.
    ///
    /// # Errors
    /// If the head belongs to another log, the table is full, or the disk refuses.
    pub fn keep_head(&self, head: Head, name: &Name) -> anyhow::Result<()> {
        ensure!(head.position().log == self.id() && head.by() != self.id(), "the head belongs to another log");
        self.heads.change(|heads| Ok(((), heads.keep(head, name)?)))
    }

    /// Adds a set of revocations by the team or an admin. Returns whether it was new.
    ///
    /// # Errors
    /// If the set is not validly signed, or does not fit; then nothing has changed. Or if the disk
    /// refuses; then the set applies until the node ends.
    pub fn revoke(&self, set: RevokedSet) -> anyhow::Result<bool> {
        let what = format!("{}{}, keys {}", revoked::REVOKE, set.number(), set.keys().len());
        let Some(written) = self.revoked.add(set, &self.team)? else { return Ok(false) };
        self.cards.judge_again();
        if let Err(error) = self.share_again() {
            tracing::error!(
                error = format!("{error:#}"),
                "cannot tell programs of another user which keys are revoked"
            );
        }
        self.record(AuditEntry { decision: Decision::Done, who: "the team".to_owned(), what, reason: String::new() });
        self.changes.send_replace(());
        written.map(|()| true)
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
        Ok(self.revoked.keep()?.sets().iter().map(RevokedSet::to_bytes).collect())
    }

    /// Returns a receiver that changes with the revocations.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    fn by<'a>(&'a self, revoked: &'a Revocations) -> Judge<'a> {
        judge(&self.team, revoked)
    }
}

/// Returns a judge for a team, with the grace period for nodes that were offline.
pub(crate) fn judge<'a>(team: &'a Team, revoked: &'a Revocations) -> Judge<'a> {
    Judge { team, revoked, now: crate::now(), grace: OFFLINE_GRACE }
}

impl Identity for Member {
    fn key(&self) -> (Zeroizing<[u8; 32]>, PublicKey) {
        (self.keys.signing(), *self.keys.public().signing())
    }

    fn credential(&self) -> Vec<u8> {
        self.newest().to_bytes()
    }

    fn judge(&self, key: &PublicKey, credential: &[u8]) -> Result<String, String> {
        let credential = Credential::from_bytes(credential).map_err(|error| format!("its credential: {error}"))?;
        let claims = credential.certificate().claims();
        if claims.keys.signing() != key {
            return Err("its credential belongs to another key".to_owned());
        }
        // A copy: a reader of the cards also takes the lock of the revocations, so the two locks must not be held together.
        let revoked = self.revoked.sets().clone();
        let by = self.by(&revoked);
        // The certificate may have been renewed since the node showed it here.
        let newer = self.cards.newer(&credential, &by);
        newer.as_ref().unwrap_or(&credential).check(&by).map_err(|error| self.trail.judged(&error))?;
        if credential.certificate().kind() != Kind::Node {
            return Err(format!("`{}` is not a node", claims.name));
        }
        if newer.is_none() {
            self.cards.note(&credential);
        }
        Ok(claims.name.to_string())
    }

    fn revocations(&self) -> Vec<u8> {
        revoked::form(&self.revoked.sets())
    }

    fn hear(&self, revocations: &[u8]) -> bool {
        let sets = revoked::from_form(revocations).unwrap_or_else(|error| {
            tracing::warn!(error = format!("{error:#}"), "revocations of a node cannot be read");
            Vec::new()
        });
        let before = self.revoked.sets().clone();
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
        if let Err(error) = self.revoked.keep() {
            tracing::error!(error = format!("{error:#}"), "revocations are not on the disk");
        }
        self.revoked.sets().sets() != before.sets()
    }

    fn refused(&self, from: SocketAddr, why: &str) {
        self.trail.refuse_link(from, why);
    }
}

impl Authenticator for Member {
    fn sign(&self, digest: &Digest, shows: bool) -> Option<Proof> {
        let signature = statement::sign(digest, &self.keys).to_vec();
        let credential = shows.then(|| self.newest().to_bytes());
        Some(Proof { key: *self.keys.public().signing(), signature, credential })
    }

    fn check(&self, proof: &Proof, digest: &Digest) -> Author {
        self.cards.check(self.credential.certificate(), proof, digest, |credential| {
            let revoked = self.revoked.sets();
            credential.check(&self.by(&revoked)).map(drop).map_err(|error| error.to_string())
        })
    }

    fn forged(&self, claimed: &str, why: &str) {
        self.trail.refuse_message(&format!("speak as `{claimed}`"), why);
    }
}

/// Refuses to run a node without a team if it last ran in one. Its folder may have been moved away, or its disk is not mounted.
fn refuse_without(state: &Path, folder: &Path) -> anyhow::Result<()> {
    let noted = state.join(IN_TEAM);
    let Some(team) = folder::read(&noted, TEAM_MAX)? else { return Ok(()) };
    bail!(
        "the last team of this node was `{}`, but `{}` is missing: put the folder back, join again with `dca team join`, or \
         remove `{}` to run without a team",
        String::from_utf8_lossy(&team),
        folder.display(),
        noted.display()
    );
}

/// Notes the team in which a node runs, for its next start.
fn note(state: &Path, team: &Team) {
    let (noted, name) = (state.join(IN_TEAM), team.name().to_string());
    if folder::read(&noted, TEAM_MAX).is_ok_and(|before| before.is_some_and(|before| before[..] == *name.as_bytes())) {
        return;
    }
    if let Err(error) = folder::write(&noted, name.as_bytes()) {
        tracing::warn!(
            error = format!("{error:#}"),
            "the next start of this node cannot notice a missing folder of its team"
        );
    }
}

#[cfg(test)]
mod tests;
