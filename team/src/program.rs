//! The identity of a program's data session toward other hosts, and the clients that it lets in. These are programs with a wire to
//! this one, and visitors from a machine of the team ([`crate::visitor`]).
//!
//! A program makes its keys when it starts, and they never leave it. Its node vouches for the public key, and names the program. The
//! node writes the other data that its programs need to a file in its run folder, which contains no secrets.

use crate::folder;
use crate::member::{REVOKED_BYTES_MAX, judge, revocations};
use anyhow::Context as _;
use comms::io::session::{Digest, Identity, PublicKey};
use comms::logic::proof::Proof;
use std::collections::BTreeSet;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use trust::delegation::Delegation;
use trust::revocation::Revocations;
use trust::team::{Credential, Team};
pub use trust::wire_key::{ProgramKeys, Sealing};
use zeroize::Zeroizing;

/// The longest file.
const FILE_MAX: usize = 16 << 10;
/// How many keys of other programs a program remembers. A program at the other end of a wire has a new key after each start.
const PARTNERS_MAX: usize = 1 << 16;
/// The reason for refusing a program that has no wire to this one.
const NO_WIRE: &str = "it has no wire with this program";

/// The information about the team that a node gives to its programs.
#[derive(Debug)]
pub(crate) struct Circle {
    pub(crate) team: Team,
    /// The credential of the node.
    node: Credential,
    /// The file to which the node writes the revocations.
    revoked: PathBuf,
}

impl Circle {
    /// Returns the content of the file for programs.
    pub(crate) fn bytes(team: &Team, node: &Credential, revoked: &Path) -> anyhow::Result<Vec<u8>> {
        let revoked = revoked.to_str().context("a folder has a name that is not text")?;
        Ok(postcard::to_stdvec(&(team.to_bytes(), node.to_bytes(), revoked))?)
    }

    /// Reads the file for programs.
    fn open(path: &Path) -> anyhow::Result<Self> {
        let bytes = folder::read_open(path, FILE_MAX)?.with_context(|| format!("`{}` is missing", path.display()))?;
        let broken = || format!("`{}` is broken", path.display());
        let (team, node, revoked): (Vec<u8>, Vec<u8>, String) = postcard::from_bytes(&bytes).with_context(broken)?;
        let team = Team::from_bytes(&team).with_context(broken)?;
        Ok(Self::new(team, Credential::from_bytes(&node).with_context(broken)?, revoked.into()))
    }

    pub(crate) const fn new(team: Team, node: Credential, revoked: PathBuf) -> Self {
        Self { team, node, revoked }
    }

    /// Returns the proof that a node of the team vouches for a key.
    pub(crate) fn delegation(&self, key: &PublicKey, credential: &[u8]) -> Result<Delegation, String> {
        let delegation = Delegation::from_bytes(credential).map_err(|error| format!("its credential: {error}"))?;
        if delegation.key() != key {
            return Err("its credential belongs to another key".to_owned());
        }
        let revoked = self.revocations_now()?;
        delegation.check(&judge(&self.team, &revoked)).map_err(|error| error.to_string())?;
        Ok(delegation)
    }

    /// Returns the revocations that the node has last written. If the file cannot be read, this is an error, and no key is trusted.
    pub(crate) fn revocations_now(&self) -> Result<Revocations, String> {
        let read = folder::read_open(&self.revoked, REVOKED_BYTES_MAX);
        let read = read.and_then(|sets| sets.map_or(Ok(Revocations::default()), |sets| revocations(&sets, &self.team)));
        read.map_err(|error| format!("the revocations cannot be read: {error:#}"))
    }
}

/// A function that is called with each refused program that has no wire to this one.
type OnStranger = Box<dyn Fn(String) + Send + Sync>;

/// The identity of a program in a team.
pub struct ProgramIdentity {
    /// The file of the circle. It is read again, since the certificate of the node may be renewed.
    path: PathBuf,
    circle: Circle,
    keys: ProgramKeys,
    /// The signature of the node on the program's key; none before the node has sent it.
    delegation: Mutex<Option<Delegation>>,
    /// The keys of programs that have, or had, wires to this one. A program that has lost its wire gets no more data. Its link is not
    /// cut, because a value in transit may still need it.
    partners: Mutex<BTreeSet<PublicKey>>,
    /// Notified when keys are added.
    news: watch::Sender<()>,
    on_stranger: OnStranger,
}

impl fmt::Debug for ProgramIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ProgramIdentity").field("keys", &self.keys).finish_non_exhaustive()
    }
}

