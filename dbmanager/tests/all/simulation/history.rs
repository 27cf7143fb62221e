//! A checker of histories: it sees only the clients' reads and writes.
//!
//! Values are unique, so each read shows the transaction that wrote its value. This gives three relations between
//! transactions: `wr` (saw); `ww` (overwrote: a client read a value and wrote another in its place, or a watcher saw
//! the replacement); and `co`, causality: the closure of `wr` and the order of sessions. Each [`Anomaly`] is a pattern
//! that these must not contain. Sources: Adya (1999) and Kingsbury and Alvaro, *Elle* (VLDB 2020) for G0 to G1c; Bailis
//! et al., RAMP (2014) for fractured reads; Terry et al. (1994) for sessions; Bouajjani et al. (POPL 2017) for the bad
//! patterns of causality.

use std::collections::{BTreeMap, BTreeSet};

/// A register; clients call it a key.
pub(crate) type Register = u64;
/// A value. No two writes have the same value.
pub(crate) type Value = u64;

/// An operation of a transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Op {
    /// Read this value; none if the register had no value.
    Read(Register, Option<Value>),
    /// Wrote this value.
    Put(Register, Value),
    /// Deleted the value of the register.
    Delete(Register),
}

/// A transaction, as its client knows it.
#[derive(Clone, Debug)]
pub(crate) struct Txn {
    pub(crate) session: usize,
    /// Whether the transaction was refused.
    pub(crate) aborted: bool,
    pub(crate) ops: Vec<Op>,
}

/// Everything that clients and watchers know. The transactions of a session are in their order.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    pub(crate) txns: Vec<Txn>,
    /// A watcher saw the second value in place of the first.
    pub(crate) replaced: BTreeSet<(Register, Value, Value)>,
    /// The registers that a returning robot has written by rebasing: deletions do not hide such values.
    pub(crate) brought: BTreeSet<Register>,
}

/// An anomaly that must not happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Anomaly {
    /// Read a value that no transaction wrote.
    ThinAirRead,
    /// Read a value of a transaction that was refused (G1a).
    AbortedRead,
    /// Read a value that its own transaction overwrote (G1b).
    IntermediateRead,
    /// A transaction did not see its own write.
    Internal,
    /// A circle of overwriting (G0).
    DirtyWrite,
    /// A cycle of overwriting and seeing (G1c).
    CircularInformation,
    /// Saw one write of a transaction, but an older value in place of another.
    FracturedRead,
    /// A session did not see its own write.
    ReadYourWrites,
    /// A session saw an older value than before.
    MonotonicReads,
    /// The writes of a session were seen in another order.
    MonotonicWrites,
    /// A write was ordered before one that its session had seen.
    WritesFollowReads,
    /// A circle of causality.
    CyclicCo,
    /// Read a value that was overwritten in the reader's own past.
    WriteCoRead,
    /// Read no value, although the reader's own past has one.
    WriteCoInitRead,
}

/// A relation between transactions, as sets of bits: the successors of each.
struct Relation {
    words: usize,
    after: Vec<Vec<u64>>,
}

impl Relation {
    fn new(count: usize) -> Self {
        let words = count.div_ceil(64);
        Self { words, after: vec![vec![0; words]; count] }
    }

    fn add(&mut self, before: usize, after: usize) {
        if before != after {
            self.after[before][after / 64] |= 1 << (after % 64);
        }
    }

    fn has(&self, before: usize, after: usize) -> bool {
        self.after[before][after / 64] >> (after % 64) & 1 == 1
    }

    fn following(&self, of: usize) -> impl Iterator<Item = usize> {
        let bits = |(index, word): (usize, &u64)| {
            let word = *word;
            (0..64).filter(move |bit| word >> bit & 1 == 1).map(move |bit| index * 64 + bit)
        };
        self.after[of].iter().enumerate().flat_map(bits)
    }

