//! A visitor: a client that watches or calls programs from a machine of the team, such as `dca`. It uses the credentials that the
//! node there gives to all clients on its machine.
//!
//! The node writes this identity to a file in its run folder. The key was made when the node started, and is not the node's own
//! key.

use crate::cards::Cards;
use crate::folder;
use crate::member::judge;
use crate::program::Circle;
use anyhow::Context as _;
use comms::io::session::{Authenticator, Author, Digest, Identity, PublicKey};
use comms::logic::proof::Proof;
use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use trust::delegation::Delegation;
use trust::identity::{SECRET_LEN, SecretKeys};
use trust::statement;
use trust::team::{Credential, Team};
use zeroize::Zeroizing;

/// The longest file.
const FILE_MAX: usize = 16 << 10;

/// The identity of visitors from one machine.
#[derive(Debug)]
pub struct VisitorIdentity {
    /// The file of the identity. It is read again, since the node's certificate may be renewed.
    path: PathBuf,
    keys: SecretKeys,
    circle: Circle,
    delegation: Delegation,
    /// The credentials that nodes have shown.
    cards: Cards,
}

impl VisitorIdentity {
    /// Writes the file for visitors: their keys, the proof that the node vouches for them, and the path of the revocations.
    pub(crate) fn keep(
        path: &Path,
        keys: &SecretKeys,
        team: &Team,
        delegation: &Delegation,
        revoked: &Path,
    ) -> anyhow::Result<()> {
        let secret = keys.to_bytes();
        let revoked = revoked.to_str().context("a folder has a name that is not text")?;
        let fields = (&secret[..], team.to_bytes(), delegation.to_bytes(), revoked);
        folder::write(path, &Zeroizing::new(postcard::to_stdvec(&fields)?))
    }

    /// Reads the file that a node has written for visitors.
    ///
    /// # Errors
    /// If the file is missing or invalid.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let bytes = folder::read(path, FILE_MAX)?.with_context(|| format!("`{}` is missing", path.display()))?;
        let broken = || format!("`{}` is broken", path.display());
        let fields: (Vec<u8>, Vec<u8>, Vec<u8>, String) = postcard::from_bytes(&bytes).with_context(broken)?;
        let secret = Zeroizing::new(fields.0);
        let keys = SecretKeys::from_bytes(<&[u8; SECRET_LEN]>::try_from(&secret[..]).with_context(broken)?);
        let team = Team::from_bytes(&fields.1).with_context(broken)?;
        let delegation = Delegation::from_bytes(&fields.2).with_context(broken)?;
        let circle = Circle::new(team, delegation.node().clone(), fields.3.into());
        Ok(Self { path: path.to_owned(), keys, circle, delegation, cards: Cards::default() })
    }

    /// Signs a visitor's message or call; the signature is valid because the node of this machine vouches for visitors.
    pub fn sign_visit(&self, digest: &Digest) -> Proof {
        let signature = statement::sign(digest, &self.keys).to_vec();
        Proof { key: *self.delegation.key(), signature, credential: Some(self.credential()) }
    }

    /// Returns the names of nodes of which all known keys are revoked. A node with new keys is not such a node. Empty if the
    /// revocations cannot be read.
    pub fn revoked(&self, shown: &[Vec<u8>]) -> BTreeSet<String> {
        let Ok(revoked) = self.circle.revocations_now() else { return BTreeSet::new() };
        let (mut gone, mut there) = (BTreeSet::new(), BTreeSet::new());
        for credential in shown.iter().filter_map(|bytes| Credential::from_bytes(bytes).ok()) {
            let certificate = credential.certificate();
            let name = certificate.claims().name.to_string();
            if credential.check(&judge(&self.circle.team, &revoked)).is_ok() {
                there.insert(name);
            } else if revoked.has(&certificate.subject()) {
                gone.insert(name);
            }
        }
        &gone - &there
    }
}

impl Identity for VisitorIdentity {
    fn key(&self) -> (Zeroizing<[u8; 32]>, PublicKey) {
        (self.keys.signing(), *self.delegation.key())
    }

    fn credential(&self) -> Vec<u8> {
        // If the file cannot be read, the delegation from the visitor's start is valid for a while.
        let newest = Self::open(&self.path).ok().filter(|newest| newest.delegation.key() == self.delegation.key());
        newest.as_ref().unwrap_or(self).delegation.to_bytes()
    }

    fn judge(&self, key: &PublicKey, credential: &[u8]) -> Result<String, String> {
        let delegation = self.circle.delegation(key, credential)?;
        let node = &delegation.node().certificate().claims().name;
        delegation
            .program()
            .map(|program| format!("{program} on {node}"))
            .ok_or_else(|| "it is not a program".to_owned())
    }

    fn revocations(&self) -> Vec<u8> {
        Vec::new()
    }

    fn hear(&self, _: &[u8]) -> bool {
        false
    }

    fn refused(&self, from: SocketAddr, why: &str) {
        tracing::warn!(%from, why, "a peer was refused");
    }
}

/// A command line does not act for a node. It checks the answers of nodes like a program on its machine.
impl Authenticator for VisitorIdentity {
    fn sign(&self, _: &Digest, _: bool) -> Option<Proof> {
        None
    }

    fn check(&self, proof: &Proof, digest: &Digest) -> Author {
        self.cards.check(self.delegation.node().certificate(), proof, digest, |credential| {
            let revoked = self.circle.revocations_now()?;
            credential.check(&judge(&self.circle.team, &revoked)).map(drop).map_err(|error| error.to_string())
        })
    }

    fn forged(&self, claimed: &str, why: &str) {
        tracing::debug!(claimed, why, "an answer was refused");
    }
}
