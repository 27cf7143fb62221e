//! The audit log: all attempts as a chain. Each record has the hash of all previous records, and other members sign
//! the position of the log.
//!
//! A log is a text of lines. The first line names the team and the node of the log, and the log that it continues.
//! The fields of a record are separated by tabs: number, time, decision, client, action, request, reason, hash. A record
//! that was changed, removed or inserted breaks the chain. If records were cut off at the end, a signed head that
//! covers them proves that they existed.

use crate::identity::{KeyId, PUBLIC_LEN, PublicKeys, SIGNATURE_LEN, SecretKeys};
use crate::name::UnixTime;
use crate::text::{self, TextError, decode, encode};
use crate::wire::{FormError, Reader, Writer};
use std::collections::BTreeMap;
use thiserror::Error;

/// The longest line, in bytes.
pub const LINE_MAX: usize = 4096;
/// The longest field of a record, in characters. A longer field is cut.
pub const FIELD_MAX: usize = 256;
/// The most heads with which a log is compared.
pub const HEADS_MAX: usize = 1 << 16;

const BEGIN: &str = "dca-audit 1";
const HEAD: &str = "dca audit head 1";
const HEAD_TEXT: &str = "dca-head1-";
const HEAD_LEN_MAX: usize = 512;
const DECISIONS: [Decision; 5] =
    [Decision::Done, Decision::Refused, Decision::Accepted, Decision::Failed, Decision::Unknown];

/// The result of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// The action was carried out.
    Done,
    /// The action was refused: the client has no right to it.
    Refused,
    /// The client has the right to the action. The outcome is a separate record.
    Accepted,
    /// The action was accepted, but failed.
    Failed,
    /// The action was accepted, but the node does not know the outcome.
    Unknown,
}

impl Decision {
    const fn text(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Refused => "refused",
            Self::Accepted => "accepted",
            Self::Failed => "failed",
            Self::Unknown => "unknown",
        }
    }
}

/// The record of one request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry<'a> {
    /// The time of the request.
    pub at: UnixTime,
    /// The decision about the request.
    pub decision: Decision,
    /// The client that made the request, as far as known.
    pub who: &'a str,
    /// The requested action.
    pub what: &'a str,
    /// The request's id.
    pub request: [u8; 16],
    /// Why the request was refused or failed; otherwise empty.
    pub reason: &'a str,
}

/// The end of a log, to which records can be added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Log {
    /// The node of the log.
    node: KeyId,
    team: KeyId,
    /// The number of the first record.
    first: u64,
    /// The number of the next record.
    next: u64,
    hash: [u8; 32],
}

/// The first mistake in a log, with its line.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AuditError {
    /// The first line is not the first line of a log.
    #[error("line 1 is not the beginning of an audit log")]
    Begin,
    /// A line is not a record.
    #[error("line {line} is not a record of an audit log")]
    Record {
        /// The line, from 1.
        line: u64,
    },
    /// The number of a record does not follow the number of the previous record.
    #[error("line {line} has record {found} where record {expected} belongs")]
    Number {
        /// The line, from 1.
        line: u64,
        /// The number in the record.
        found: u64,
        /// The expected number.
        expected: u64,
    },
    /// A record does not match the previous ones: this record or one of them was changed.
    #[error("line {line}, record {number}, does not fit the line before it")]
    Hash {
        /// The line, from 1.
        line: u64,
        /// The record.
        number: u64,
    },
    /// A record differs from the record that a member has signed.
    #[error("record {number} differs from the record that {by} has signed")]
    Forked {
        /// The record.
        number: u64,
        /// The signer of another record.
        by: KeyId,
    },
    /// Records are missing at the end.
    #[error("the log ends with {last}, but {by} has signed record {number}")]
    Truncated {
        /// The number of the last present record, or `nothing`.
        last: String,
        /// The last record that a member has signed.
        number: u64,
        /// The signer.
        by: KeyId,
    },
    /// The heads belong to another log.
    #[error("a signed head is of another log")]
    OtherLog,
    /// There are too many heads.
    #[error("no more than {HEADS_MAX} heads can be compared at once")]
    TooManyHeads,
}

impl Log {
    /// Begins a log; returns it with its first line. `before` is the end of the log that it continues; none for the
    /// first log of a node.
    pub fn begin(team: KeyId, node: KeyId, before: Option<&Self>) -> (Self, String) {
        let (first, previous) = before.map_or((1, [0; 32]), |log| (log.next, log.hash));
        let line = format!("{BEGIN} {} {} {first} {}", encode(&team.0), encode(&node.0), encode(&previous));
        let hash = blake3::derive_key("dca audit begin 1", line.as_bytes());
        (Self { node, team, first, next: first, hash }, line)
    }