    /// Computes the closure; returns false if there is a cycle.
    fn close(&mut self) -> bool {
        let count = self.after.len();
        let mut missing = vec![0_usize; count];
        (0..count).for_each(|of| self.following(of).for_each(|next| missing[next] += 1));
        let mut order: Vec<usize> = (0..count).filter(|index| missing[*index] == 0).collect();
        let mut done = 0;
        while let Some(of) = order.get(done).copied() {
            done += 1;
            for next in self.following(of) {
                missing[next] -= 1;
                if missing[next] == 0 {
                    order.push(next);
                }
            }
        }
        for of in order.iter().rev() {
            let mut reach = self.after[*of].clone();
            for next in self.following(*of) {
                (0..self.words).for_each(|word| reach[word] |= self.after[next][word]);
            }
            self.after[*of] = reach;
        }
        order.len() == count
    }
}

/// The relations that follow from a history.
struct Facts<'a> {
    history: &'a History,
    /// The writer of each value, and whether this was the writer's last write to the register.
    writers: BTreeMap<(Register, Value), (usize, bool)>,
    /// The values that have overwritten each value, directly or indirectly.
    newer: BTreeMap<Register, BTreeMap<Value, BTreeSet<Value>>>,
    causality: Relation,
}

impl Txn {
    fn reads(&self) -> impl Iterator<Item = (Register, Option<Value>)> {
        self.ops.iter().filter_map(|op| match op {
            Op::Read(register, value) => Some((*register, *value)),
            Op::Put(..) | Op::Delete(_) => None,
        })
    }

    /// Returns the final value of the transaction at each register, or `None` for a deletion.
    fn leaves(&self) -> BTreeMap<Register, Option<Value>> {
        let write = |op: &Op| match op {
            Op::Put(register, value) => Some((*register, Some(*value))),
            Op::Delete(register) => Some((*register, None)),
            Op::Read(..) => None,
        };
        self.ops.iter().filter_map(write).collect()
    }
}

/// Returns every anomaly of a history.
pub(crate) fn check(history: &History) -> BTreeSet<Anomaly> {
    let mut found = BTreeSet::new();
    let facts = Facts::of(history, &mut found);
    if found.contains(&Anomaly::CyclicCo) {
        return found;
    }
    let mut last: BTreeMap<usize, Session> = BTreeMap::new();
    for (index, txn) in history.txns.iter().enumerate().filter(|(_, txn)| !txn.aborted) {
        for (register, value) in txn.reads() {
            facts.check_read(index, (register, value), &mut found);
        }
        facts.check_fractures(index, &mut found);
        facts.check_session(index, last.entry(txn.session).or_default(), &mut found);
    }
    found
}

/// Returns the pairs of transactions that have both read the same value and overwritten it, with the register.
pub(crate) fn lost_updates(history: &History) -> Vec<(usize, usize, Register)> {
    let mut updates: BTreeMap<(Register, Value), Vec<usize>> = BTreeMap::new();
    for (index, txn) in history.txns.iter().enumerate().filter(|(_, txn)| !txn.aborted) {
        let leaves = txn.leaves();
        let read: BTreeSet<_> = txn.reads().filter(|(register, _)| leaves.contains_key(register)).collect();
        for (register, value) in read {
            updates.entry((register, value.unwrap_or_default())).or_default().push(index);
        }
    }
    let mut lost = Vec::new();
    for ((register, value), txns) in updates.into_iter().filter(|((_, value), _)| *value > 0) {
        debug_assert!(value > 0, "values begin at 1");
        for (position, first) in txns.iter().enumerate() {
            lost.extend(txns[position + 1..].iter().map(|second| (*first, *second, register)));
        }
    }
    lost
}

/// The knowledge of a session: for each register, the values than which it must not see older ones.
#[derive(Default)]
struct Session {
    wrote: BTreeMap<Register, Value>,
    read: BTreeMap<Register, Value>,
}

