//! The records of a replica on its disk, written in batches. A batch is written as a whole or not at all. Each record ends
//! with a checksum of its name and its bytes. The records that every transaction changes have neighbouring names where
//! possible, so that they lie in one page of the store.
//!
//! | record | holds |
//! |---|---|
//! | `i` | identity: origin, robot, and the origins that were given up |
//! | `s` | digests of version vector and state, numbers of transactions and keys: to notice a damaged disk |
//! | `l` origin number | a transaction, and its position in the order of application |
//! | `k` key | the versions of a key |
//! | `p` key | the version of a key that never leaves the robot |
//! | `o` index | a transaction that cannot be read yet |
//! | `t` origin | the head of an origin: the tip of its transactions |

use crate::logic::key::Key;
use crate::logic::log::{Head, Log, Logged};
use crate::logic::state::{State, Version};
use crate::logic::txn::{CodecError, EncodedTxn};
use crate::logic::version_vector::{Dot, ReplicaId};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// Everything in a store, by name.
pub type Records = BTreeMap<Vec<u8>, Vec<u8>>;

/// Changes to a store that belong together; `None` removes a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Batch(pub BTreeMap<Vec<u8>, Option<Vec<u8>>>);

/// The identity of a store.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct IdentityRecord {
    /// The present origin, under which the replica numbers its transactions.
    pub(crate) origin: ReplicaId,
    /// Name of the robot.
    pub(crate) robot: String,
    /// The replica id under which the replica wants to be admitted, if it is not a member.
    pub(crate) joining: Option<ReplicaId>,
    /// The sponsor that was asked to admit `joining`; no other sponsor is asked to admit the same id.
    pub(crate) asked: Option<ReplicaId>,
    /// Origins that the replica has given up.
    pub(crate) past: Vec<Past>,
    /// The number up to which others are known to have its own transactions.
    pub(crate) known_by_peers: u64,
}

/// An origin that was given up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Past {
    pub(crate) origin: ReplicaId,
    /// The number up to which others are known to have its transactions.
    pub(crate) known_by_peers: u64,
    /// Whether the origin is known to have used numbers twice.
    pub(crate) twice: bool,
    /// Set for an origin under which the replica wanted to be admitted: the sponsor that was asked, and would be asked for
    /// the same origin again.
    pub(crate) asked: Option<ReplicaId>,
}

/// Why a store cannot be opened. If it is damaged, the remedy is to put it aside, and to join again with the data of the
/// others.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum OpenError {
    /// A record cannot be read.
    #[error("a record of kind `{kind}` is malformed")]
    Record {
        /// The kind of the record.
        kind: char,
    },
    /// The records do not match each other.
    #[error("the store is damaged: {what}")]
    Damaged {
        /// The mismatch, for a person.
        what: &'static str,
    },
    /// The store is undamaged, but has a record that this program does not know.
    #[error("the store was written by a newer version of this program, which has to be started instead")]
    Newer,
    /// The records belong to another robot.
    #[error("the store belongs to the robot `{found}`, not to `{expected}`")]
    Robot {
        /// In the store.
        found: String,
        /// In the configuration.
        expected: String,
    },
}

/// The first byte of the name of a key's record: `SHARED` for keys that every replica has, `LOCAL` for keys that never
/// leave the robot.
pub(crate) const SHARED: u8 = b'k';
pub(crate) const LOCAL: u8 = b'p';

impl Batch {
    /// Returns whether the batch has no changes.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Carries out the changes.
    pub fn apply(&self, records: &mut Records) {
        for (name, record) in &self.0 {
            match record {
                Some(record) => records.insert(name.clone(), record.clone()),
                None => records.remove(name),
            };
        }
    }

    pub(crate) fn identity(&mut self, identity: &IdentityRecord) {
        self.put(vec![b'i'], Some(identity));
    }

    pub(crate) fn digests(&mut self, log: &Log, state: &State) {
        self.put(vec![b's'], Some(&summary(log, state)));
    }

    pub(crate) fn head(&mut self, origin: ReplicaId, head: Option<&Head>) {
        self.put(name(b't', &origin.number().to_be_bytes()), head);
    }

    pub(crate) fn txn(&mut self, dot: Dot, place_and_txn: Option<(u64, &EncodedTxn)>) {
        let rest = [dot.origin.number().to_be_bytes(), dot.seq.to_be_bytes()].concat();
        self.put(name(b'l', &rest), place_and_txn.as_ref());
    }

    pub(crate) fn pending(&mut self, index: u64, pending: Option<(Dot, &EncodedTxn)>) {
        self.put(name(b'o', &index.to_be_bytes()), pending.as_ref());
    }

    pub(crate) fn versions(&mut self, kind: u8, key: &Key, versions: &[Version]) {
        self.put(name(kind, key.as_str().as_bytes()), Some(versions).filter(|versions| !versions.is_empty()));
    }

    /// Writes a record, or removes it.
    fn put(&mut self, name: Vec<u8>, record: Option<&(impl Serialize + ?Sized)>) {
        let bytes = record.map(|record| {
            // Encoding to memory fails only for lengths that are not known in advance, and records have none.
            let mut bytes = postcard::to_stdvec(record).unwrap_or_default();
            bytes.extend(sum(&name, &bytes));
            bytes
        });
        self.0.insert(name, bytes);
    }
}

/// Returns the summary that shows whether a store is complete: digests of version vector and state, and the numbers of
/// transactions and keys.
fn summary(log: &Log, state: &State) -> (u64, u128, usize, usize) {
    (log.vector().digest(), state.digest(), log.len(), state.len())
}

fn name(kind: u8, rest: &[u8]) -> Vec<u8> {
    [&[kind], rest].concat()
}

