//! Transactions: the unit that is committed, replicated, shown and remembered as a whole.
//!
//! A [`Draft`] is a caller's request. A [`Txn`] is a draft with its position in history: its dot, its timestamp, and its
//! *context*, the version vector on which it was committed. An [`EncodedTxn`] is a transaction as bytes, in the log and
//! on the wire. Each transaction names the hash of the previous one of its origin, and of the other transactions that it
//! has seen. So a number that was used twice is noticed (T6).

use crate::logic::clock::{Timestamp, Wall};
use crate::logic::key::Key;
use crate::logic::notary::{self, Notary, SIGNATURE_SIZE};
use crate::logic::version_vector::{Dot, VersionVector};
pub use crate::logic::view::draft::{Draft, Grant, TxnError};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use thiserror::Error;

/// The longest value, in bytes.
pub const VALUE_SIZE_MAX: usize = 64 << 10;
/// The longest encoded transaction, in bytes.
pub const TXN_SIZE_MAX: usize = 256 << 10;
/// How many further bytes a transaction may have that was rebased from another life of its replica.
pub const REBASE_SIZE_MAX: usize = 64 << 10;
/// The most writes, and the most conditions, of one transaction.
pub const CHANGES_MAX: usize = 4096;
/// The longest reason, in bytes.
pub const REASON_SIZE_MAX: usize = 1024;
/// The format that this version writes. Formats are only ever added, and all of them begin with a [`Header`].
pub const FORMAT: u8 = 2;
/// The format of signed transactions: the bytes of [`FORMAT`], followed by the signature of the writer.
pub const FORMAT_SIGNED: u8 = 3;
/// The format that every version reads.
pub const FORMAT_FIRST: u8 = 1;

/// The meaning of a value's bytes. This is a number, since programs of other versions may know other meanings.
/// [`view::value`](crate::logic::view::value) lists them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Encoding(pub u8);

impl Encoding {
    /// The meaning is agreed between the writer and its readers.
    pub const BYTES: Self = Self(0);
    /// UTF-8.
    pub const TEXT: Self = Self(1);
}

/// The value of a key: a tag and bytes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "StoredValue", into = "StoredValue")]
pub struct Value {
    /// The meaning of the bytes.
    pub encoding: Encoding,
    /// The bytes, shared between snapshots.
    pub bytes: Arc<[u8]>,
}

/// A value in its stored form, which owns its bytes.
#[derive(Serialize, Deserialize)]
struct StoredValue {
    encoding: Encoding,
    bytes: Vec<u8>,
}

impl From<StoredValue> for Value {
    fn from(stored: StoredValue) -> Self {
        Self { encoding: stored.encoding, bytes: stored.bytes.into() }
    }
}

impl From<Value> for StoredValue {
    fn from(value: Value) -> Self {
        Self { encoding: value.encoding, bytes: value.bytes.to_vec() }
    }
}

impl<const N: usize> From<&[u8; N]> for Value {
    fn from(bytes: &[u8; N]) -> Self {
        Self { encoding: Encoding::BYTES, bytes: Arc::from(bytes.as_slice()) }
    }
}

/// A condition that a key has to meet for a transaction to be committed. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Condition {
    /// The key has no value.
    Absent,
    /// The key has a value.
    Exists,
    /// The key's value was written by this transaction, and no other write was concurrent.
    Is(Dot),
}

/// A condition that held where the transaction was committed. It is kept, so that other replicas
/// notice two transactions that relied on the same version and had not seen each other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Require {
    /// The key of the condition.
    pub key: Key,
    /// The condition that held.
    pub condition: Condition,
}

/// A value, or `None` for a deletion, put at a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Write {
    /// The key that is written.
    pub key: Key,
    /// The new value; `None` deletes the key.
    pub value: Option<Value>,
}

/// The eight bytes that link a transaction of an origin to the next one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainHash(pub [u8; 8]);

