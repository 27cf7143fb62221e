//! The keys of simulated robots: signatures are checked as with real keys, and only a robot with the secret can sign
//! under its name.

use dbmanager::logic::notary::{Holder, Notary};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

/// The revoked keys of the team. All robots know them at once.
pub(crate) type Revoked = Arc<Mutex<BTreeSet<[u8; 64]>>>;

/// The keys of one robot.
#[derive(Clone, Debug)]
pub(crate) struct Keys {
    robot: String,
    secret: [u8; 32],
    revoked: Revoked,
}

/// In this simulation, robots publish the key that they sign with. So any robot that can check a signature could forge
/// it, but no robot does.
fn mac(keys: &[u8; 64], digest: &[u8; 32]) -> Vec<u8> {
    let mut secret = [0; 32];
    secret.copy_from_slice(&keys[..32]);
    blake3::keyed_hash(&secret, digest).as_bytes().repeat(2)
}

impl Keys {
    /// Returns the keys that a robot has after this number of invitations.
    pub(crate) fn new(robot: &str, invited: u32, revoked: &Revoked) -> Self {
        let secret = blake3::derive_key("dca simulated keys", format!("{robot} {invited}").as_bytes());
        Self { robot: robot.to_owned(), secret, revoked: Arc::clone(revoked) }
    }

    fn public(&self) -> [u8; 64] {
        let mut keys = [0; 64];
        keys[..32].copy_from_slice(&self.secret);
        keys
    }

    /// Makes the team revoke these keys.
    pub(crate) fn revoke(&self) {
        self.revoked.lock().unwrap_or_else(PoisonError::into_inner).insert(self.public());
    }
}

impl Notary for Keys {
    fn sign(&self, digest: &[u8; 32]) -> Vec<u8> {
        mac(&self.public(), digest)
    }

    fn credential(&self) -> Vec<u8> {
        [&self.public()[..], self.robot.as_bytes()].concat()
    }

    fn holder(&self, credential: &[u8]) -> Result<Holder, String> {
        let (keys, robot) = credential.split_first_chunk::<64>().ok_or("it is too short")?;
        Ok(Holder { robot: String::from_utf8_lossy(robot).into_owned(), keys: *keys })
    }

    fn is_signed(&self, holder: &Holder, digest: &[u8; 32], signature: &[u8]) -> bool {
        mac(&holder.keys, digest) == signature
    }

    fn is_revoked(&self, holder: &Holder) -> bool {
        self.revoked.lock().unwrap_or_else(PoisonError::into_inner).contains(&holder.keys)
    }
}