fn read<'a, T: Deserialize<'a>>(name: &[u8], bytes: &'a [u8]) -> Result<T, OpenError> {
    match postcard::take_from_bytes(whole(name, bytes)?) {
        Ok((record, [])) => Ok(record),
        _ => Err(OpenError::Newer),
    }
}

fn whole<'a>(name: &[u8], bytes: &'a [u8]) -> Result<&'a [u8], OpenError> {
    let (record, found) = bytes.split_last_chunk().unzip();
    let whole = record.filter(|record| found == Some(&sum(name, record)));
    whole.ok_or_else(|| OpenError::Record { kind: char::from(name.first().copied().unwrap_or_default()) })
}

/// Returns a checksum of four bytes, which shows that a record is complete and has its own name.
fn sum(name: &[u8], record: &[u8]) -> [u8; 4] {
    let hash = blake3::Hasher::new().update(name).update(&[0]).update(record).finalize();
    let [a, b, c, d, ..] = *hash.as_bytes();
    [a, b, c, d]
}

fn number(kind: u8, bytes: &[u8]) -> Result<u64, OpenError> {
    bytes.try_into().map(u64::from_be_bytes).map_err(|_cause| OpenError::Record { kind: char::from(kind) })
}

/// A store that is being read. Each record becomes a part of the state at once, so the memory never holds a second copy of
/// the whole.
#[derive(Debug, Default)]
pub struct StoredRecords {
    pub(crate) identity: Option<IdentityRecord>,
    digests: Option<(u64, u128, usize, usize)>,
    heads: BTreeMap<ReplicaId, Head>,
    txns: Vec<(Dot, u64, EncodedTxn)>,
    pub(crate) state: State,
    pub(crate) local: State,
    pub(crate) pending: BTreeMap<u64, (Dot, EncodedTxn)>,
    /// How many records there were.
    pub(crate) count: usize,
    /// The first error.
    wrong: Option<OpenError>,
}

impl StoredRecords {
    /// Takes the next record. Records come in the order of their names. Errors are reported at the end.
    pub fn take(&mut self, name: &[u8], record: &[u8]) {
        self.count += 1;
        if self.wrong.is_none() {
            self.wrong = self.add(name, record).err();
        }
    }

    fn add(&mut self, name: &[u8], bytes: &[u8]) -> Result<(), OpenError> {
        match name.split_first() {
            Some((b'i', [])) => self.identity = Some(read(name, bytes)?),
            Some((b's', [])) => self.digests = Some(read(name, bytes)?),
            Some((b't', origin)) => {
                self.heads.insert(ReplicaId::new(number(b't', origin)?), read(name, bytes)?);
            }
            Some((b'l', rest)) => {
                let (origin, seq) = rest.split_at_checked(8).ok_or(OpenError::Record { kind: 'l' })?;
                let dot = Dot { origin: ReplicaId::new(number(b'l', origin)?), seq: number(b'l', seq)? };
                let (index, encoded) = read(name, bytes)?;
                self.txns.push((dot, index, encoded));
            }
            Some((b'o', index)) => drop(self.pending.insert(number(b'o', index)?, read(name, bytes)?)),
            Some((kind @ (&SHARED | &LOCAL), key)) => {
                let key = std::str::from_utf8(key).ok().and_then(|key| Key::new(key).ok());
                let state = if *kind == SHARED { &mut self.state } else { &mut self.local };
                state.restore(key.ok_or(OpenError::Record { kind: char::from(*kind) })?, read(name, bytes)?);
            }
            _ => return whole(name, bytes).and(Err(OpenError::Newer)),
        }
        Ok(())
    }

    /// Returns the content of the store, and its log.
    ///
    /// # Errors
    /// If anything does not match: a record, a chain of transactions, or the digests.
    pub(crate) fn finish(mut self) -> Result<(Self, Log), OpenError> {
        self.wrong.take().map_or(Ok(()), Err)?;
        check_chains(&self.heads, &self.txns)?;
        let mut log = Log::new(std::mem::take(&mut self.heads));
        for (dot, index, encoded) in std::mem::take(&mut self.txns) {
            log.restore(dot, Logged { index, encoded });
        }
        let fresh = self.count == usize::from(self.identity.is_some());
        if self.digests != Some(summary(&log, &self.state)) && !fresh {
            return Err(OpenError::Damaged { what: "something is missing" });
        }
        Ok((self, log))
    }
}

impl From<&Records> for StoredRecords {
    fn from(records: &Records) -> Self {
        let mut reading = Self::default();
        records.iter().for_each(|(name, record)| reading.take(name, record));
        reading
    }
}

/// Checks that the transactions of each origin are consecutive up to its head. They come in the order of their names. The
/// successor of each, which is the next transaction or the head, has the next number and names its hash.
fn check_chains(heads: &BTreeMap<ReplicaId, Head>, txns: &[(Dot, u64, EncodedTxn)]) -> Result<(), OpenError> {
    for (index, (dot, _, encoded)) in txns.iter().enumerate() {
        let found = encoded.open().map(|txn| txn.dot());
        if let Err(CodecError::Format { .. }) = found {
            return Err(OpenError::Newer);
        }
        let next = txns.get(index + 1).filter(|(next, ..)| next.origin == dot.origin);
        let prev = |encoded: &EncodedTxn| encoded.split().ok().map(|(header, _)| header.prev);
        let next = next.map(|(next, _, encoded)| (next.seq - 1, prev(encoded)));
        let head = || heads.get(&dot.origin).map(|head| (head.seq, Some(head.hash)));
        if found != Ok(*dot) || next.or_else(head) != Some((dot.seq, Some(encoded.hash()))) {
            return Err(OpenError::Damaged { what: "transactions that do not follow each other" });
        }
    }
    Ok(())
}
