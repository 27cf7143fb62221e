//! The requests that a node has accepted: the request numbers that are used up, and the requests by which each deployment runs.
//!
//! ```text
//! ledger     `dca ledger 1` and a line feed, then records
//! record     length (4 bytes), crc32 of the payload (4), crc32 of these 8 bytes (4), payload in postcard
//! 1st record Form: all that was accepted before
//! then       Entry: one request that was accepted
//! ```
//! So a request adds about 250 bytes to the file with one write to the disk, and needs no new file. After a power cut,
//! the last record may be incomplete. It is ignored, because its request was not carried out. A ledger that is damaged
//! in another way is invalid.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;
use trust::identity::KeyId;
use trust::name::UnixTime;
use trust::request::{ReplayWrite, Replays};
use trust::revocation::Revocations;

/// The most bytes of a ledger.
pub const LEDGER_MAX: usize = 8 << 20;
/// How many bytes of records may follow the first record. After that, a new ledger is begun.
pub const ENTRIES_MAX: usize = 1 << 20;
/// For how many deployments the ledger knows the last epoch. If more deployments were accepted, the latest are kept.
const DEPLOYMENTS_MAX: usize = 1024;
/// How many requests of one deployment the ledger knows: the first request, and the latest changes.
const REQUESTS_MAX: usize = 64;
const BEGIN: &[u8] = b"dca ledger 1\n";
/// Length and checksums of a record, in bytes.
const HEAD: usize = 12;

/// A deployment, identified by home and name, because each home counts its own epochs.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) struct Place {
    home: String,
    name: String,
}

/// The requests by which a deployment runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Running {
    epoch: u64,
    /// Signer and number of each request, and the time at which it was accepted.
    requests: Vec<([u8; 32], u64, u64)>,
}

/// The requests that a node has accepted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ledger {
    replays: Replays,
    running: BTreeMap<Place, Running>,
}

/// The first record: all that was accepted before.
#[derive(Serialize, Deserialize)]
struct Form {
    replays: Vec<([u8; 32], Vec<u8>)>,
    running: Vec<(Place, Running)>,
}

/// The entry that one request adds.
#[derive(Serialize, Deserialize)]
struct Entry {
    signer: [u8; 32],
    /// The numbers of the signer that are used up.
    replays: Vec<u8>,
    /// The deployment for which the request was accepted, if it starts one.
    start: Option<Start>,
}

/// A request that was accepted for an epoch of a deployment.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Start {
    pub(super) place: Place,
    pub(super) epoch: u64,
    /// The number of the request.
    pub(super) number: u64,
    pub(super) at: u64,
}

/// A ledger as it was read from the disk.
#[derive(Debug)]
pub struct Found {
    /// The ledger of accepted requests.
    pub ledger: Ledger,
    /// Whether records can be added. This is not so if an incomplete record is at the end.
    pub is_whole: bool,
}

/// The bytes are not a ledger, so it is unknown which requests were accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("it is not a list of accepted requests")]
pub struct LedgerError;

impl Place {
    pub(super) fn new(home: &str, name: &str) -> Self {
        Self { home: home.to_owned(), name: name.to_owned() }
    }
}

impl Ledger {
    /// Returns the ledger as bytes, with all accepted requests in the first record.
    pub fn to_bytes(&self) -> Vec<u8> {
        let replays = self.replays.writes().map(|write| (write.signer.0, write.bytes)).collect();
        let running = self.running.iter().map(|(place, running)| (place.clone(), running.clone())).collect();
        let mut bytes = BEGIN.to_vec();
        bytes.extend(record(&Form { replays, running }));
        bytes
    }

    /// Decodes a ledger. Entries of users who have been revoked since are left out, because no request of theirs is accepted any more.
    ///
    /// # Errors
    /// The bytes are not a ledger.
    pub fn from_bytes(bytes: &[u8], revoked: &Revocations) -> Result<Found, LedgerError> {
        let mut ledger = Self::default();
        let mut left = bytes.strip_prefix(BEGIN).ok_or(LedgerError)?;
        let form = next(&mut left)?.ok_or(LedgerError)?;
        ledger.take(form, revoked)?;
        while let Some(Entry { signer, replays, start }) = next(&mut left)? {
            ledger.restore(signer, replays, revoked)?;
            start.into_iter().for_each(|start| ledger.begin(KeyId(signer), start));
        }
        Ok(Found { ledger, is_whole: left.is_empty() })
    }

    fn take(&mut self, form: Form, revoked: &Revocations) -> Result<(), LedgerError> {
        form.replays.into_iter().try_for_each(|(signer, bytes)| self.restore(signer, bytes, revoked))?;
        self.running = form.running.into_iter().collect();
        Ok(())
    }

