//! A program's requests to the database of its node, over its control channel, and the answers.
//!
//! The program gives each request a number. A `Get` and a `Transact` have one answer each. A `Watch` has answers until
//! it is cancelled or refused: [`DatabaseAnswer::Begin`], the present values, [`DatabaseAnswer::Complete`], then each
//! committed change. If the program was too slow, or the disk has failed, the watch starts again with `Begin`. At most
//! [`WINDOW`] parts of a watch are sent before the program has taken them. So a slow program does not fill its channel,
//! and its orders are not delayed.
//!
//! When a channel breaks, nothing is repeated. The result of an unanswered request is unknown: a transaction may have
//! been committed.

mod value;

pub use value::{DEPTH_MAX, Value, ValueError};

use crate::logic::bytes::Bytes;
use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

/// How many requests of one program may be unanswered at a time, not counting watches.
pub const REQUESTS_MAX: usize = 32;
/// How many watches a program has at a time.
pub const WATCHES_MAX: usize = 8;
/// How many parts of one watch may be sent before its program has taken them.
pub const WINDOW: u32 = 8;
/// The longest value, in bytes.
pub const VALUE_SIZE_MAX: usize = 64 << 10;
/// The most bytes of keys and values in one transaction. A message has enough room for these and for the database's own
/// fields.
pub const TRANSACTION_SIZE_MAX: usize = 240 << 10;

/// A request of a program to the database of its node. Append only.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DatabaseRequest {
    /// Asks for the value of a key. Answered by [`DatabaseAnswer::Value`].
    Get {
        /// The key.
        key: String,
    },
    /// Asks for a transaction. Answered by [`DatabaseAnswer::Committed`] or [`DatabaseAnswer::Refused`].
    Transact(Transaction),
    /// Subscribes to a key, or to the keys below a prefix that ends in `/`.
    Watch {
        /// The key or prefix.
        prefix: String,
    },
    /// The program has taken parts of the watch with this number, so more parts may be sent.
    Taken {
        /// How many more.
        parts: u32,
    },
    /// Ends the watch with this number.
    Cancel,
}

/// Changes of several keys, all of them or none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transaction {
    /// The reason, for the history.
    pub reason: String,
    /// The conditions of the transaction.
    pub requires: Vec<Requirement>,
    /// The writes. If several write the same key, the last one applies.
    pub writes: Vec<KeyWrite>,
}

/// A condition of a transaction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Requirement {
    /// The key whose state is expected.
    pub key: String,
    /// The expected state of the key.
    pub expected: Expected,
}

/// The state of a key that a transaction expects. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Expected {
    /// The key has no value.
    Absent,
    /// The key has a value.
    Exists,
    /// The key's value was written by this transaction, and no other write was concurrent.
    Version(TxnId),
}

/// A value for a key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyWrite {
    /// The key.
    pub key: String,
    /// The value; nothing to delete the key.
    pub value: Option<Stored>,
}

/// A value in its stored form: see [`Value`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// The type of the bytes.
    pub tag: u8,
    /// The bytes.
    pub bytes: Bytes,
}

/// The id of a transaction, and so the version of each key that it has written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TxnId {
    /// The replica that has committed the transaction.
    pub origin: u64,
    /// The number of the transaction at that replica, from 1.
    pub seq: u64,
}

impl fmt::Display for TxnId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}:{}", self.origin, self.seq)
    }
}

/// A key with the result of a read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// The key.
    pub key: String,
    /// The value; none if it was deleted.
    pub value: Option<Stored>,
    /// The transaction that has written the value.
    pub version: TxnId,
    /// Whether there was a concurrent write, and the conflict is not resolved.
    pub is_conflict: bool,
}

/// A committed transaction that changes watched keys.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Change {
    /// The id of the transaction.
    pub version: TxnId,
    /// The robot that has committed the transaction.
    pub by: String,
    /// The writer's reason for the transaction.
    pub reason: String,
    /// All writes of the transaction to watched keys.
    pub entries: Vec<Entry>,
}

/// An answer of the database to a program. Append only.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DatabaseAnswer {
    /// To `Get`: the entry; none if the key has no value.
    Value(Option<Entry>),
    /// To `Transact`: the transaction is on this robot's disk, and will be sent to all others.
    Committed(TxnId),
    /// Nothing was done.
    Refused(DatabaseRefusal),
    /// To `Watch`: the present values come next. They replace all earlier values of this watch.
    Begin,
    /// To `Watch`: some of the present values.
    Present(Vec<Entry>),
    /// To `Watch`: all present values were sent. Changes come next.
    Complete,
    /// To `Watch`: a transaction was committed, here or on another robot.
    Changed(Change),
    /// To `Transact`: the disk has failed, so it is unknown whether the transaction was committed.
    Unknown {
        /// Why, for a person.
        why: String,
    },
}

impl DatabaseAnswer {
    /// Returns whether the answer is a part of a watch, of which at most [`WINDOW`] may be on their way.
    pub const fn is_part(&self) -> bool {
        matches!(self, Self::Begin | Self::Present(_) | Self::Complete | Self::Changed(_))
    }
}