impl<'a> Facts<'a> {
    fn of(history: &'a History, found: &mut BTreeSet<Anomaly>) -> Self {
        let mut writers = BTreeMap::new();
        for (index, txn) in history.txns.iter().enumerate() {
            let leaves = txn.leaves();
            for op in &txn.ops {
                if let Op::Put(register, value) = op {
                    writers.insert((*register, *value), (index, leaves.get(register) == Some(&Some(*value))));
                }
            }
        }
        let count = history.txns.len();
        let (mut overwrote, mut informed) = (Relation::new(count), Relation::new(count));
        let mut causality = Relation::new(count);
        let mut edges: BTreeSet<(Register, Value, Value)> = history.replaced.clone();
        let mut sessions: BTreeMap<usize, usize> = BTreeMap::new();
        for (index, txn) in history.txns.iter().enumerate().filter(|(_, txn)| !txn.aborted) {
            if let Some(before) = sessions.insert(txn.session, index) {
                causality.add(before, index);
            }
            let leaves = txn.leaves();
            for (register, value) in txn.reads().filter_map(|(register, value)| Some((register, value?))) {
                if let Some((writer, _)) = writers.get(&(register, value)).filter(|(writer, _)| *writer != index) {
                    causality.add(*writer, index);
                    informed.add(*writer, index);
                    edges.extend(leaves.get(&register).copied().flatten().map(|left| (register, value, left)));
                }
            }
        }
        for (register, older, newer) in &edges {
            if let (Some((a, _)), Some((b, _))) = (writers.get(&(*register, *older)), writers.get(&(*register, *newer)))
            {
                overwrote.add(*a, *b);
                informed.add(*a, *b);
            }
        }
        let mut note = |holds: bool, anomaly| {
            if !holds {
                found.insert(anomaly);
            }
        };
        note(overwrote.close(), Anomaly::DirtyWrite);
        note(informed.close(), Anomaly::CircularInformation);
        note(causality.close(), Anomaly::CyclicCo);
        Self { history, writers, newer: close_values(&edges), causality }
    }

    fn is_newer(&self, register: Register, value: Value, than: Value) -> bool {
        self.newer.get(&register).and_then(|of| of.get(&than)).is_some_and(|newer| newer.contains(&value))
    }

    /// Returns whether a transaction must not see a value any more, given that its past has the value `than`.
    fn is_stale(&self, reader: usize, (register, value): (Register, Value), than: Value) -> bool {
        self.is_newer(register, than, value) && !self.may_be_uncovered(reader, (register, value), than)
    }

    /// Returns whether an older value may show again. This is so if a client that had not seen the older value deleted
    /// the newer one, and a robot's rebased writes take precedence over that deletion.
    fn may_be_uncovered(&self, reader: usize, (register, older): (Register, Value), newer: Value) -> bool {
        let writer = |value| self.writers.get(&(register, value)).map(|(writer, _)| *writer);
        let (Some(older), Some(newer)) = (writer(older), writer(newer)) else { return false };
        let follows = |a: usize, b: usize| a == b || self.causality.has(a, b);
        let deletes = |txn: &Txn| !txn.aborted && txn.leaves().get(&register) == Some(&None);
        let fits = |by: usize| !follows(by, newer) && !follows(older, by) && !follows(reader, by);
        self.history.brought.contains(&register)
            && self.history.txns.iter().enumerate().any(|(by, txn)| deletes(txn) && fits(by))
    }

    /// Returns whether a deletion may be the reason that a transaction reads no value: a deletion that the
    /// transaction's own past has not overwritten.
    fn may_be_deleted(&self, reader: usize, register: Register) -> bool {
        let writes = |txn: &Txn| txn.leaves().get(&register).copied();
        let txns = || self.history.txns.iter().enumerate().filter(|(_, txn)| !txn.aborted);
        let deletions = txns().filter(|(_, txn)| writes(txn) == Some(None)).map(|(index, _)| index);
        let puts: Vec<usize> = txns().filter(|(_, t)| writes(t).flatten().is_some()).map(|(index, _)| index).collect();
        let follows = |a: usize, b: usize| self.causality.has(a, b);
        deletions.filter(|deletion| *deletion != reader).any(|deletion| {
            !puts.iter().any(|put| follows(deletion, *put) && follows(*put, reader)) && !follows(reader, deletion)
        })
    }

