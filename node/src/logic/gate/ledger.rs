//! What a node has accepted: the numbers of requests that are spent, and by which requests each deployment runs.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;
use trust::identity::KeyId;
use trust::name::UnixTime;
use trust::request::{ReplayWrite, Replays};
use trust::revocation::Revocations;

/// The most bytes of a ledger.
pub const LEDGER_MAX: usize = 8 << 20;
/// Of how many deployments it knows the last epoch; of more, those that were accepted last.
const DEPLOYMENTS_MAX: usize = 1024;
/// How many requests of one deployment it knows: the one that began it, and the last changes.
const REQUESTS_MAX: usize = 64;
const BEGIN: &[u8] = b"dca ledger 1\n";

/// A deployment by its home and its name: each home gives epochs of its own.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) struct Place {
    home: String,
    name: String,
}

/// The requests by which a deployment runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Running {
    epoch: u64,
    /// By signer and number, with the time at which each was accepted.
    requests: Vec<([u8; 32], u64, u64)>,
}

/// What a node has accepted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ledger {
    replays: Replays,
    running: BTreeMap<Place, Running>,
}

/// The form of a ledger.
#[derive(Serialize, Deserialize)]
struct Form {
    replays: Vec<([u8; 32], Vec<u8>)>,
    running: Vec<(Place, Running)>,
}

/// Bytes are no ledger: it is not known what was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("it is no list of accepted requests")]
pub struct LedgerError;

impl Place {
    pub(super) fn new(home: &str, name: &str) -> Self {
        Self { home: home.to_owned(), name: name.to_owned() }
    }
}

impl Ledger {
    /// Returns its form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let replays = self.replays.writes().map(|write| (write.signer.0, write.bytes)).collect();
        let running = self.running.iter().map(|(place, running)| (place.clone(), running.clone())).collect();
        let mut bytes = BEGIN.to_vec();
        bytes.extend(postcard::to_stdvec(&Form { replays, running }).unwrap_or_default());
        bytes
    }

    /// Reads its form. Who was revoked since is left out: nothing of them is accepted any more.
    ///
    /// # Errors
    /// The bytes are no ledger.
    pub fn from_bytes(bytes: &[u8], revoked: &Revocations) -> Result<Self, LedgerError> {
        let body = bytes.strip_prefix(BEGIN).ok_or(LedgerError)?;
        let form: Form = postcard::from_bytes(body).map_err(|_unreadable| LedgerError)?;
        let mut replays = Replays::default();
        for (signer, bytes) in form.replays {
            let signer = KeyId(signer);
            if !revoked.has(&signer) {
                replays.restore(&ReplayWrite { signer, bytes }).map_err(|_unreadable| LedgerError)?;
            }
        }
        Ok(Self { replays, running: form.running.into_iter().collect() })
    }

    pub(super) fn replays(&mut self) -> &mut Replays {
        &mut self.replays
    }

    /// Returns the highest epoch of a deployment that was accepted; 0 for none.
    pub(super) fn epoch(&self, place: &Place) -> u64 {
        self.running.get(place).map_or(0, |running| running.epoch)
    }

    /// Returns when a request was accepted for this epoch of a deployment, if it was.
    pub(super) fn accepted(&self, place: &Place, epoch: u64, (signer, number): (KeyId, u64)) -> Option<UnixTime> {
        let running = self.running.get(place).filter(|running| running.epoch == epoch)?;
        let mut requests = running.requests.iter();
        requests.find(|(by, of, _)| (*by, *of) == (signer.0, number)).map(|(_, _, at)| UnixTime(*at))
    }

    /// Notes that a request was accepted for an epoch of a deployment, which is not below the last one.
    pub(super) fn accept(&mut self, place: Place, epoch: u64, (signer, number): (KeyId, u64), at: UnixTime) {
        let running = self.running.entry(place).or_insert_with(|| Running { epoch, requests: Vec::new() });
        if running.epoch != epoch {
            *running = Running { epoch, requests: Vec::new() };
        }
        if running.requests.len() >= REQUESTS_MAX {
            running.requests.remove(1);
        }
        running.requests.push((signer.0, number, at.0));
        if self.running.len() > DEPLOYMENTS_MAX {
            let last = |running: &Running| running.requests.last().map_or(0, |(_, _, at)| *at);
            let oldest = self.running.iter().min_by_key(|(_, running)| last(running)).map(|(place, _)| place.clone());
            oldest.into_iter().for_each(|place| drop(self.running.remove(&place)));
        }
    }
}