/// Why nothing was done. Append only.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum DatabaseRefusal {
    /// A key does not have its expected state: read the key again.
    #[error("{why}")]
    Unmet {
        /// The key.
        key: String,
        /// The actual state of the key, for people.
        why: String,
    },
    /// The program is not allowed to do this.
    #[error("{why}")]
    NotAllowed {
        /// The key or prefix.
        key: String,
        /// The rule, for a person.
        why: String,
    },
    /// Only another robot writes there.
    #[error("only the robot `{robot}` may write this key")]
    NotOwner {
        /// The name of the robot.
        robot: String,
    },
    /// A value or transaction is too long.
    #[error("{size} bytes are more than the {size_max} that are allowed; write the parts to separate keys")]
    TooLarge {
        /// The size of the value or transaction, in bytes.
        size: u64,
        /// The limit.
        size_max: u64,
    },
    /// Too many requests of this program have no answer yet.
    #[error("{waiting} requests of this program have no answer yet, which is the most; try again later")]
    Busy {
        /// How many.
        waiting: u32,
    },
    /// No node is running at present, so the request was not sent.
    #[error("the node is not connected, so no request was sent; try again when the node is back")]
    NoNode,
    /// The database's own words.
    #[error("{why}")]
    Database {
        /// For a person.
        why: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::codec;
    use crate::logic::control::{Notice, Order};

    fn ask(request: DatabaseRequest, golden: &str) {
        let notice = Notice::Database { number: 300, request };
        let bytes = codec::encode(&notice).unwrap();
        assert_eq!(hex(&bytes), format!("4443010002000bac02{golden}"), "{notice:?}");
        assert_eq!(codec::decode::<Notice>(&bytes), Ok(notice.clone()));
        assert!(!notice.is_counted());
    }

    fn answer(answer: DatabaseAnswer, golden: &str) {
        let order = Order::Database { number: 300, answer };
        let bytes = codec::encode(&order).unwrap();
        assert_eq!(hex(&bytes), format!("4443010001000eac02{golden}"), "{order:?}");
        assert_eq!(codec::decode::<Order>(&bytes), Ok(order.clone()));
        assert!(!order.is_counted());
    }

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    fn stored() -> Option<Stored> {
        Some(Stored { tag: 2, bytes: vec![1].into() })
    }

    fn entry() -> Entry {
        Entry { key: "k".into(), value: stored(), version: TxnId { origin: 300, seq: 2 }, is_conflict: true }
    }

    #[test]
    fn golden_requests() {
        ask(DatabaseRequest::Get { key: "k".into() }, "00016b");
        let require = |expected| Requirement { key: "k".into(), expected };
        let version = Expected::Version(TxnId { origin: 300, seq: 2 });
        let requires = [Expected::Absent, Expected::Exists, version].map(require).to_vec();
        let writes = [stored(), None].map(|value| KeyWrite { key: "j".into(), value }).to_vec();
        let transaction = Transaction { reason: "r".into(), requires, writes };
        ask(DatabaseRequest::Transact(transaction), "01017203016b00016b01016b02ac020202016a01020101016a00");
        ask(DatabaseRequest::Watch { prefix: "k/".into() }, "02026b2f");
        ask(DatabaseRequest::Taken { parts: 3 }, "0303");
        ask(DatabaseRequest::Cancel, "04");
    }

    #[test]
    fn golden_answers() {
        answer(DatabaseAnswer::Value(None), "0000");
        answer(DatabaseAnswer::Value(Some(entry())), "0001016b01020101ac020201");
        answer(DatabaseAnswer::Committed(TxnId { origin: 300, seq: 2 }), "01ac0202");
        answer(DatabaseAnswer::Begin, "03");
        answer(DatabaseAnswer::Present(vec![entry()]), "0401016b01020101ac020201");
        answer(DatabaseAnswer::Complete, "05");
        let (version, by) = (TxnId { origin: 300, seq: 2 }, "r1".to_owned());
        let change = Change { version, by, reason: "x".into(), entries: vec![entry()] };
        answer(DatabaseAnswer::Changed(change), "06ac0202027231017801016b01020101ac020201");
        answer(DatabaseAnswer::Unknown { why: "x".into() }, "070178");
    }

    #[test]
    fn golden_refusals() {
        let refused = |refusal, golden: &str| answer(DatabaseAnswer::Refused(refusal), &format!("02{golden}"));
        refused(DatabaseRefusal::Unmet { key: "k".into(), why: "x".into() }, "00016b0178");
        refused(DatabaseRefusal::NotAllowed { key: "k".into(), why: "x".into() }, "01016b0178");
        refused(DatabaseRefusal::NotOwner { robot: "r".into() }, "020172");
        refused(DatabaseRefusal::TooLarge { size: 300, size_max: 2 }, "03ac0202");
        refused(DatabaseRefusal::Busy { waiting: 3 }, "0403");
        refused(DatabaseRefusal::NoNode, "05");
        refused(DatabaseRefusal::Database { why: "x".into() }, "060178");
    }

    #[test]
    fn a_transaction_is_named_as_people_see_it() {
        assert_eq!(TxnId { origin: 0x9b01_c34e_5f6a_7788, seq: 3 }.to_string(), "9b01c34e5f6a7788:3");
    }
}