    fn restore(&mut self, signer: [u8; 32], bytes: Vec<u8>, revoked: &Revocations) -> Result<(), LedgerError> {
        let signer = KeyId(signer);
        // Without bytes, the entry has no used numbers: its signer had been left out before the request was accepted.
        if bytes.is_empty() || revoked.has(&signer) {
            return Ok(());
        }
        self.replays.restore(&ReplayWrite { signer, bytes }).map_err(|_unreadable| LedgerError)
    }

    pub(super) fn replays(&mut self) -> &mut Replays {
        &mut self.replays
    }

    /// Returns the highest accepted epoch of a deployment. 0 if no epoch was accepted.
    pub(super) fn epoch(&self, place: &Place) -> u64 {
        self.running.get(place).map_or(0, |running| running.epoch)
    }

    /// Returns when a request was accepted for this epoch of a deployment. Nothing if no request was accepted.
    pub(super) fn accepted(&self, place: &Place, epoch: u64, signer: KeyId, number: u64) -> Option<UnixTime> {
        let running = self.running.get(place).filter(|running| running.epoch == epoch)?;
        let mut requests = running.requests.iter();
        requests.find(|(by, of, _)| (*by, *of) == (signer.0, number)).map(|(_, _, at)| UnixTime(*at))
    }

    /// Notes that the number of an accepted request is used up. If the request starts something, its epoch must not be
    /// below the last epoch of its deployment. Returns the record of the request.
    pub(super) fn accept(&mut self, ReplayWrite { signer, bytes }: ReplayWrite, start: Option<Start>) -> Vec<u8> {
        start.iter().for_each(|start| self.begin(signer, start.clone()));
        record(&Entry { signer: signer.0, replays: bytes, start })
    }

    /// Notes that a request which was accepted before begins a later epoch of its deployment. Returns the record of the request.
    pub(super) fn accept_again(&mut self, signer: KeyId, start: Start) -> Vec<u8> {
        let spent = self.replays.writes().find(|write| write.signer == signer);
        let spent = spent.map_or_else(Vec::new, |write| write.bytes);
        self.begin(signer, start.clone());
        record(&Entry { signer: signer.0, replays: spent, start: Some(start) })
    }

    fn begin(&mut self, signer: KeyId, Start { place, epoch, number, at }: Start) {
        let running = self.running.entry(place).or_insert_with(|| Running { epoch, requests: Vec::new() });
        if running.epoch != epoch {
            *running = Running { epoch, requests: Vec::new() };
        }
        if running.requests.len() >= REQUESTS_MAX {
            running.requests.remove(1);
        }
        running.requests.push((signer.0, number, at));
        if self.running.len() > DEPLOYMENTS_MAX {
            let last = |running: &Running| running.requests.last().map_or(0, |(_, _, at)| *at);
            let oldest = self.running.iter().min_by_key(|(_, running)| last(running)).map(|(place, _)| place.clone());
            oldest.into_iter().for_each(|place| drop(self.running.remove(&place)));
        }
    }
}

fn record(payload: &impl Serialize) -> Vec<u8> {
    let payload = postcard::to_stdvec(payload).unwrap_or_default();
    let mut bytes = u32::try_from(payload.len()).unwrap_or(u32::MAX).to_le_bytes().to_vec();
    bytes.extend(crc32fast::hash(&payload).to_le_bytes());
    bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
    bytes.extend(payload);
    bytes
}

/// Returns the next record. Returns nothing at the end, where `left` has the rest of an incomplete record after a power
/// cut: some of its bytes, or zeros.
fn next<T: DeserializeOwned>(left: &mut &[u8]) -> Result<Option<T>, LedgerError> {
    let Some((head, rest)) = left.split_at_checked(HEAD) else { return Ok(None) };
    if left.iter().all(|byte| *byte == 0) {
        return Ok(None);
    }
    let number = |at: usize| head.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes);
    let (Some(length), Some(sum), Some(of_head)) = (number(0), number(4), number(8)) else { return Err(LedgerError) };
    if crc32fast::hash(&head[..8]) != of_head {
        return Err(LedgerError);
    }
    let length = usize::try_from(length).map_err(|_too_long| LedgerError)?;
    let Some((payload, after)) = rest.split_at_checked(length) else { return Ok(None) };
    if crc32fast::hash(payload) != sum {
        return Err(LedgerError);
    }
    *left = after;
    postcard::from_bytes(payload).map(Some).map_err(|_unreadable| LedgerError)
}
