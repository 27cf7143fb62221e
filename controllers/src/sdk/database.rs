//! The database of the robot for a controller: requests are sent after a calculation, and answered in a later one.
//!
//! A controller has one field for the database, in its struct of outputs. No method waits. A request goes to the node
//! after this calculation, over the control channel, so it also works on a robot without links to all others. Each
//! request has one answer. For a write, only [`Ok`] counts as success: then the write is on the disk of this robot, and
//! goes to all others. If it is unknown whether the write was committed, the answer is [`DatabaseError::Unknown`].
//!
//! ```
//! use controllers::sdk::{Database, Expected, Outputs, Transaction, Value};
//! use std::time::Duration;
//!
//! #[derive(Outputs)]
//! struct Outputs {
//!     #[database]
//!     database: Database,
//! }
//!
//! fn claim(outputs: &mut Outputs) -> u64 {
//!     // Nobody may have claimed the cup, and nobody does in between.
//!     let claim = Transaction::new("a free hand")
//!         .require("team/flat/claim/cup", Expected::Absent)
//!         .put("team/flat/claim/cup", Value::table([("by", "r1".into()), ("force", 4.5.into())]));
//!     outputs.database.transact(claim, Duration::from_secs(1))
//! }
//! ```

use comms::logic::bytes::Bytes;
use comms::logic::database::{
    DatabaseAnswer, DatabaseRequest, KeyWrite, REQUESTS_MAX, Requirement, Stored, TRANSACTION_SIZE_MAX, VALUE_SIZE_MAX,
    WATCHES_MAX,
};
use comms::logic::human::span;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;
use thiserror::Error;

pub use comms::logic::database::{Change, DatabaseRefusal, Entry, Expected, TxnId, Value, ValueError};

/// The name for [`About::triggered_by`](super::About::triggered_by) with which each answer of the database starts a
/// calculation.
pub(crate) const DATABASE: &str = "database";

/// The database, for one activation of a controller. It is a field of a struct of outputs, with `#[database]`.
#[derive(Debug, Default)]
pub struct Database {
    now: Time,
    made: u64,
    pending: BTreeMap<u64, Pending>,
    watches: BTreeSet<u64>,
    orders: Vec<DatabaseOrder>,
    values: VecDeque<(u64, Result<Option<Entry>, DatabaseError>)>,
    commits: VecDeque<(u64, Result<TxnId, DatabaseError>)>,
    news: VecDeque<(u64, WatchEvent)>,
}

/// A request without an answer.
#[derive(Clone, Copy, Debug)]
struct Pending {
    is_write: bool,
    within: Duration,
    until: Time,
}

/// Changes with their conditions. Either all changes are made, or none.
#[derive(Clone, Debug)]
pub struct Transaction {
    transaction: comms::logic::database::Transaction,
    problem: Option<DatabaseRefusal>,
}

/// Why a request has no result.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DatabaseError {
    /// Nothing was done.
    #[error("{0}")]
    Refused(#[from] DatabaseRefusal),
    /// The result is unknown: a transaction may have been committed. Read the keys to find out.
    #[error("{0}; the write may be committed")]
    Unknown(Unknown),
}

/// Why the result of a request is unknown.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Unknown {
    /// The time limit has passed.
    #[error("no answer within {}", span(*.within))]
    Deadline {
        /// The length of the wait.
        within: Duration,
    },
    /// The node was restarted while the request was in transit.
    #[error("the node was lost before it answered")]
    NodeLost,
    /// The disk failed during the write.
    #[error("{why}")]
    Disk {
        /// The reason that the database gave.
        why: String,
    },
}

/// An event of a watch. First come the present values, then each change. Whenever changes may have been missed, the
/// events start again with [`WatchEvent::Begin`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum WatchEvent {
    /// The present values come next. All earlier values of these keys are no longer valid.
    Begin,
    /// Some of the present values.
    Present(Vec<Entry>),
    /// All present values have been sent.
    Complete,
    /// A transaction was committed, on this robot or another one. The change is everything that the transaction has
    /// written to watched keys.
    Changed(Change),
    /// The watch is refused, so no events come.
    Refused(DatabaseRefusal),
}

