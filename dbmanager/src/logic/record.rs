//! What a replica keeps on its disk: records, written in batches that are there as a whole or not at all. Each ends with a
//! sum of its name and its bytes. What every transaction changes has names that follow each other, as far as it can: so it lies in
//! one page of the store.
//!
//! | record | holds |
//! |---|---|
//! | `i` | identity: origin, robot, what was given up |
//! | `s` | digests of cut and state, how many frames and keys there are: to notice a damaged disk |
//! | `l` origin number | a frame, and its place in the order of application |
//! | `k` key | the versions of a key |
//! | `p` key | the version of a key that never leaves the robot |
//! | `o` index | a frame that cannot be read yet |
//! | `t` origin | the head of an origin: the tip of its frames |

use crate::logic::cut::{Dot, Origin};
use crate::logic::key::Key;
use crate::logic::log::{Head, Log, Logged};
use crate::logic::mutant::Mutant;
use crate::logic::state::{State, Version};
use crate::logic::txn::Frame;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// Everything in a store, by name.
pub type Records = BTreeMap<Vec<u8>, Vec<u8>>;

/// Changes to a store that belong together; `None` removes a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Batch(pub BTreeMap<Vec<u8>, Option<Vec<u8>>>);

/// Who the store is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Identity {
    /// Whose number its transactions have now.
    pub(crate) origin: Origin,
    /// Name of the robot.
    pub(crate) robot: String,
    /// What it wants to be admitted as, if it is no member.
    pub(crate) joining: Option<Origin>,
    /// Whom it has asked for that; nobody else is asked for the same.
    pub(crate) asked: Option<Origin>,
    /// Origins it has given up.
    pub(crate) past: Vec<Past>,
    /// Up to where others surely have its own transactions.
    pub(crate) told: u64,
}

/// An origin that was given up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Past {
    pub(crate) origin: Origin,
    /// Up to where others surely have its transactions.
    pub(crate) told: u64,
    /// Whether it is known to have used numbers twice.
    pub(crate) twice: bool,
    /// Set for one that it wanted to be admitted as: who was asked, and is asked for the same again.
    pub(crate) asked: Option<Origin>,
}

/// Why a store is not opened. The remedy is to put it aside and to join again from the others.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum OpenError {
    /// A record cannot be read.
    #[error("a record of kind `{kind}` is malformed")]
    Record {
        /// Its kind.
        kind: char,
    },
    /// The records do not belong together.
    #[error("the store is damaged: {what}")]
    Damaged {
        /// What does not fit.
        what: &'static str,
    },
    /// It is another robot's.
    #[error("the store belongs to the robot `{found}`, not to `{expected}`")]
    Robot {
        /// In the store.
        found: String,
        /// In the configuration.
        expected: String,
    },
}

/// What the records of a key begin with: one that everybody has, and one that never leaves the robot.
pub(crate) const SHARED: u8 = b'k';
pub(crate) const LOCAL: u8 = b'p';

/// What a store says.
#[derive(Debug)]
pub(crate) struct Stored {
    pub(crate) identity: Option<Identity>,
    pub(crate) log: Log,
    pub(crate) state: State,
    pub(crate) held: BTreeMap<u64, (Dot, Frame)>,
    pub(crate) local: State,
    /// Whether there is nothing at all.
    pub(crate) is_empty: bool,
}

impl Batch {
    /// Returns whether nothing is to be written.
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

    pub(crate) fn identity(&mut self, identity: &Identity) {
        self.put(vec![b'i'], identity);
    }

    pub(crate) fn digests(&mut self, log: &Log, state: &State) {
        self.put(vec![b's'], &summary(log, state));
    }

    pub(crate) fn head(&mut self, origin: Origin, head: &Head) {
        self.put(name(b't', &origin.number().to_be_bytes()), head);
    }

    pub(crate) fn no_head(&mut self, origin: Origin) {
        self.0.insert(name(b't', &origin.number().to_be_bytes()), None);
    }

    pub(crate) fn frame(&mut self, dot: Dot, index: u64, frame: &Frame) {
        self.put(frame_name(dot), &(index, frame));
    }

    pub(crate) fn held(&mut self, index: u64, held: Option<(Dot, &Frame)>) {
        let name = name(b'o', &index.to_be_bytes());
        match held {
            Some(held) => self.put(name, &held),
            None => drop(self.0.insert(name, None)),
        }
    }

    pub(crate) fn no_frame(&mut self, dot: Dot) {
        self.0.insert(frame_name(dot), None);
    }

    pub(crate) fn versions(&mut self, (kind, key): (u8, &Key), versions: &[Version]) {
        let name = name(kind, key.as_str().as_bytes());
        if versions.is_empty() {
            self.0.insert(name, None);
        } else {
            self.put(name, versions);
        }
    }

    fn put(&mut self, name: Vec<u8>, record: &(impl Serialize + ?Sized)) {
        // Encoding to memory fails for lengths that are not known beforehand only, and records have none.
        let mut bytes = postcard::to_stdvec(record).unwrap_or_default();
        bytes.extend(sum(&name, &bytes));
        self.0.insert(name, Some(bytes));
    }
}

/// Returns by what a store shows that nothing is missing: digests of cut and state, how many frames and keys there are.
fn summary(log: &Log, state: &State) -> (u64, u128, usize, usize) {
    (log.cut().digest(), state.digest(), log.len(), state.len())
}