impl ChainHash {
    /// Returns the first eight bytes of a hash.
    pub(crate) fn of(hasher: &blake3::Hasher) -> Self {
        let mut hash = [0; 8];
        hash.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
        Self(hash)
    }
}

/// The identity of a transaction before its origin was given up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rebase {
    /// The former name; none if only its effect was left, which is a deletion.
    pub from: Option<Dot>,
    /// The former timestamp. It still orders the writes, and identifies them in all lives.
    pub stamp: Timestamp,
    /// The versions in the context that the transaction takes away, sorted, in addition to deletions.
    pub takes: Vec<Dot>,
}

/// A committed transaction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Txn {
    /// The position in the total order. Its origin is the replica that committed the transaction.
    pub stamp: Timestamp,
    /// The number of the transaction at that origin.
    pub seq: u64,
    /// The hash of the previous transaction of its origin.
    pub prev: ChainHash,
    /// The wall clock of the robot that committed it.
    pub wall: Wall,
    /// The part of the context that the previous transaction's context does not include.
    pub context: VersionVector,
    /// The writer's reason.
    pub reason: String,
    /// The conditions that held when it was committed.
    pub requires: Vec<Require>,
    /// The writes, in the order of their keys, each key once.
    pub writes: Vec<Write>,
    /// Whether a caller waits until others have the transaction.
    pub wants_ack: bool,
    /// Set if the transaction was committed before under another name.
    pub rebase: Option<Rebase>,
}

impl Txn {
    /// Returns the name of the transaction.
    pub fn dot(&self) -> Dot {
        Dot { origin: self.stamp.origin, seq: self.seq }
    }

    /// Returns the timestamp that orders the writes: the timestamp of their first life.
    pub fn written(&self) -> Timestamp {
        self.rebase.as_ref().map_or(self.stamp, |rebase| rebase.stamp)
    }
}

/// The fields at the beginning of every format. A replica that cannot read the rest still keeps transactions in order
/// and passes them on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// As in [`Txn`].
    pub stamp: Timestamp,
    /// As in [`Txn`].
    pub seq: u64,
    /// As in [`Txn`].
    pub prev: ChainHash,
    /// As in [`Txn`].
    pub wall: Wall,
    /// As in [`Txn`].
    pub context: VersionVector,
}

/// A transaction as bytes. The bytes of a newer version stay unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EncodedTxn {
    /// The format of `body`.
    pub format: u8,
    /// The transaction.
    pub body: Vec<u8>,
}

/// Why a transaction could not be written or read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CodecError {
    /// Written by a newer version.
    #[error("a transaction of format {format}, this program reads up to {FORMAT_SIGNED}")]
    Format {
        /// The format of the transaction.
        format: u8,
    },
    /// More bytes than allowed.
    #[error("a transaction of {size} bytes is longer than {TXN_SIZE_MAX}")]
    Long {
        /// The size of the transaction in bytes.
        size: usize,
    },
    /// The bytes are not a transaction.
    #[error("a transaction is malformed: {cause}")]
    Body {
        /// The error of the decoder.
        cause: postcard::Error,
    },
}

/// The length of [`EncodedTxn::seen`] at the end of a body, in bytes.
const SEEN_SIZE: usize = 8;

impl EncodedTxn {
    /// Returns the transaction as bytes, with the digest of the other transactions that it has seen:
    /// [`Log::seen`](super::log::Log::seen).
    ///
    /// # Errors
    /// If the transaction is too long.
    pub fn seal_on(txn: &Txn, seen: ChainHash) -> Result<Self, CodecError> {
        let Self { mut body, .. } = Self::seal(txn)?;
        body.extend(seen.0);
        Ok(Self { format: FORMAT, body })
    }

    /// Returns the transaction as signed bytes.
    ///
    /// # Errors
    /// If the transaction is too long.
    pub fn seal_signed(txn: &Txn, seen: ChainHash, notary: &dyn Notary) -> Result<Self, CodecError> {
        let Self { mut body, .. } = Self::seal_on(txn, seen)?;
        let signature = notary.sign(&notary::written(&body));
        body.extend(signature);
        Ok(Self { format: FORMAT_SIGNED, body })
    }