/// An order about a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DatabaseOrder {
    /// Ask the node.
    Ask {
        /// The number of the request.
        number: u64,
        /// The request.
        request: DatabaseRequest,
    },
    /// The controller has taken one part of a watch, so another part may be sent.
    Taken {
        /// The number of its request.
        number: u64,
    },
    /// A watch is no longer wanted.
    Cancel {
        /// The number of its request.
        number: u64,
    },
}

impl Transaction {
    /// Returns a transaction without changes. The history shows `reason` to people.
    pub fn new(reason: impl Into<String>) -> Self {
        let transaction = comms::logic::database::Transaction { reason: reason.into(), ..Default::default() };
        Self { transaction, problem: None }
    }

    /// Adds a condition for a key. If the condition does not hold, nothing is done, and the answer is [`DatabaseRefusal::Unmet`].
    #[must_use]
    pub fn require(mut self, key: impl Into<String>, expected: Expected) -> Self {
        self.transaction.requires.push(Requirement { key: key.into(), expected });
        self
    }

    /// Adds a value. If a key gets several values, the last value is used.
    #[must_use]
    pub fn put(mut self, key: impl Into<String>, value: impl Into<Value>) -> Self {
        let value = value.into();
        if !value.is_shallow() {
            let why = "lists and tables are nested too deeply; write the parts to separate keys".to_owned();
            self.problem.get_or_insert(DatabaseRefusal::Database { why });
        }
        let value = Some(Stored::from(&value));
        self.transaction.writes.push(KeyWrite { key: key.into(), value });
        self
    }

    /// Adds a deletion.
    #[must_use]
    pub fn delete(mut self, key: impl Into<String>) -> Self {
        self.transaction.writes.push(KeyWrite { key: key.into(), value: None });
        self
    }

    /// Returns the transaction that changes one key.
    pub(super) fn of_one(key: String, value: Option<Stored>, expected: Option<Expected>) -> Self {
        let mut one = Self::new("");
        one.transaction.requires.extend(expected.map(|expected| Requirement { key: key.clone(), expected }));
        one.transaction.writes.push(KeyWrite { key, value });
        one
    }

    fn check(mut self) -> Result<comms::logic::database::Transaction, DatabaseRefusal> {
        let sizes = |write: &KeyWrite| write.value.as_ref().map_or(0, |Stored { bytes: Bytes(bytes), .. }| bytes.len());
        let longest = self.transaction.writes.iter().map(sizes).max().unwrap_or(0);
        let keys = self.transaction.requires.iter().map(|require| require.key.len());
        let writes = self.transaction.writes.iter().map(|write| write.key.len() + sizes(write));
        let all = keys.chain(writes).sum();
        for (size, size_max) in [(longest, VALUE_SIZE_MAX), (all, TRANSACTION_SIZE_MAX)] {
            if size > size_max {
                let number = |size| u64::try_from(size).unwrap_or(u64::MAX);
                return Err(DatabaseRefusal::TooLarge { size: number(size), size_max: number(size_max) });
            }
        }
        self.problem.take().map_or(Ok(self.transaction), Err)
    }
}

impl Database {
    /// Requests the value of a key; returns the number of the request. [`Database::value`] returns the answer.
    pub fn get(&mut self, key: impl Into<String>, within: Duration) -> u64 {
        self.ask(false, within, Ok(DatabaseRequest::Get { key: key.into() }))
    }

    /// Writes one key, if it is as `expected` or nothing is expected; returns the number of the request.
    /// [`Database::committed`] returns the answer.
    pub fn put(
        &mut self,
        key: impl Into<String>,
        value: impl Into<Value>,
        expected: Option<Expected>,
        within: Duration,
    ) -> u64 {
        let key = key.into();
        let transaction = Transaction::new("");
        let transaction = match expected {
            Some(expected) => transaction.require(key.clone(), expected),
            None => transaction,
        };
        self.transact(transaction.put(key, value), within)
    }

