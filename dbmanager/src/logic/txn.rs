//! Transactions: what is committed, replicated, shown and remembered as a whole.
//!
//! A [`Draft`] is what somebody wants; a [`Txn`] is that with its place in history: its dot, its stamp, and its *context*,
//! the cut it was committed on. A [`Frame`] is a transaction as bytes, in the log and on the wire. Each names the hash of
//! the one before it at its origin, so a number that was used twice shows (T6).

use crate::logic::clock::{Stamp, Wall};
use crate::logic::cut::{Cut, Dot};
use crate::logic::key::{Key, Namespace};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use thiserror::Error;

/// The longest value, in bytes.
pub const VALUE_SIZE_MAX: usize = 64 << 10;
/// The longest transaction, in bytes as a frame.
pub const TXN_SIZE_MAX: usize = 256 << 10;
/// How many bytes more it may have if it was brought in from another life of its replica.
pub const REBASE_SIZE_MAX: usize = 64 << 10;
/// The most writes, and the most conditions, of one transaction.
pub const CHANGES_MAX: usize = 4096;
/// The longest reason, in bytes.
pub const REASON_SIZE_MAX: usize = 1024;
/// The format that this version writes. Formats are only ever added, and all begin with a [`Header`].
pub const FORMAT: u8 = 1;
/// The format that every version reads.
pub const FORMAT_FIRST: u8 = 1;

/// How the bytes of a value are meant: a number, since programs of other versions know others. The meanings are in
/// [`view::value`](crate::logic::view::value).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Encoding(pub u8);

impl Encoding {
    /// As the writer and its readers have agreed.
    pub const BYTES: Self = Self(0);
    /// UTF-8.
    pub const TEXT: Self = Self(1);
}

/// What a key holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "(Encoding, Vec<u8>)", into = "(Encoding, Vec<u8>)")]
pub struct Value {
    /// How the bytes are meant.
    pub encoding: Encoding,
    /// The bytes, shared between snapshots.
    pub bytes: Arc<[u8]>,
}

impl From<(Encoding, Vec<u8>)> for Value {
    fn from((encoding, bytes): (Encoding, Vec<u8>)) -> Self {
        Self { encoding, bytes: bytes.into() }
    }
}

impl From<Value> for (Encoding, Vec<u8>) {
    fn from(value: Value) -> Self {
        (value.encoding, value.bytes.to_vec())
    }
}

impl<const N: usize> From<&[u8; N]> for Value {
    fn from(bytes: &[u8; N]) -> Self {
        Self { encoding: Encoding::BYTES, bytes: Arc::from(bytes.as_slice()) }
    }
}

/// What has to hold of a key for a transaction to be committed. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Condition {
    /// It has no value.
    Absent,
    /// It has a value.
    Exists,
    /// Its value was written by this transaction, and nobody has written beside it.
    Is(Dot),
}

/// A condition that held where the transaction was committed. It is kept: others can see that two transactions relied on
/// the same version without knowing of each other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Require {
    /// Of which key.
    pub key: Key,
    /// What.
    pub condition: Condition,
}

/// A value, or `None` for a deletion, put at a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Write {
    /// Where.
    pub key: Key,
    /// What.
    pub value: Option<Value>,
}

/// The eight bytes that chain the frames of an origin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Link(pub [u8; 8]);

/// Where a transaction was before its origin had to be given up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rebase {
    /// Its name there; none if only its effect was left, which is a deletion.
    pub from: Option<Dot>,
    /// Its stamp there, which still orders its writes and is their name in all lives.
    pub stamp: Stamp,
    /// What it takes away of what is in its context, in order; deletions besides.
    pub takes: Vec<Dot>,
}

/// A committed transaction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Txn {
    /// Its place in the one order of all; the origin in it is who committed.
    pub stamp: Stamp,
    /// Its number at that origin.
    pub seq: u64,
    /// The link of the one before it.
    pub prev: Link,
    /// The wall clock where it was committed.
    pub wall: Wall,
    /// What of its context is beyond the context of the one before it.
    pub context: Cut,
    /// Why it was done.
    pub reason: String,
    /// What held when it was.
    pub requires: Vec<Require>,
    /// What it changed, by key, each key once.
    pub writes: Vec<Write>,
    /// Whether somebody waits for others to have it.
    pub wants_ack: bool,
    /// Set if it was committed before under another name.
    pub rebase: Option<Rebase>,
}