fn name(kind: u8, rest: &[u8]) -> Vec<u8> {
    [&[kind], rest].concat()
}

fn frame_name(dot: Dot) -> Vec<u8> {
    name(b'l', &[dot.origin.number().to_be_bytes(), dot.seq.to_be_bytes()].concat())
}

fn read<'a, T: Deserialize<'a>>(name: &[u8], bytes: &'a [u8]) -> Result<T, OpenError> {
    let damaged = || OpenError::Record { kind: char::from(name.first().copied().unwrap_or_default()) };
    let (record, found) = bytes.split_last_chunk().ok_or_else(damaged)?;
    if *found != sum(name, record) {
        return Err(damaged());
    }
    match postcard::take_from_bytes(record) {
        Ok((record, [])) => Ok(record),
        _ => Err(damaged()),
    }
}

/// Returns four bytes by which a record shows that it is whole and in its place.
fn sum(name: &[u8], record: &[u8]) -> [u8; 4] {
    let hash = blake3::Hasher::new().update(name).update(&[0]).update(record).finalize();
    let [a, b, c, d, ..] = *hash.as_bytes();
    [a, b, c, d]
}

fn number(kind: u8, bytes: &[u8]) -> Result<u64, OpenError> {
    bytes.try_into().map(u64::from_be_bytes).map_err(|_cause| OpenError::Record { kind: char::from(kind) })
}

/// A store that is being read. It takes record after record, and each is a part of the state at once: no second copy of the
/// whole is ever in memory.
#[derive(Debug, Default)]
pub struct Reading {
    identity: Option<Identity>,
    digests: Option<(u64, u128, usize, usize)>,
    heads: BTreeMap<Origin, Head>,
    frames: Vec<(Dot, u64, Frame)>,
    state: State,
    local: State,
    held: BTreeMap<u64, (Dot, Frame)>,
    /// How many records there were.
    count: usize,
    /// What was wrong first.
    wrong: Option<OpenError>,
}

impl Reading {
    /// Takes the next record; records come in the order of their names. What is wrong is said at the end.
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
                self.heads.insert(Origin::new(number(b't', origin)?), read(name, bytes)?);
            }
            Some((b'l', rest)) => {
                let (origin, seq) = rest.split_at_checked(8).ok_or(OpenError::Record { kind: 'l' })?;
                let dot = Dot { origin: Origin::new(number(b'l', origin)?), seq: number(b'l', seq)? };
                let (index, frame) = read(name, bytes)?;
                self.frames.push((dot, index, frame));
            }
            Some((b'o', index)) => drop(self.held.insert(number(b'o', index)?, read(name, bytes)?)),
            Some((kind @ (&SHARED | &LOCAL), key)) => {
                let key = std::str::from_utf8(key).ok().and_then(|key| Key::new(key).ok());
                let state = if *kind == SHARED { &mut self.state } else { &mut self.local };
                state.restore(key.ok_or(OpenError::Record { kind: char::from(*kind) })?, read(name, bytes)?);
            }
            _ => return Err(OpenError::Damaged { what: "a record of an unknown kind" }),
        }
        Ok(())
    }

    /// Returns what the store says.
    ///
    /// # Errors
    /// If anything in it does not fit: a record, a chain of frames, or the digests.
    pub(crate) fn finish(self, mutant: Mutant) -> Result<Stored, OpenError> {
        if let Some(wrong) = self.wrong {
            return Err(wrong);
        }
        check_chains(&self.heads, &self.frames)?;
        let mut log = Log::new(self.heads, mutant);
        for (dot, index, frame) in self.frames {
            log.restore(dot, Logged { index, frame });
        }
        let (state, local) = (self.state.with(mutant), self.local);
        let fresh = self.count == usize::from(self.identity.is_some());
        if self.digests != Some(summary(&log, &state)) && !fresh {
            return Err(OpenError::Damaged { what: "something is missing" });
        }
        Ok(Stored { identity: self.identity, log, state, held: self.held, local, is_empty: self.count == 0 })
    }
}

impl From<&Records> for Reading {
    fn from(records: &Records) -> Self {
        let mut reading = Self::default();
        records.iter().for_each(|(name, record)| reading.take(name, record));
        reading
    }
}

/// Checks that the frames of each origin follow each other up to its head. They are in order of their names.
fn check_chains(heads: &BTreeMap<Origin, Head>, frames: &[(Dot, u64, Frame)]) -> Result<(), OpenError> {
    let damaged = |what| Err(OpenError::Damaged { what });
    for (index, (dot, _, frame)) in frames.iter().enumerate() {
        let Some(head) = heads.get(&dot.origin) else { return damaged("frames without a head") };
        let Ok(txn) = frame.open() else { return damaged("a frame is malformed") };
        if txn.dot() != *dot {
            return damaged("a frame is at the place of another");
        }
        match frames.get(index + 1).filter(|(next, ..)| next.origin == dot.origin) {
            Some((next, _, following)) => {
                let prev = following.open().map(|txn| txn.prev);
                if next.seq != dot.seq + 1 || prev != Ok(frame.link()) {
                    return damaged("frames that do not follow each other");
                }
            }
            None if (dot.seq, frame.link()) != (head.seq, head.link) => {
                return damaged("the last frame is not the head");
            }
            None => {}
        }
    }
    Ok(())
}