impl ProgramIdentity {
    /// Makes keys, and reads the credentials that the node has written for its programs. `on_stranger` gets a message for people
    /// about each refused program that has no wire to this one.
    ///
    /// # Errors
    /// If the file is missing or invalid, or the system has no random bytes.
    pub fn open(path: &Path, on_stranger: impl Fn(String) + Send + Sync + 'static) -> anyhow::Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            circle: Circle::open(path)?,
            keys: ProgramKeys::generate(&mut crate::random()?),
            delegation: Mutex::default(),
            partners: Mutex::default(),
            news: watch::Sender::new(()),
            on_stranger: Box::new(on_stranger),
        })
    }

    /// Returns the keys of the program.
    pub const fn keys(&self) -> &ProgramKeys {
        &self.keys
    }

    /// Stores the node's signature on the program's key.
    pub fn take_delegation(&self, bytes: &[u8]) {
        match Delegation::from_bytes(bytes) {
            Ok(delegation) if *delegation.key() == self.keys.signing().1 => *self.delegation() = Some(delegation),
            Ok(_) => tracing::warn!("the node vouches for another key"),
            Err(error) => tracing::warn!(%error, "the signature of the node cannot be read"),
        }
    }

    /// Also permits programs with these public keys to link.
    pub fn let_in<'a>(&self, keys: impl Iterator<Item = &'a [u8]>) {
        let mut partners = self.partners();
        partners.extend(keys.filter_map(ProgramKeys::signing_of).take(PARTNERS_MAX));
        while partners.len() > PARTNERS_MAX {
            partners.pop_first();
        }
        drop(partners);
        self.news.send_replace(());
    }

    /// Returns why a digest is not signed by a permitted visitor. None if it is signed by such a visitor.
    pub fn visit_problem(&self, proof: &Proof, digest: &Digest) -> Option<String> {
        let Some(credential) = &proof.credential else { return Some("it shows no credential".to_owned()) };
        match self.circle.delegation(&proof.key, credential) {
            Err(why) => Some(why),
            Ok(delegation) if delegation.program().is_some() => Some("it is a program".to_owned()),
            Ok(delegation) if delegation.has_signed(digest, &proof.signature) => None,
            Ok(_) => Some("its signature was not made with its key".to_owned()),
        }
    }

    fn delegation(&self) -> MutexGuard<'_, Option<Delegation>> {
        // The delegation is replaced as a whole, so it is valid even after a panic.
        self.delegation.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn partners(&self) -> MutexGuard<'_, BTreeSet<PublicKey>> {
        self.partners.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn may_link(&self, delegation: &Delegation) -> bool {
        delegation.program().is_none() || self.partners().contains(delegation.key())
    }
}

/// Returns a description of a key's owner, for whom a node vouches, for people.
fn named(delegation: &Delegation) -> String {
    let node = &delegation.node().certificate().claims().name;
    delegation.program().map_or_else(|| format!("a visitor from {node}"), |program| format!("{program} on {node}"))
}

impl Identity for ProgramIdentity {
    fn key(&self) -> (Zeroizing<[u8; 32]>, PublicKey) {
        self.keys.signing()
    }

    fn credential(&self) -> Vec<u8> {
        let Some(delegation) = self.delegation().clone() else { return Vec::new() };
        // If the newest credential cannot be read, the one from the start is valid for a while.
        let newest = Circle::open(&self.path).ok().and_then(|circle| delegation.renewed(circle.node));
        newest.as_ref().unwrap_or(&delegation).to_bytes()
    }

    fn judge(&self, key: &PublicKey, credential: &[u8]) -> Result<String, String> {
        let delegation = self.circle.delegation(key, credential)?;
        if self.may_link(&delegation) {
            Ok(named(&delegation))
        } else {
            Err(format!("{NO_WIRE}: {}", named(&delegation)))
        }
    }

    fn awaits(&self, key: &PublicKey, credential: &[u8]) -> Option<watch::Receiver<()>> {
        // The receiver is made before the check, so that changes after the check are noticed.
        let news = self.news.subscribe();
        let delegation = self.circle.delegation(key, credential).ok()?;
        (!self.may_link(&delegation)).then_some(news)
    }

    fn revocations(&self) -> Vec<u8> {
        Vec::new()
    }

    fn hear(&self, _: &[u8]) -> bool {
        false
    }

    fn refused(&self, from: SocketAddr, why: &str) {
        tracing::warn!(%from, why, "a peer was refused");
        if let Some(who) = why.strip_prefix(NO_WIRE) {
            (self.on_stranger)(format!("{} at {}", who.trim_start_matches(": "), from.ip()));
        }
    }
}