    fn check_read(&self, index: usize, (register, value): (Register, Option<Value>), found: &mut BTreeSet<Anomaly>) {
        let txn = &self.history.txns[index];
        let place = txn.ops.iter().position(|op| *op == Op::Read(register, value)).unwrap_or(0);
        let before = Txn { ops: txn.ops[..place].to_vec(), ..txn.clone() };
        if let Some(own) = before.leaves().get(&register) {
            if *own != value {
                found.insert(Anomaly::Internal);
            }
            return;
        }
        let past = |writer: usize| self.causality.has(writer, index);
        let Some(value) = value else {
            let written = self.writers.iter().any(|((of, _), (by, last))| *of == register && *last && past(*by));
            if written && !self.may_be_deleted(index, register) {
                found.insert(Anomaly::WriteCoInitRead);
            }
            return;
        };
        let Some((writer, last)) = self.writers.get(&(register, value)).copied() else {
            found.insert(Anomaly::ThinAirRead);
            return;
        };
        if self.history.txns[writer].aborted {
            found.insert(Anomaly::AbortedRead);
        }
        if !last && writer != index {
            found.insert(Anomaly::IntermediateRead);
        }
        let over = |by: usize| by != writer && self.causality.has(writer, by) && past(by);
        let mut others = self.history.txns.iter().enumerate().filter(|(_, txn)| !txn.aborted);
        if others.any(|(by, txn)| over(by) && txn.leaves().contains_key(&register)) {
            found.insert(Anomaly::WriteCoRead);
        }
    }

    fn check_fractures(&self, index: usize, found: &mut BTreeSet<Anomaly>) {
        let reads: BTreeMap<Register, Option<Value>> = self.history.txns[index].reads().collect();
        for (register, value) in reads.iter().filter_map(|(register, value)| Some((*register, (*value)?))) {
            let Some((writer, _)) = self.writers.get(&(register, value)) else { continue };
            for (other, written) in self.history.txns[*writer].leaves() {
                let (Some(written), Some(Some(seen))) = (written, reads.get(&other)) else { continue };
                if self.is_stale(index, (other, *seen), written) {
                    found.insert(Anomaly::FracturedRead);
                }
            }
        }
    }

    fn check_session(&self, index: usize, session: &mut Session, found: &mut BTreeSet<Anomaly>) {
        let txn = &self.history.txns[index];
        let mut note = |holds: bool, anomaly| {
            if !holds {
                found.insert(anomaly);
            }
        };
        let is_older = |register: Register, value: Option<&Value>, than: Value| {
            value.is_some_and(|value| self.is_newer(register, than, *value))
        };
        for (register, value) in txn.reads().filter_map(|(register, value)| Some((register, value?))) {
            let is_stale = |than: Value| self.is_stale(index, (register, value), than);
            note(!session.wrote.get(&register).copied().is_some_and(is_stale), Anomaly::ReadYourWrites);
            note(!session.read.insert(register, value).is_some_and(is_stale), Anomaly::MonotonicReads);
        }
        for (register, value) in txn.leaves() {
            let Some(value) = value else { continue };
            note(
                !is_older(register, Some(&value), session.read.get(&register).copied().unwrap_or(value)),
                Anomaly::WritesFollowReads,
            );
            let wrote = session.wrote.insert(register, value);
            note(!wrote.is_some_and(|wrote| self.is_newer(register, wrote, value)), Anomaly::MonotonicWrites);
        }
    }
}

/// Returns for each value all values that have overwritten it, directly or indirectly.
fn close_values(edges: &BTreeSet<(Register, Value, Value)>) -> BTreeMap<Register, BTreeMap<Value, BTreeSet<Value>>> {
    let mut closed: BTreeMap<Register, BTreeMap<Value, BTreeSet<Value>>> = BTreeMap::new();
    for (register, older, newer) in edges {
        closed.entry(*register).or_default().entry(*older).or_default().insert(*newer);
    }
    for of in closed.values_mut() {
        let values: Vec<Value> = of.keys().copied().collect();
        for value in values {
            let mut reach = of.get(&value).cloned().unwrap_or_default();
            let mut waiting: Vec<Value> = reach.iter().copied().collect();
            while let Some(next) = waiting.pop() {
                let more = of.get(&next).into_iter().flatten().copied();
                waiting.extend(more.filter(|value| reach.insert(*value)).collect::<Vec<_>>());
            }
            of.insert(value, reach);
        }
    }
    closed
}