    /// Requests a transaction; returns the number of the request. [`Database::committed`] returns the answer.
    pub fn transact(&mut self, transaction: Transaction, within: Duration) -> u64 {
        self.ask(true, within, transaction.check().map(DatabaseRequest::Transact))
    }

    /// Watches a key, or the keys below a prefix that ends in `/`; returns the number of the watch. [`Database::event`]
    /// returns its events. The watch ends with the activation.
    pub fn watch(&mut self, prefix: impl Into<String>) -> u64 {
        self.made += 1;
        if self.watches.len() >= WATCHES_MAX {
            let why = format!("a program watches {WATCHES_MAX} keys or prefixes at a time at most");
            self.news.push_back((self.made, WatchEvent::Refused(DatabaseRefusal::Database { why })));
            return self.made;
        }
        self.watches.insert(self.made);
        let request = DatabaseRequest::Watch { prefix: prefix.into() };
        self.orders.push(DatabaseOrder::Ask { number: self.made, request });
        self.made
    }

    /// Cancels a watch. Events that were not read yet are dropped.
    pub fn unwatch(&mut self, number: u64) {
        if self.watches.remove(&number) {
            self.news.retain(|(of, _)| *of != number);
            self.orders.push(DatabaseOrder::Cancel { number });
        }
    }

    /// Returns the next answer to a `get`, with the number of the request: the value of the key, or none.
    pub fn value(&mut self) -> Option<(u64, Result<Option<Entry>, DatabaseError>)> {
        self.values.pop_front()
    }

    /// Returns the next answer to a `put` or `transact`, with the number of the request. Only [`Ok`] means that the
    /// transaction is committed; it contains the new version of all keys that were written.
    pub fn committed(&mut self) -> Option<(u64, Result<TxnId, DatabaseError>)> {
        self.commits.pop_front()
    }

    /// Returns the next event of a watch, with the number of the watch.
    pub fn event(&mut self) -> Option<(u64, WatchEvent)> {
        let (number, event) = self.news.pop_front()?;
        if !matches!(event, WatchEvent::Refused(_)) {
            self.orders.push(DatabaseOrder::Taken { number });
        }
        Some((number, event))
    }