impl Txn {
    /// Returns its name.
    pub fn dot(&self) -> Dot {
        Dot { origin: self.stamp.origin, seq: self.seq }
    }

    /// Returns the stamp that orders its writes: that of its first life.
    pub fn written(&self) -> Stamp {
        self.rebase.as_ref().map_or(self.stamp, |rebase| rebase.stamp)
    }
}

/// What every format begins with: who cannot read the rest still keeps frames in order and passes them on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// As in [`Txn`].
    pub stamp: Stamp,
    /// As in [`Txn`].
    pub seq: u64,
    /// As in [`Txn`].
    pub prev: Link,
    /// As in [`Txn`].
    pub wall: Wall,
    /// As in [`Txn`].
    pub context: Cut,
}

/// A transaction as bytes. What a newer version wrote stays as it is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// How `body` is to be read.
    pub format: u8,
    /// The transaction.
    pub body: Vec<u8>,
}

/// Why a frame was not written or read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FrameError {
    /// Written by a newer version.
    #[error("a transaction of format {format}, this program reads up to {FORMAT}")]
    Format {
        /// Its format.
        format: u8,
    },
    /// More bytes than allowed.
    #[error("a transaction of {size} bytes is longer than {TXN_SIZE_MAX}")]
    Long {
        /// Its size.
        size: usize,
    },
    /// The bytes are no transaction.
    #[error("a transaction is malformed: {cause}")]
    Body {
        /// What the decoder says.
        cause: postcard::Error,
    },
}

impl Frame {
    /// Returns the transaction as bytes.
    ///
    /// # Errors
    /// If it is too long.
    pub fn seal(txn: &Txn) -> Result<Self, FrameError> {
        let body = postcard::to_stdvec(txn).map_err(|cause| FrameError::Body { cause })?;
        let spare = if txn.rebase.is_some() { REBASE_SIZE_MAX } else { 0 };
        if body.len() > TXN_SIZE_MAX + spare {
            return Err(FrameError::Long { size: body.len() });
        }
        Ok(Self { format: FORMAT, body })
    }

    /// Reads the transaction.
    ///
    /// # Errors
    /// If the bytes are none that this version can read.
    pub fn open(&self) -> Result<Txn, FrameError> {
        if self.format != FORMAT {
            return Err(FrameError::Format { format: self.format });
        }
        if self.body.len() > TXN_SIZE_MAX + REBASE_SIZE_MAX {
            return Err(FrameError::Long { size: self.body.len() });
        }
        match postcard::take_from_bytes(&self.body) {
            Ok((txn, [])) => Ok(txn),
            Ok(_) => Err(FrameError::Body { cause: postcard::Error::DeserializeBadEncoding }),
            Err(cause) => Err(FrameError::Body { cause }),
        }
    }

    /// Reads its place in history, of any format, and returns the bytes behind it.
    ///
    /// # Errors
    /// If there is none.
    pub fn split(&self) -> Result<(Header, &[u8]), FrameError> {
        if self.body.len() > TXN_SIZE_MAX + REBASE_SIZE_MAX {
            return Err(FrameError::Long { size: self.body.len() });
        }
        postcard::take_from_bytes(&self.body).map_err(|cause| FrameError::Body { cause })
    }

    /// Returns a frame of these two parts.
    pub(crate) fn join(format: u8, header: &Header, rest: &[u8]) -> Self {
        // Encoding to memory fails for lengths that are not known beforehand only, and a header has none.
        let mut body = postcard::to_stdvec(header).unwrap_or_default();
        body.extend(rest);
        Self { format, body }
    }

    /// Returns what the next frame of the origin calls it.
    pub fn link(&self) -> Link {
        let digest = blake3::Hasher::new().update(&[self.format]).update(&self.body).finalize();
        let mut link = [0; 8];
        link.copy_from_slice(&digest.as_bytes()[..8]);
        Link(link)
    }