    /// Returns the node of a log that begins with this line; none if it is not the first line of a log.
    #[must_use]
    pub fn node_of(line: &str) -> Option<KeyId> {
        begin(line).map(|(log, _)| log.node)
    }

    /// Adds a record; returns its line.
    pub fn add(&mut self, entry: &Entry<'_>) -> String {
        let decision = entry.decision.text();
        let mut line = format!("{}\t{}\t{decision}", self.next, entry.at.0);
        for text in [entry.who, entry.what, &encode(&entry.request), entry.reason] {
            line.push('\t');
            push_field(&mut line, text);
        }
        self.hash = chained(&self.hash, &line);
        self.next += 1;
        line + "\t" + &encode(&self.hash)
    }

    /// Returns the number of the last record; 0 if the log never had one.
    #[must_use]
    pub const fn last(&self) -> u64 {
        self.next - 1
    }

    /// Returns the team and the node of the log.
    #[must_use]
    pub const fn of(&self) -> (KeyId, KeyId) {
        (self.team, self.node)
    }

    /// Signs the position of the log.
    pub fn countersign(&self, at: UnixTime, member: &SecretKeys) -> Head {
        Head::sign(Position { log: self.node, number: self.next - 1, hash: self.hash }, at, member)
    }

    /// Returns the position of the log; none without a record.
    #[must_use]
    pub const fn position(&self) -> Option<Position> {
        let (log, number, hash) = (self.node, self.next - 1, self.hash);
        if self.next > self.first { Some(Position { log, number, hash }) } else { None }
    }
}

/// The position of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Position {
    /// The node of the log.
    pub log: KeyId,
    /// The number of the last record.
    pub number: u64,
    /// The hash of all records up to and including the last one.
    pub hash: [u8; 32],
}

/// A position of a log at some time, signed by a member.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Head {
    log: KeyId,
    number: u64,
    hash: [u8; 32],
    at: UnixTime,
    by: PublicKeys,
    signature: [u8; SIGNATURE_LEN],
}

impl Head {
    /// Signs the position of a log.
    pub fn sign(Position { log, number, hash }: Position, at: UnixTime, member: &SecretKeys) -> Self {
        let mut head = Self { log, number, hash, at, by: *member.public(), signature: [0; SIGNATURE_LEN] };
        head.signature = member.sign(&head.form());
        head
    }

    /// Returns the position of the log.
    #[must_use]
    pub const fn position(&self) -> Position {
        Position { log: self.log, number: self.number, hash: self.hash }
    }

    /// Returns the signer. The caller has to check that the signer is a member.
    pub fn by(&self) -> KeyId {
        self.by.id()
    }

    /// Returns the time of the signature, by the member's clock.
    #[must_use]
    pub const fn at(&self) -> UnixTime {
        self.at
    }

    fn form(&self) -> Vec<u8> {
        let mut writer = Writer::new(HEAD);
        writer.fixed(&self.log.0);
        writer.u64(self.number);
        writer.fixed(&self.hash);
        writer.u64(self.at.0);
        writer.fixed(&self.by.to_bytes());
        writer.finish()
    }

    /// Returns the bytes of the head in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.form();
        bytes.extend_from_slice(&self.signature);
        bytes
    }

    /// Returns the head as one word, `dca-head1-…`.
    #[must_use]
    pub fn to_text(&self) -> String {
        text::with_sum(HEAD_TEXT, &self.to_bytes())
    }

    /// Reads the text of [`Head::to_text`], and checks its signature.
    ///
    /// # Errors
    /// If the text is not a head.
    pub fn from_text(text: &str) -> Result<Self, TextError> {
        let bytes = text::without_sum(HEAD_TEXT, text)?;
        Self::from_bytes(&bytes).map_err(|_no_head| TextError::Checksum)
    }

    /// Reads the bytes of a head, and checks its signature.
    ///
    /// # Errors
    /// If the bytes are not a head, or not signed by the named signer.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, HEAD, HEAD_LEN_MAX)?;
        let (log, number) = (KeyId(reader.fixed()?), reader.u64()?);
        let (hash, at) = (reader.fixed()?, UnixTime(reader.u64()?));
        let by = PublicKeys::from_bytes(&reader.fixed::<PUBLIC_LEN>()?)?;
        let signature = reader.fixed()?;
        reader.finish()?;
        let head = Self { log, number, hash, at, by, signature };
        if by.has_signed(&head.form(), &signature) { Ok(head) } else { Err(FormError::Field("signature")) }
    }
}

/// Reads a log line by line, and compares it with heads.
#[derive(Debug)]
pub struct Verifier {
    log: Option<Log>,
    line: u64,
    first: u64,
    heads: BTreeMap<u64, Vec<Head>>,
}