    /// Returns how many requests have no answer yet, without watches.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    fn ask(&mut self, is_write: bool, within: Duration, request: Result<DatabaseRequest, DatabaseRefusal>) -> u64 {
        self.made += 1;
        let number = self.made;
        let waiting = u32::try_from(self.pending.len()).unwrap_or(u32::MAX);
        let busy = if self.pending.len() >= REQUESTS_MAX { Err(DatabaseRefusal::Busy { waiting }) } else { Ok(()) };
        match busy.and(request) {
            Ok(request) => {
                self.pending.insert(number, Pending { is_write, within, until: self.now + within });
                self.orders.push(DatabaseOrder::Ask { number, request });
            }
            Err(why) => self.fail(number, is_write, why.into()),
        }
        number
    }

    fn fail(&mut self, number: u64, is_write: bool, error: DatabaseError) {
        if is_write {
            self.commits.push_back((number, Err(error)));
        } else {
            self.values.push_back((number, Err(error)));
        }
    }

    /// Begins a calculation. If a request has waited for too long, its result becomes unknown.
    pub fn begin(&mut self, now: Time) {
        self.now = now;
        let late: Vec<(u64, Pending)> =
            self.pending.iter().filter(|(_, one)| one.until <= now).map(|(number, one)| (*number, *one)).collect();
        for (number, Pending { is_write, within, .. }) in late {
            self.pending.remove(&number);
            self.fail(number, is_write, DatabaseError::Unknown(Unknown::Deadline { within }));
        }
    }

    /// Takes the waiting orders, in order.
    pub fn take(&mut self) -> Vec<DatabaseOrder> {
        std::mem::take(&mut self.orders)
    }

    /// Takes an answer; an answer that is no longer expected is dropped.
    pub fn deliver(&mut self, number: u64, answer: Result<DatabaseAnswer, Unknown>) {
        if self.watches.contains(&number) {
            return self.deliver_news(number, answer);
        }
        let Some(Pending { is_write, .. }) = self.pending.remove(&number) else { return };
        match answer {
            Ok(DatabaseAnswer::Value(entry)) if !is_write => self.values.push_back((number, Ok(entry))),
            Ok(DatabaseAnswer::Committed(version)) if is_write => self.commits.push_back((number, Ok(version))),
            Ok(DatabaseAnswer::Refused(why)) => self.fail(number, is_write, why.into()),
            Ok(DatabaseAnswer::Unknown { why }) => {
                self.fail(number, is_write, DatabaseError::Unknown(Unknown::Disk { why }));
            }
            Err(why) => self.fail(number, is_write, DatabaseError::Unknown(why)),
            Ok(
                DatabaseAnswer::Value(_)
                | DatabaseAnswer::Committed(_)
                | DatabaseAnswer::Begin
                | DatabaseAnswer::Present(_)
                | DatabaseAnswer::Complete
                | DatabaseAnswer::Changed(_),
            ) => {
                let why = "unexpected answer from the node".to_owned();
                self.fail(number, is_write, DatabaseError::Unknown(Unknown::Disk { why }));
            }
        }
    }

    fn deliver_news(&mut self, number: u64, answer: Result<DatabaseAnswer, Unknown>) {
        let event = match answer {
            Ok(DatabaseAnswer::Begin) => WatchEvent::Begin,
            Ok(DatabaseAnswer::Present(entries)) => WatchEvent::Present(entries),
            Ok(DatabaseAnswer::Complete) => WatchEvent::Complete,
            Ok(DatabaseAnswer::Changed(change)) => WatchEvent::Changed(change),
            Ok(DatabaseAnswer::Refused(why)) => {
                self.watches.remove(&number);
                WatchEvent::Refused(why)
            }
            Ok(DatabaseAnswer::Value(_) | DatabaseAnswer::Committed(_) | DatabaseAnswer::Unknown { .. }) | Err(_) => {
                return;
            }
        };
        self.news.push_back((number, event));
    }
}

/// A field with `#[database]`. Only [`Database`] implements this trait.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not the database",
    label = "expected `Database`",
    note = "a field with `#[database]` is a `Database`"
)]
pub trait DatabasePort: Default {
    /// Returns the database.
    fn database(&mut self) -> &mut Database;
}

