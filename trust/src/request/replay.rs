//! The used numbers of requests. For each signer these are the highest number, and which of the 1024 numbers up to it were
//! used.

use crate::identity::KeyId;
use crate::wire::{FormError, Reader, Writer};
use std::collections::BTreeMap;
use thiserror::Error;

/// The most signers that a node remembers.
pub const SIGNERS_MAX: usize = 1024;
/// For how many numbers up to the highest it is known whether they were used.
const WINDOW: u64 = 1024;
const BLOCKS: usize = 16;
const REPLAY: &str = "dca replay 1";
const RECORD_MAX: usize = 256;

/// Why a number is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ReplayError {
    /// The number was already used.
    #[error("request number {0} of this signer was used before")]
    Used(u64),
    /// The number is too far below the highest one to know whether it was used.
    #[error("request number {0} of this signer is too old")]
    Old(u64),
    /// There is no room for another signer.
    #[error("this node remembers requests of no more than {SIGNERS_MAX} signers")]
    Full,
}

/// The record to be written for a signer; it replaces the old one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayWrite {
    /// The signer.
    pub signer: KeyId,
    /// The record.
    pub bytes: Vec<u8>,
}

/// The numbers of one signer. Bit `i` of the blocks is for the number `highest - i`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    highest: u64,
    used: [u64; BLOCKS],
}

impl Window {
    const fn first(sequence: u64) -> Self {
        let mut used = [0; BLOCKS];
        used[0] = 1;
        Self { highest: sequence, used }
    }

    /// Returns the block and the bit of a number up to the highest one.
    fn place(&self, sequence: u64) -> Option<(usize, u64)> {
        let below = self.highest - sequence;
        let block = usize::try_from(below / 64).ok().filter(|_| below < WINDOW)?;
        Some((block, 1 << (below % 64)))
    }

    fn check(&self, sequence: u64) -> Result<(), ReplayError> {
        if sequence > self.highest {
            return Ok(());
        }
        match self.place(sequence) {
            None => Err(ReplayError::Old(sequence)),
            Some((block, bit)) if self.used[block] & bit != 0 => Err(ReplayError::Used(sequence)),
            Some(_) => Ok(()),
        }
    }

    fn spend(&mut self, sequence: u64) {
        if sequence > self.highest {
            self.shift(sequence - self.highest);
            self.highest = sequence;
        }
        if let Some((block, bit)) = self.place(sequence) {
            self.used[block] |= bit;
        }
    }

    fn shift(&mut self, by: u64) {
        let old = self.used;
        let blocks = usize::try_from(by / 64).unwrap_or(BLOCKS).min(BLOCKS);
        let bits = by % 64;
        for (index, block) in self.used.iter_mut().enumerate() {
            let from = |back: usize| index.checked_sub(blocks + back).map_or(0, |place| old[place]);
            *block = from(0) << bits | if bits == 0 { 0 } else { from(1) >> (64 - bits) };
        }
    }

    fn to_bytes(self) -> Vec<u8> {
        let mut writer = Writer::new(REPLAY);
        writer.u64(self.highest);
        self.used.iter().for_each(|block| writer.u64(*block));
        writer.finish()
    }

    fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, REPLAY, RECORD_MAX)?;
        let (highest, mut used) = (reader.u64()?, [0; BLOCKS]);
        for block in &mut used {
            *block = reader.u64()?;
        }
        reader.finish()?;
        if used[0] & 1 == 0 { Err(FormError::Field("used")) } else { Ok(Self { highest, used }) }
    }
}

/// The numbers of all signers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Replays(BTreeMap<KeyId, Window>);

impl Replays {
    /// Reads a stored record.
    ///
    /// # Errors
    /// If the bytes are not such a record. Then no request of this signer may be accepted, because its used numbers are
    /// unknown.
    pub fn restore(&mut self, write: &ReplayWrite) -> Result<(), FormError> {
        self.0.insert(write.signer, Window::from_bytes(&write.bytes)?);
        Ok(())
    }

    /// Returns the records to be written for all signers.
    pub fn writes(&self) -> impl Iterator<Item = ReplayWrite> + '_ {
        self.0.iter().map(|(signer, window)| ReplayWrite { signer: *signer, bytes: window.to_bytes() })
    }

    /// Forgets a signer whose requests can never be accepted again: it is revoked, or its certificate has ended for good.
    pub fn forget(&mut self, signer: &KeyId) {
        self.0.remove(signer);
    }

    pub(super) fn check(&self, signer: &KeyId, sequence: u64) -> Result<(), ReplayError> {
        match self.0.get(signer) {
            Some(window) => window.check(sequence),
            None if self.0.len() >= SIGNERS_MAX => Err(ReplayError::Full),
            None => Ok(()),
        }
    }

    pub(super) fn spend(&mut self, signer: KeyId, sequence: u64) -> Result<ReplayWrite, ReplayError> {
        self.check(&signer, sequence)?;
        let window = self.0.entry(signer).or_insert_with(|| Window::first(sequence));
        window.spend(sequence);
        Ok(ReplayWrite { signer, bytes: window.to_bytes() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    const SIGNER: KeyId = KeyId([1; 32]);

    proptest! {
        /// Compared with a set of all numbers: each number is accepted once, and none that is far below the highest one.
        #[test]
        fn a_number_is_accepted_once(steps in prop::collection::vec((0u64..3000, any::<bool>()), 1..200)) {
            let (mut replays, mut used) = (Replays::default(), BTreeSet::new());
            for (sequence, restart) in steps {
                let highest = used.last().copied().unwrap_or(0);
                let is_new = !used.contains(&sequence) && (used.is_empty() || sequence + WINDOW > highest);
                let spent = replays.spend(SIGNER, sequence);
                prop_assert_eq!(spent.is_ok(), is_new, "{} after {:?}", sequence, used);
                if let Ok(write) = spent {
                    used.insert(sequence);
                    if restart {
                        replays = Replays::default();
                        replays.restore(&write).unwrap();
                    }
                }
            }
        }
    }

    #[test]
    fn signers_have_a_limit() {
        let mut replays = Replays::default();
        for number in 0..SIGNERS_MAX {
            let mut id = [0; 32];
            id[..8].copy_from_slice(&(number as u64).to_be_bytes());
            replays.spend(KeyId(id), 1).unwrap();
        }
        assert_eq!(replays.spend(KeyId([9; 32]), 1), Err(ReplayError::Full));
        replays.forget(&KeyId([0; 32]));
        assert!(replays.spend(KeyId([9; 32]), 1).is_ok());
    }

    #[test]
    fn the_ends_of_all_numbers() {
        let mut replays = Replays::default();
        replays.spend(SIGNER, 0).unwrap();
        replays.spend(SIGNER, u64::MAX).unwrap();
        assert_eq!(replays.spend(SIGNER, u64::MAX), Err(ReplayError::Used(u64::MAX)));
        assert_eq!(replays.spend(SIGNER, 0), Err(ReplayError::Old(0)));
    }
}