    /// Returns about how many bytes it takes.
    pub fn size(&self) -> usize {
        self.body.len() + 4
    }
}

/// What somebody wants to commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draft {
    reason: String,
    requires: Vec<Require>,
    writes: BTreeMap<Key, Option<Value>>,
    grants: BTreeMap<Key, Grant>,
}

/// Who is to own a prefix from now on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Grant {
    /// Its owner, or anybody if it has none, gives it to a robot, or releases it.
    Give(Option<String>),
    /// An operator takes it from whoever has it, and gives it to a robot.
    TakeOver(String),
}

/// Why nothing was committed. The state is as if the transaction had not been tried.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TxnError {
    /// A condition does not hold here.
    #[error("`{key}` is not as required ({condition:?}), but written by {actual:?}")]
    Precondition {
        /// Of which key.
        key: Key,
        /// What was required.
        condition: Condition,
        /// Who wrote what is there, siblings included, deletions left out.
        actual: Vec<Dot>,
    },
    /// A value that is too long.
    #[error("the value of `{key}` has {size} bytes, more than {VALUE_SIZE_MAX}")]
    Value {
        /// Of which key.
        key: Key,
        /// Its size.
        size: usize,
    },
    /// Too many writes or conditions, or a long reason.
    #[error("a transaction has {count} {what}, more than {limit}")]
    Limit {
        /// Of what there is too much.
        what: &'static str,
        /// How much.
        count: usize,
        /// How much is allowed.
        limit: usize,
    },
    /// Too long as a whole.
    #[error("the transaction does not fit")]
    Frame(#[from] FrameError),
    /// The prefix belongs to somebody else, on whose robot the transaction can be tried.
    #[error("`{key}` may only be written on the robot `{owner}`")]
    NotOwner {
        /// Which key.
        key: Key,
        /// Whose it is.
        owner: String,
        /// Since which grant.
        term: u64,
    },
    /// The namespace is not written by transactions.
    #[error("`{key}` is in a namespace that transactions do not write")]
    Reserved {
        /// Which key.
        key: Key,
    },
    /// The clock has no stamp left.
    #[error("the clock has come to its end: a peer has sent a stamp that nobody can have issued")]
    Clock,
    /// It never leaves the robot, so no other robot can have it.
    #[error("`{key}` stays on this robot, so nobody else can have it")]
    Stays {
        /// Which key.
        key: Key,
    },
}

impl Draft {
    /// Returns a transaction without changes, done for `reason`.
    pub fn new(reason: impl Into<String>) -> Self {
        Self { reason: reason.into(), requires: Vec::new(), writes: BTreeMap::new(), grants: BTreeMap::new() }
    }

    /// Adds a condition.
    #[must_use]
    pub fn require(mut self, key: Key, condition: Condition) -> Self {
        self.requires.push(Require { key, condition });
        self
    }

    /// Adds a value; of several at one key the last counts.
    #[must_use]
    pub fn put(mut self, key: Key, value: impl Into<Value>) -> Self {
        self.writes.insert(key, Some(value.into()));
        self
    }

    /// Adds a deletion.
    #[must_use]
    pub fn delete(mut self, key: Key) -> Self {
        self.writes.insert(key, None);
        self
    }

    /// Gives a prefix such as `team/arm` to somebody: see [`owner`](crate::logic::owner).
    #[must_use]
    pub fn grant(mut self, prefix: Key, grant: Grant) -> Self {
        self.grants.insert(prefix, grant);
        self
    }

    /// Returns which prefixes it gives to somebody.
    pub fn grants(&self) -> impl Iterator<Item = (&Key, &Grant)> {
        self.grants.iter()
    }

    /// Returns whether it writes what never leaves the robot, and nothing else.
    pub fn is_local(&self) -> bool {
        let local = |key: &Key| key.namespace() == Namespace::Local;
        self.grants.is_empty() && !self.writes.is_empty() && self.writes.keys().all(local)
    }

