//! The signed heads of audit logs that a member stores: its signatures on the logs of others, and the signatures of others on its own
//! log.
//!
//! A member signs the position of another member's log. Afterwards it never signs an earlier position, nor a different record with the
//! same number. So if the end of a log is cut off or rewritten, signatures on the disks of others contradict it. For each log and
//! signer, some heads from all times are kept. So a log that was rewritten, and has grown since, does not match the old heads.

use crate::audit::{Head, Position};
use crate::identity::{KeyId, SecretKeys};
use crate::name::{Name, UnixTime};
use std::collections::BTreeMap;
use thiserror::Error;

/// The most heads of one log by one signer. If there are more, the head whose neighbours are closest in time is dropped.
pub const HEADS_MAX: usize = 8;
/// The most pairs of a log and a signer.
pub const PAIRS_MAX: usize = 512;
/// The most bytes of the text of all.
pub const TEXT_MAX: usize = 1 << 20;

/// Why a head is not signed or stored.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum HeadError {
    /// The log was cut, or set back.
    #[error(
        "its log ends with record {found}, but record {signed} was signed: the log was cut off, or an old copy was restored"
    )]
    Cut {
        /// The last record now.
        found: u64,
        /// The last record that this member has signed.
        signed: u64,
    },
    /// The log was rewritten.
    #[error("record {number} of its log differs from the signed record")]
    Rewritten {
        /// The record.
        number: u64,
    },
    /// The node of the log has signed a later head, so this one is an old copy.
    #[error("its node has already signed a later head")]
    Old,
    /// The table is full.
    #[error("no more than {PAIRS_MAX} pairs of a log and a signer are kept")]
    Full,
    /// A line of the text is not a head.
    #[error("line {line} is not a signed head of an audit log")]
    Line {
        /// The line, from 1.
        line: usize,
    },
}

/// The heads that a member stores.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Heads(BTreeMap<(KeyId, KeyId), Signed>);

/// The heads of one log by one signer, in the order of their numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Signed {
    /// The name of the signer at that time.
    name: Name,
    heads: Vec<Head>,
}

impl Heads {
    /// Signs the position of another node's log, which that node has signed as `told`. If this member has already signed the same
    /// position, the existing head is returned. Returns the head, and whether it is new. The node's latest own head is stored as well,
    /// and copies of earlier ones are refused. So an old copy of a head does not make the log look cut off. A log that has grown is
    /// always signed: the clock of its node may have been ahead, and set right since.
    ///
    /// # Errors
    /// If this member has signed a contradicting state of that log, the node has signed a later head, or the table is full.
    pub fn countersign(
        &mut self,
        told: &Head,
        of: &Name,
        at: UnixTime,
        name: &Name,
        keys: &SecretKeys,
    ) -> Result<(Head, bool), HeadError> {
        let position = told.position();
        let own = self.0.get(&(position.log, told.by())).map_or(&[][..], |signed| &signed.heads);
        let is_copy = |latest: &Head| told.at() <= latest.at() || own.contains(told);
        if own.last().is_some_and(|latest| position.number < latest.position().number && is_copy(latest)) {
            return Err(HeadError::Old);
        }
        let pair = (position.log, keys.public().id());
        if let Some(last) = self.0.get(&pair).and_then(|signed| signed.heads.last()) {
            let Position { number, hash, .. } = last.position();
            if position.number < number {
                return Err(HeadError::Cut { found: position.number, signed: number });
            }
            if position.number == number {
                let is_same = position.hash == hash;
                return is_same.then(|| (last.clone(), false)).ok_or(HeadError::Rewritten { number });
            }
        }
        let head = Head::sign(position, at, keys);
        self.keep(told.clone(), of)?;
        self.keep(head.clone(), name).map(|_is_new| (head, true))
    }

    /// Stores a head that a member has signed. Returns whether it is new.
    ///
    /// # Errors
    /// If the table is full.
    pub fn keep(&mut self, head: Head, name: &Name) -> Result<bool, HeadError> {
        let (pair, number) = ((head.position().log, head.by()), head.position().number);
        if self.0.len() >= PAIRS_MAX && !self.0.contains_key(&pair) {
            return Err(HeadError::Full);
        }
        let signed = self.0.entry(pair).or_insert_with(|| Signed { name: name.clone(), heads: Vec::new() });
        if signed.heads.last().is_some_and(|last| last.position().number >= number) {
            return Ok(false);
        }
        name.clone_into(&mut signed.name);
        signed.heads.push(head);
        if signed.heads.len() > HEADS_MAX {
            signed.heads.remove(crowded(&signed.heads));
        }
        Ok(true)
    }

    /// Returns the heads of a log, with the name of each signer.
    pub fn of(&self, log: KeyId) -> impl Iterator<Item = (&Name, &Head)> {
        let signed = self.0.iter().filter(move |((of, _), _)| *of == log);
        signed.flat_map(|(_, signed)| signed.heads.iter().map(|head| (&signed.name, head)))
    }

    /// Returns the heads as text: each line has a head and the name of its signer.
    pub fn to_text(&self) -> String {
        let lines = self.0.values().flat_map(|signed| signed.heads.iter().map(|head| (&signed.name, head)));
        lines.map(|(name, head)| format!("{} {name}\n", head.to_text())).collect()
    }

    /// Reads the text of [`Heads::to_text`], and checks the signatures. The caller has to check that the signers are members.
    ///
    /// # Errors
    /// If a line is not a head, or there are too many.
    pub fn from_text(text: &str) -> Result<Self, HeadError> {
        let mut heads = Self::default();
        for (index, line) in text.lines().enumerate() {
            let (head, name) = line.split_once(' ').ok_or(HeadError::Line { line: index + 1 })?;
            let read = Head::from_text(head).ok().zip(name.parse().ok());
            let (head, name) = read.ok_or(HeadError::Line { line: index + 1 })?;
            heads.keep(head, &name)?;
        }
        Ok(heads)
    }
}

/// Returns the index of the least useful head: the head with the shortest time between its neighbours. The first and the last head are
/// always kept.
fn crowded(heads: &[Head]) -> usize {
    let between = |place: &usize| heads[place + 1].at().since(heads[place - 1].at());
    (1..heads.len() - 1).min_by_key(between).unwrap_or_default()
}
