//! Devices in a team: one sample goes to several programs, with a separate seal for each program that may accept it.
//! The sample itself is not secret.

use super::{DataError, Opener, Publisher, Sealer, session_error};
use crate::logic::codec;
use crate::logic::seal::{Content, Refusal, Seals};
use std::borrow::Cow;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use zenoh::Wait;
use zenoh::sample::Sample;

/// Makes the seals of a device's samples, one for each program that may accept them.
#[derive(Debug, Default)]
pub struct Voucher(Mutex<Vec<Arc<Sealer>>>);

/// Lets in samples of the programs that may send them.
pub struct DeviceGate {
    senders: Mutex<Vec<Arc<Opener>>>,
    refused: Box<dyn Fn(Refusal, Option<String>) + Send + Sync>,
}

impl Voucher {
    /// Sets the programs that samples are sealed for; they replace the previous programs.
    pub fn set(&self, to: Vec<Arc<Sealer>>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = to;
    }

    fn seals(&self, bytes: &[u8]) -> Option<Vec<u8>> {
        let hash = blake3::hash(bytes).into();
        let to = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        codec::encode(&Seals { seals: to.iter().filter_map(|sealer| sealer.vouch(&hash)).collect() }).ok()
    }
}

impl DeviceGate {
    /// Returns a gate that lets in nothing yet. `refused` gets the reason of each drop, and the
    /// session that the sample claims to come from. `refused` may only note these.
    pub fn new(refused: impl Fn(Refusal, Option<String>) + Send + Sync + 'static) -> Self {
        Self { senders: Mutex::default(), refused: Box::new(refused) }
    }

    /// Sets the programs whose samples are let in; they replace the previous programs.
    pub fn set(&self, senders: Vec<Arc<Opener>>) {
        *self.senders.lock().unwrap_or_else(PoisonError::into_inner) = senders;
    }

    /// Returns the content of a sample; none if the sample is refused.
    pub(super) fn admit<'a>(&self, sample: &'a Sample) -> Option<Cow<'a, [u8]>> {
        let bytes = sample.payload().to_bytes();
        let why = match self.check(sample, &bytes) {
            Ok(()) => return Some(bytes),
            Err(why) => why,
        };
        (self.refused)(why, sample.source_info().map(|source| source.source_id().zid().to_string()));
        None
    }

    fn check(&self, sample: &Sample, bytes: &[u8]) -> Result<(), Refusal> {
        let seals = sample.attachment().and_then(|seals| codec::decode::<Seals>(&seals.to_bytes()).ok());
        let Seals { seals } = seals.ok_or(Refusal::Unsealed)?;
        let senders = self.senders.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let known = |seal: &crate::logic::seal::Seal| senders.iter().find(|one| one.key_id() == Some(seal.key));
        let found = seals.iter().find_map(|seal| Some((seal, known(seal)?)));
        let (seal, opener) = found.filter(|(seal, _)| seal.content == Content::Device).ok_or(Refusal::OtherKey)?;
        opener.check(seal, &blake3::hash(bytes).into())
    }
}

impl fmt::Debug for DeviceGate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DeviceGate").field("senders", &self.senders).finish_non_exhaustive()
    }
}

impl Publisher {
    /// Sends a sample that every program can read, with a seal for each program that may accept it.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put_vouched(&self, payload: impl Into<super::Payload>, voucher: &Voucher) -> Result<(), DataError> {
        let bytes = payload.into().0;
        let Some(seals) = voucher.seals(&bytes.to_bytes()) else { return Ok(()) };
        let put = self.publisher.put(bytes).attachment(seals).source_info(self.source_info(0)).wait();
        put.map_err(|cause| session_error(self.publisher.key_expr().as_str(), &cause))
    }
}