impl DatabasePort for Database {
    fn database(&mut self) -> &mut Database {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WITHIN: Duration = Duration::from_secs(1);

    fn version() -> TxnId {
        TxnId { origin: 1, seq: 2 }
    }

    fn asked(database: &mut Database) -> Vec<u64> {
        let number = |order| if let DatabaseOrder::Ask { number, .. } = order { Some(number) } else { None };
        database.take().into_iter().filter_map(number).collect()
    }

    #[test]
    fn only_a_commit_is_success_and_what_is_late_is_unknown() {
        let mut database = Database::default();
        let mut ends = |answer: Result<DatabaseAnswer, Unknown>| {
            let number = database.put("team/a", 1, Some(Expected::Absent), WITHIN);
            database.deliver(number, answer);
            let (of, result) = database.committed().unwrap();
            assert_eq!(of, number);
            result
        };
        assert_eq!(ends(Ok(DatabaseAnswer::Committed(version()))), Ok(version()));
        let refusal = DatabaseRefusal::Unmet { key: "team/a".into(), why: "it has a value".into() };
        let refused = ends(Ok(DatabaseAnswer::Refused(refusal.clone())));
        assert_eq!(refused, Err(DatabaseError::Refused(refusal)));
        assert_eq!(ends(Err(Unknown::NodeLost)), Err(DatabaseError::Unknown(Unknown::NodeLost)));
        for other in
            [DatabaseAnswer::Value(None), DatabaseAnswer::Complete, DatabaseAnswer::Unknown { why: "x".into() }]
        {
            assert!(matches!(ends(Ok(other.clone())), Err(DatabaseError::Unknown(_))), "{other:?}");
        }
        let number = database.put("team/a", 1, None, WITHIN);
        database.begin(Time::ZERO + WITHIN);
        let (of, late) = database.committed().unwrap();
        let words = "no answer within 1 s; the write may be committed";
        assert_eq!((of, late.unwrap_err().to_string().as_str()), (number, words));
        database.deliver(number, Ok(DatabaseAnswer::Committed(version())));
        assert_eq!(database.committed(), None);
    }

    #[test]
    fn what_is_too_much_is_refused_at_once() {
        let mut database = Database::default();
        let large = vec![0_u8; VALUE_SIZE_MAX + 1];
        database.put("team/a", large, None, WITHIN);
        let (_, refused) = database.committed().unwrap();
        assert!(matches!(refused, Err(DatabaseError::Refused(DatabaseRefusal::TooLarge { .. }))), "{refused:?}");
        let deep = (0..40).fold(Value::Bool(true), |inner, _| Value::List(vec![inner]));
        database.put("team/a", deep, None, WITHIN);
        assert!(database.committed().unwrap().1.unwrap_err().to_string().contains("too deep"));
        for _ in 0..=REQUESTS_MAX {
            database.get("team/a", WITHIN);
        }
        let (_, busy) = database.value().unwrap();
        assert!(matches!(busy, Err(DatabaseError::Refused(DatabaseRefusal::Busy { .. }))), "{busy:?}");
        for _ in 0..=WATCHES_MAX {
            database.watch("team/");
        }
        assert!(matches!(database.event(), Some((_, WatchEvent::Refused(_)))));
        assert_eq!(asked(&mut database).len(), REQUESTS_MAX + WATCHES_MAX);
    }

    #[test]
    fn a_watch_brings_its_events_until_it_is_ended() {
        let mut database = Database::default();
        let watch = database.watch("team/");
        let parts = [DatabaseAnswer::Begin, DatabaseAnswer::Present(vec![]), DatabaseAnswer::Complete];
        parts.into_iter().for_each(|part| database.deliver(watch, Ok(part)));
        let events = [WatchEvent::Begin, WatchEvent::Present(vec![])];
        for event in events {
            assert_eq!(database.event(), Some((watch, event)));
        }
        let taken = database.take().into_iter().filter(|order| *order == DatabaseOrder::Taken { number: watch });
        assert_eq!(taken.count(), 2);
        database.unwatch(watch);
        database.deliver(watch, Ok(DatabaseAnswer::Complete));
        assert_eq!(database.event(), None);
        assert_eq!(database.take().last(), Some(&DatabaseOrder::Cancel { number: watch }));
    }

    proptest! {
        /// Each request has exactly one answer, whatever messages arrive, and whenever they arrive.
        #[test]
        fn each_request_has_one_answer(steps in prop::collection::vec((0..4_u8, 0..40_u64), 0..200)) {
            let (mut database, mut now, mut made, mut told) = (Database::default(), Time::ZERO, 0, Vec::new());
            for (step, number) in steps {
                match step {
                    0 => made = database.put("team/a", 1, None, WITHIN),
                    1 => made = database.get("team/a", WITHIN),
                    2 => database.deliver(number, Ok(DatabaseAnswer::Committed(version()))),
                    _ => {
                        now = now + WITHIN / 4;
                        database.begin(now);
                    }
                }
                told.extend(database.committed().map(|(number, _)| number));
                told.extend(database.value().map(|(number, _)| number));
                prop_assert!(database.pending() <= REQUESTS_MAX);
            }
            database.begin(now + 2 * WITHIN);
            told.extend(std::iter::from_fn(|| database.committed()).map(|(number, _)| number));
            told.extend(std::iter::from_fn(|| database.value()).map(|(number, _)| number));
            told.sort_unstable();
            prop_assert_eq!(told, (1..=made).collect::<Vec<_>>());
        }
    }
}