    /// Returns the signed digest and the signature; none for an unsigned transaction.
    pub fn signature(&self) -> Option<([u8; 32], &[u8])> {
        let (body, signature) = self.body.split_last_chunk::<SIGNATURE_SIZE>()?;
        (self.format == FORMAT_SIGNED).then(|| (notary::written(body), signature.as_slice()))
    }

    /// Returns the digest of the other transactions that this one has seen. None in the first
    /// format. This format is also used for a transaction that has seen no other transactions.
    pub fn seen(&self) -> Option<ChainHash> {
        let (_, end) = self.body.split_at_checked(self.body.len().checked_sub(self.behind())?)?;
        end.first_chunk::<SEEN_SIZE>().copied().map(ChainHash)
    }

    /// Returns how many bytes follow the transaction itself: the digest and the signature.
    const fn behind(&self) -> usize {
        match self.format {
            FORMAT => SEEN_SIZE,
            FORMAT_SIGNED => SEEN_SIZE + SIGNATURE_SIZE,
            _ => 0,
        }
    }

    /// Returns the transaction as bytes, in the first format.
    ///
    /// # Errors
    /// If the transaction is too long.
    pub fn seal(txn: &Txn) -> Result<Self, CodecError> {
        let body = postcard::to_stdvec(txn).map_err(|cause| CodecError::Body { cause })?;
        let spare = if txn.rebase.is_some() { REBASE_SIZE_MAX } else { 0 };
        if body.len() > TXN_SIZE_MAX + spare {
            return Err(CodecError::Long { size: body.len() });
        }
        Ok(Self { format: FORMAT_FIRST, body })
    }

    /// Reads the transaction.
    ///
    /// # Errors
    /// If this version cannot read the bytes.
    pub fn open(&self) -> Result<Txn, CodecError> {
        if !(FORMAT_FIRST..=FORMAT_SIGNED).contains(&self.format) {
            return Err(CodecError::Format { format: self.format });
        }
        if self.body.len() > TXN_SIZE_MAX + REBASE_SIZE_MAX {
            return Err(CodecError::Long { size: self.body.len() });
        }
        let behind = self.behind();
        match postcard::take_from_bytes(&self.body) {
            Ok((txn, rest)) if rest.len() == behind => Ok(txn),
            Ok(_) => Err(CodecError::Body { cause: postcard::Error::DeserializeBadEncoding }),
            Err(cause) => Err(CodecError::Body { cause }),
        }
    }

    /// Reads the position in history, in any format. Returns the position and the bytes after it.
    ///
    /// # Errors
    /// If the bytes do not begin with a position in history.
    pub fn split(&self) -> Result<(Header, &[u8]), CodecError> {
        if self.body.len() > TXN_SIZE_MAX + REBASE_SIZE_MAX {
            return Err(CodecError::Long { size: self.body.len() });
        }
        postcard::take_from_bytes(&self.body).map_err(|cause| CodecError::Body { cause })
    }

    /// Returns a transaction made of these two parts.
    pub(crate) fn join(format: u8, header: &Header, rest: &[u8]) -> Self {
        // Encoding to memory fails only for lengths that are not known in advance, and a header has none.
        let mut body = postcard::to_stdvec(header).unwrap_or_default();
        body.extend(rest);
        Self { format, body }
    }

    /// Returns the hash by which the next transaction of the origin names this one.
    pub fn hash(&self) -> ChainHash {
        ChainHash::of(blake3::Hasher::new().update(&[self.format]).update(&self.body))
    }

