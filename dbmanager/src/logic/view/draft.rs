//! A draft: the changes and conditions of a caller, before they have a position in history.

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
    /// The owner of the prefix gives it to a robot, or releases it. If it has no owner, any robot may do so.
    Give(Option<String>),
    /// An operator takes the prefix from its owner, and gives it to a robot.
    TakeOver(String),
}

/// Why nothing was committed. The state is unchanged.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TxnError {
    /// A condition does not hold here.
    #[error("`{key}` is required to {condition}, but {}", crate::logic::view::past::written_by(actual))]
    Precondition {
        /// The key of the condition.
        key: Key,
        /// The condition.
        condition: Condition,
        /// The writers of the present versions, including concurrent ones, but without deletions.
        actual: Vec<Dot>,
    },
    /// A value is too long.
    #[error("the value of `{key}` has {size} bytes, more than {VALUE_SIZE_MAX}")]
    Value {
        /// The key of the value.
        key: Key,
        /// The size of the value in bytes.
        size: usize,
    },
    /// Too many writes or conditions, or a reason that is too long.
    #[error("a transaction has {count} {what}, more than {limit}{}", way_out(what))]
    Limit {
        /// The part that exceeds its limit.
        what: &'static str,
        /// How much.
        count: usize,
        /// The limit.
        limit: usize,
    },
    /// Too long as a whole.
    #[error("the transaction does not fit")]
    Codec(#[from] CodecError),
    /// The prefix belongs to another robot; the transaction can be tried there.
    #[error("`{key}` may only be written on the robot `{owner}`")]
    NotOwner {
        /// The key.
        key: Key,
        /// The owner of the prefix.
        owner: String,
        /// The term of the owner's grant.
        term: u64,
    },
    /// Transactions must not write this namespace.
    #[error("`{key}` is in a namespace that transactions cannot write")]
    Reserved {
        /// The key.
        key: Key,
    },
    /// The clock has no timestamp left.
    #[error("the clock has come to its end: a peer has sent a timestamp that no correct clock can have issued")]
    Clock,
    /// No member of the team would accept the transaction.
    #[error("nothing was written: {why}")]
    Unproven {
        /// Why, for a person.
        why: String,
    },
    /// The key never leaves the robot, so no other robot can have the transaction.
    #[error("`{key}` stays on this robot, so no other robot can have it")]
    Stays {
        /// The key.
        key: Key,
    },
}

/// Returns the advice for a part that exceeds its limit.
fn way_out(what: &str) -> &'static str {
    match what {
        "writes" => "; write them in several transactions, as `dca db import` does with a long file",
        "conditions" => "; use fewer conditions, or several transactions",
        _ => "",
    }
}

impl Draft {
    /// Returns a draft without changes; `reason` is the reason of the transaction.
    pub fn new(reason: impl Into<String>) -> Self {
        Self { reason: reason.into(), requires: Vec::new(), writes: BTreeMap::new(), grants: BTreeMap::new() }
    }

    /// Adds a condition.
    #[must_use]
    pub fn require(mut self, key: Key, condition: Condition) -> Self {
        self.requires.push(Require { key, condition });
        self
    }

    /// Adds a value. If several are added at one key, the last one applies.
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

    /// Returns the grants in the draft, with their prefixes.
    pub fn grants(&self) -> impl Iterator<Item = (&Key, &Grant)> {
        self.grants.iter()
    }

    /// Returns whether the draft writes only local keys, which never leave the robot.
    pub fn is_local(&self) -> bool {
        let local = |key: &Key| key.namespace() == Namespace::Local;
        self.grants.is_empty() && !self.writes.is_empty() && self.writes.keys().all(local)
    }

    /// Returns the writes of the draft.
    pub fn writes(&self) -> impl Iterator<Item = (&Key, Option<&Value>)> {
        self.writes.iter().map(|(key, value)| (key, value.as_ref()))
    }

    /// Returns the conditions of the draft.
    pub fn requires(&self) -> &[Require] {
        &self.requires
    }

    /// Checks the limits of the draft.
    ///
    /// # Errors
    /// If the draft exceeds a limit.
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

    /// Splits the draft into reason, conditions, and writes by key.
    pub fn into_parts(self) -> (String, Vec<Require>, Vec<Write>) {
        let writes = self.writes.into_iter().map(|(key, value)| Write { key, value }).collect();
        (self.reason, self.requires, writes)
    }
}