impl Verifier {
    /// Begins to verify a log.
    ///
    /// # Errors
    /// If there are too many heads.
    pub fn new(heads: Vec<Head>) -> Result<Self, AuditError> {
        if heads.len() > HEADS_MAX {
            return Err(AuditError::TooManyHeads);
        }
        let mut by_number: BTreeMap<u64, Vec<Head>> = BTreeMap::new();
        for head in heads {
            by_number.entry(head.number).or_default().push(head);
        }
        Ok(Self { log: None, line: 0, first: 0, heads: by_number })
    }

    /// Takes the next line, without its line feed.
    ///
    /// # Errors
    /// If the line does not fit. Lines after it cannot be verified.
    pub fn line(&mut self, line: &str) -> Result<(), AuditError> {
        self.line += 1;
        let Some(log) = &mut self.log else {
            let (log, before) = begin(line).ok_or(AuditError::Begin)?;
            if self.heads.values().flatten().any(|head| head.log != log.node) {
                return Err(AuditError::OtherLog);
            }
            self.first = log.next;
            self.log = Some(log);
            // A signature on the last record of the previous log also covers the position from which this log
            // continues.
            return before.map_or(Ok(()), |before| self.compare(before));
        };
        let at = self.line;
        let (found, hash, body) = record(line).ok_or(AuditError::Record { line: at })?;
        if found != log.next {
            return Err(AuditError::Number { line: at, found, expected: log.next });
        }
        let expected = chained(&log.hash, body);
        if hash != expected {
            return Err(AuditError::Hash { line: at, number: found });
        }
        log.next = found.checked_add(1).ok_or(AuditError::Record { line: at })?;
        log.hash = expected;
        let position = Position { log: log.node, number: found, hash: expected };
        self.compare(position)
    }

    fn compare(&self, Position { number, hash, .. }: Position) -> Result<(), AuditError> {
        let mut signed = self.heads.get(&number).into_iter().flatten();
        match signed.find(|head| head.hash != hash) {
            Some(other) => Err(AuditError::Forked { number, by: other.by() }),
            None => Ok(()),
        }
    }

    /// Finishes the verification; returns the end of the log, to which records can be added.
    ///
    /// # Errors
    /// If the log has no first line, or records that members have signed are missing at the end.
    pub fn finish(self) -> Result<Log, AuditError> {
        let log = self.log.ok_or(AuditError::Begin)?;
        match self.heads.last_key_value() {
            Some((number, heads)) if *number >= log.next => {
                let last =
                    if log.next == self.first { "nothing".to_owned() } else { format!("record {}", log.next - 1) };
                Err(AuditError::Truncated { last, number: *number, by: heads[0].by() })
            }
            _ => Ok(log),
        }
    }
}

/// Returns a log with this first line, and the position at the end of the previous log, if there is one.
fn begin(line: &str) -> Option<(Log, Option<Position>)> {
    let mut fields = line.strip_prefix(BEGIN)?.strip_prefix(' ')?.split(' ');
    let mut id = || <[u8; 32]>::try_from(decode(fields.next()?).ok()?).ok();
    let (team, node) = (KeyId(id()?), KeyId(id()?));
    let next: u64 = fields.next()?.parse().ok().filter(|first| *first > 0)?;
    let hash = <[u8; 32]>::try_from(decode(fields.next()?).ok()?).ok()?;
    // The line, written again, has to be the same, so that each log has only one form.
    let (log, again) = Log::begin(team, node, Some(&Log { node, team, first: next, next, hash }));
    let before = (next > 1).then_some(Position { log: node, number: next - 1, hash });
    (again == line).then_some((log, before))
}

/// Returns the number of a record, its hash, and the hashed text.
fn record(line: &str) -> Option<(u64, [u8; 32], &str)> {
    let (body, hash) = line.rsplit_once('\t').filter(|_| line.len() <= LINE_MAX)?;
    // The decoder also accepts look-alike letters, but a record has only one form.
    let hash = <[u8; 32]>::try_from(decode(hash).ok()?).ok().filter(|read| encode(read) == hash)?;
    let fields: Vec<&str> = body.split('\t').collect();
    let &[number, at, decision, _, _, _, _] = fields.as_slice() else { return None };
    at.parse::<u64>().ok()?;
    DECISIONS.iter().find(|known| known.text() == decision)?;
    Some((number.parse().ok()?, hash, body))
}

fn chained(previous: &[u8; 32], line: &str) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new_derive_key("dca audit record 1");
    hasher.update(previous);
    hasher.update(line.as_bytes());
    *hasher.finalize().as_bytes()
}

/// Adds a field. Characters that would end it, or move the cursor of a terminal, are replaced.
fn push_field(line: &mut String, text: &str) {
    for character in text.chars().take(FIELD_MAX) {
        if character.is_control() || character == '\u{2028}' || character == '\u{2029}' {
            line.push('\u{fffd}');
        } else {
            line.push(character);
        }
    }
    if text.chars().nth(FIELD_MAX).is_some() {
        line.push('…');
    }
}
