//! A draft: the changes and conditions of a caller, before they have a place in history.

use crate::logic::key::{Key, Namespace};
use crate::logic::txn::{CHANGES_MAX, CodecError, Condition, REASON_SIZE_MAX, Require, VALUE_SIZE_MAX, Value, Write};
use crate::logic::version_vector::Dot;
use std::collections::BTreeMap;
use thiserror::Error;

/// The changes and conditions of a transaction that is not committed yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Draft {
    reason: String,
    requires: Vec<Require>,
    writes: BTreeMap<Key, Option<Value>>,
    grants: BTreeMap<Key, Grant>,
}

/// The new owner of a prefix.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Grant {
    /// The owner of the prefix, or any robot if it has no owner, gives it to a robot, or releases it.
    Give(Option<String>),
    /// An operator takes it from its owner, and gives it to a robot.
    TakeOver(String),
}

/// Why nothing was committed. The state is as if the transaction had not been tried.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TxnError {
    /// A condition does not hold here.
    #[error("`{key}` is required to {condition}, but {}", crate::logic::view::past::written_by(actual))]
    Precondition {
        /// Of which key.
        key: Key,
        /// The condition.
        condition: Condition,
        /// The writers of the present versions, siblings included, deletions left out.
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
    #[error("a transaction has {count} {what}, more than {limit}{}", way_out(what))]
    Limit {
        /// The kind of thing of which there is too much.
        what: &'static str,
        /// How much.
        count: usize,
        /// How much is allowed.
        limit: usize,
    },
    /// Too long as a whole.
    #[error("the transaction does not fit")]
    Codec(#[from] CodecError),
    /// The prefix belongs to another robot, on which the transaction can be tried.
    #[error("`{key}` may only be written on the robot `{owner}`")]
    NotOwner {
        /// The key.
        key: Key,
        /// The owner of the prefix.
        owner: String,
        /// The term of the owner's grant.
        term: u64,
    },
    /// The namespace is not written by transactions.
    #[error("`{key}` is in a namespace that transactions cannot write")]
    Reserved {
        /// The key.
        key: Key,
    },
    /// The clock has no timestamp left.
    #[error("the clock has come to its end: a peer has sent a timestamp that no correct clock can have issued")]
    Clock,
    /// No member of the team would take it over.
    #[error("nothing was written: {why}")]
    Unproven {
        /// Why, for a person.
        why: String,
    },
    /// The key never leaves the robot, so no other robot can have it.
    #[error("`{key}` stays on this robot, so no other robot can have it")]
    Stays {
        /// The key.
        key: Key,
    },
}

/// Returns the advice for too much of something.
fn way_out(what: &str) -> &'static str {
    match what {
        "writes" => "; write them in several transactions, as `dca db import` does with a long file",
        "conditions" => "; use fewer conditions, or several transactions",
        _ => "",
    }
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

    /// Gives a prefix such as `team/arm` to a robot: see [`owner`](crate::logic::owner).
    #[must_use]
    pub fn grant(mut self, prefix: Key, grant: Grant) -> Self {
        self.grants.insert(prefix, grant);
        self
    }

    /// Returns the prefixes that it gives away.
    pub fn grants(&self) -> impl Iterator<Item = (&Key, &Grant)> {
        self.grants.iter()
    }

    /// Returns whether it only writes local keys, which never leave the robot.
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