    /// Returns the approximate size of the transaction in bytes.
    pub fn size(&self) -> usize {
        self.body.len() + 4
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Quality;
    use crate::logic::version_vector::ReplicaId;
    use proptest::prelude::*;

    fn key(text: &str) -> Key {
        Key::new(text).unwrap()
    }

    fn txn() -> Txn {
        let me = ReplicaId::new(3);
        Txn {
            stamp: Timestamp { epoch: 1, hlc: 300, origin: me },
            seq: 2,
            prev: ChainHash([1; 8]),
            wall: Wall { millis: 5, quality: Quality::Network },
            context: [(ReplicaId::new(2), 9)].into_iter().collect(),
            reason: "r".into(),
            requires: vec![Require { key: key("a"), condition: Condition::Is(Dot { origin: me, seq: 1 }) }],
            writes: vec![Write { key: key("a"), value: Some(b"v".into()) }, Write { key: key("b"), value: None }],
            wants_ack: true,
            rebase: Some(Rebase {
                from: Some(Dot { origin: me, seq: 7 }),
                stamp: Timestamp { epoch: 0, hlc: 9, origin: me },
                takes: vec![Dot { origin: me, seq: 1 }],
            }),
        }
    }

    /// The exact bytes of a transaction. If this test fails, a new format has to be added beside this one.
    #[test]
    fn golden_frame() {
        let encoded = EncodedTxn::seal(&txn()).unwrap();
        let hex: String = encoded.body.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, GOLDEN);
        assert_eq!((encoded.open(), encoded.seen()), (Ok(txn()), None));
        let second = EncodedTxn::seal_on(&txn(), ChainHash([2; 8])).unwrap();
        assert_eq!((second.format, &second.body), (2, &[encoded.body.clone(), vec![2; 8]].concat()));
        assert_eq!((second.open(), second.seen()), (Ok(txn()), Some(ChainHash([2; 8]))));
        let Txn { stamp, seq, prev, wall, context, .. } = txn();
        let newer = EncodedTxn { format: 9, body: [encoded.body, vec![7; 9]].concat() };
        assert_eq!(
            newer.split().map(|(header, _)| header),
            Ok(Header { stamp, seq, prev, wall, context }),
            "which every format begins with"
        );
    }
    const GOLDEN: &str =
        "01ac020302010101010101010105020102090172010161020301020161010001760162000101010307000903010301";

    #[test]
    fn frames_that_are_none() {
        let encoded = EncodedTxn::seal(&txn()).unwrap();
        assert_eq!(EncodedTxn { format: 9, ..encoded.clone() }.open(), Err(CodecError::Format { format: 9 }));
        let mut long = encoded.clone();
        long.body.push(0);
        assert!(matches!(long.open(), Err(CodecError::Body { .. })));
        long.body.resize(TXN_SIZE_MAX + REBASE_SIZE_MAX + 1, 0);
        assert!(matches!(long.open(), Err(CodecError::Long { .. })));
        assert_ne!(long.hash(), encoded.hash());
    }

    #[test]
    fn max_key_value_sizes() {
        let value = |size| Value { encoding: Encoding::BYTES, bytes: vec![0; size].into() };
        assert_eq!(Draft::new("").put(key("a"), value(VALUE_SIZE_MAX)).check(), Ok(()));
        let long = Draft::new("").put(key("a"), value(VALUE_SIZE_MAX + 1)).check();
        assert!(matches!(long, Err(TxnError::Value { .. })));
        let mut many = Draft::new("");
        for number in 0..=CHANGES_MAX {
            many = many.delete(key(&format!("k{number}")));
        }
        let refused = many.check().unwrap_err();
        assert_eq!(
            refused.to_string(),
            "a transaction has 4097 writes, more than 4096; write them in several transactions, as `dca db import` does with a \
             long file"
        );
        let talk = Draft::new("x".repeat(REASON_SIZE_MAX + 1)).check();
        assert!(matches!(talk, Err(TxnError::Limit { what: "bytes of reason", .. })));
        assert_eq!(Draft::new("").put(key("a"), b"1").put(key("a"), b"2").writes().count(), 1);
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(body: Vec<u8>) {
            if let Ok(txn) = (EncodedTxn { format: FORMAT, body }).open() {
                prop_assert_eq!(EncodedTxn::seal(&txn).unwrap().open(), Ok(txn));
            }
        }
    }
}