    /// Returns what it changes.
    pub fn writes(&self) -> impl Iterator<Item = (&Key, Option<&Value>)> {
        self.writes.iter().map(|(key, value)| (key, value.as_ref()))
    }

    /// Returns what it requires.
    pub fn requires(&self) -> &[Require] {
        &self.requires
    }

    /// Checks its limits.
    ///
    /// # Errors
    /// If it exceeds one.
    pub fn check(&self) -> Result<(), TxnError> {
        let limits = [
            ("writes", self.writes.len() + self.grants.len(), CHANGES_MAX),
            ("conditions", self.requires.len(), CHANGES_MAX),
            ("bytes of reason", self.reason.len(), REASON_SIZE_MAX),
        ];
        if let Some((what, count, limit)) = limits.into_iter().find(|(_, count, limit)| count > limit) {
            return Err(TxnError::Limit { what, count, limit });
        }
        let values = self.writes.iter().filter_map(|(key, value)| Some((key, value.as_ref()?.bytes.len())));
        match values.into_iter().find(|(_, size)| *size > VALUE_SIZE_MAX) {
            Some((key, size)) => Err(TxnError::Value { key: key.clone(), size }),
            None => Ok(()),
        }
    }

    /// Takes it apart: reason, conditions, writes by key.
    pub fn into_parts(self) -> (String, Vec<Require>, Vec<Write>) {
        let writes = self.writes.into_iter().map(|(key, value)| Write { key, value }).collect();
        (self.reason, self.requires, writes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Quality;
    use crate::logic::cut::Origin;
    use proptest::prelude::*;

    fn key(text: &str) -> Key {
        Key::new(text).unwrap()
    }

    fn txn() -> Txn {
        let me = Origin::new(3);
        Txn {
            stamp: Stamp { epoch: 1, hlc: 300, origin: me },
            seq: 2,
            prev: Link([1; 8]),
            wall: Wall { millis: 5, quality: Quality::Network },
            context: [(Origin::new(2), 9)].into_iter().collect(),
            reason: "r".into(),
            requires: vec![Require { key: key("a"), condition: Condition::Is(Dot { origin: me, seq: 1 }) }],
            writes: vec![Write { key: key("a"), value: Some(b"v".into()) }, Write { key: key("b"), value: None }],
            wants_ack: true,
            rebase: Some(Rebase {
                from: Some(Dot { origin: me, seq: 7 }),
                stamp: Stamp { epoch: 0, hlc: 9, origin: me },
                takes: vec![Dot { origin: me, seq: 1 }],
            }),
        }
    }

    /// Bytes that other versions rely on: if this fails, there has to be a new format beside this one.
    #[test]
    fn golden_frame() {
        let frame = Frame::seal(&txn()).unwrap();
        let hex: String = frame.body.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, GOLDEN);
        assert_eq!(frame.open(), Ok(txn()));
        let Txn { stamp, seq, prev, wall, context, .. } = txn();
        let newer = Frame { format: 9, body: [frame.body, vec![7; 9]].concat() };
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
        let frame = Frame::seal(&txn()).unwrap();
        assert_eq!(Frame { format: 9, ..frame.clone() }.open(), Err(FrameError::Format { format: 9 }));
        let mut long = frame.clone();
        long.body.push(0);
        assert!(matches!(long.open(), Err(FrameError::Body { .. })));
        long.body.resize(TXN_SIZE_MAX + REBASE_SIZE_MAX + 1, 0);
        assert!(matches!(long.open(), Err(FrameError::Long { .. })));
        assert_ne!(long.link(), frame.link());
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
        assert!(matches!(many.check(), Err(TxnError::Limit { what: "writes", .. })));
        let talk = Draft::new("x".repeat(REASON_SIZE_MAX + 1)).check();
        assert!(matches!(talk, Err(TxnError::Limit { what: "bytes of reason", .. })));
        assert_eq!(Draft::new("").put(key("a"), b"1").put(key("a"), b"2").writes().count(), 1);
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(body: Vec<u8>) {
            if let Ok(txn) = (Frame { format: FORMAT, body }).open() {
                prop_assert_eq!(Frame::seal(&txn).unwrap().open(), Ok(txn));
            }
        }
    }
}
