//! What must be so, worked out from the set of all transactions and nothing else.

use dbmanager::logic::cut::{Cut, Dot};
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::Replica;
use dbmanager::logic::txn::{Frame, Txn};
use std::collections::{BTreeMap, BTreeSet};

/// A transaction, with all that it had seen.
struct Event {
    txn: Txn,
    context: Cut,
}

/// What has happened, as callers and watchers were told.
#[derive(Default)]
pub(super) struct Reference {
    events: BTreeMap<Dot, Event>,
    /// Where each was acknowledged.
    acknowledged: BTreeMap<Dot, usize>,
    names: BTreeMap<Dot, Dot>,
    /// What watchers at each robot have seen.
    shown: BTreeMap<usize, Cut>,
    /// Dots that name two transactions.
    twice: Vec<Dot>,
    broken: Option<String>,
}

impl Reference {
    pub(super) fn len(&self) -> usize {
        self.events.len()
    }

    pub(super) fn blame(&mut self, why: String) {
        self.broken.get_or_insert(why);
    }

    pub(super) fn verdict(&self) -> Result<(), String> {
        self.broken.clone().map_or(Ok(()), Err)
    }

    pub(super) fn restarted(&mut self, node: usize, replica: Option<&Replica>) {
        self.replaced(node, replica);
    }

    /// Watchers begin anew at what is there now; what is shown after it in the same step is not yet taken off.
    pub(super) fn replaced(&mut self, node: usize, replica: Option<&Replica>) {
        let cut = replica.map(|replica| replica.log().cut().clone()).unwrap_or_default();
        self.shown.insert(node, cut);
    }

    /// What was only there is forgiven.
    pub(super) fn disk_lost(&mut self, node: usize) {
        self.acknowledged.retain(|_, at| *at != node);
    }

    pub(super) fn acknowledged(&mut self, node: usize, dot: Dot) {
        self.acknowledged.insert(dot, node);
    }

    pub(super) fn renamed(&mut self, from: Dot, to: Dot) {
        self.names.insert(from, to);
    }

    /// A transaction is on some disk.
    pub(super) fn happened(&mut self, dot: Dot, frame: &Frame) -> Cut {
        let Ok(txn) = frame.open() else {
            self.blame(format!("{dot} cannot be read"));
            return Cut::default();
        };
        let before = Dot { origin: dot.origin, seq: dot.seq - 1 };
        let mut context = self.events.get(&before).map(|event| event.context.clone()).unwrap_or_default();
        context.join(&txn.context);
        context.include(before);
        let event = self.events.entry(dot).or_insert(Event { txn: txn.clone(), context: context.clone() });
        if event.txn != txn {
            self.twice.push(dot);
        }
        context
    }

    /// A watcher is shown a transaction: after all that it saw (I3, I12).
    pub(super) fn visible(&mut self, node: usize, dot: Dot, frame: &Frame) {
        let context = self.happened(dot, frame);
        let shown = self.shown.entry(node).or_default();
        let early = !shown.dominates(&context);
        shown.include(dot);
        if early {
            self.blame(format!("I3: {dot} is shown at {node} before what it saw"));
        }
    }

    /// Checks what is left when everybody has everything.
    pub(super) fn check(&self, replicas: &[&Replica]) -> Result<(), String> {
        let Some(first) = replicas.first() else { return Ok(()) };
        let cut = first.log().cut();
        for replica in replicas {
            if replica.state() != first.state() || replica.state().digest() != first.state().digest() {
                let mut differing = String::new();
                for (key, versions) in first.state().scan("") {
                    if replica.state().versions(key) != versions {
                        differing += &format!("\n{key}: {versions:?} and {:?}", replica.state().versions(key));
                    }
                }
                return Err(format!("I1: equal cuts, different states{differing}"));
            }
        }
        if let Some(dot) = self.twice.first() {
            return Err(format!("T6: {dot} names two transactions"));
        }
        for (dot, node) in &self.acknowledged {
            let name = std::iter::successors(Some(dot), |dot| self.names.get(dot)).last().unwrap_or(dot);
            if !cut.contains(*name) {
                return Err(format!("I5: {dot}, acknowledged at {node}, is lost (now {name})"));
            }
        }
        let events: Vec<(&Dot, &Event)> = self.events.iter().filter(|(dot, _)| cut.contains(**dot)).collect();
        for (origin, seq) in cut.iter() {
            let known = events.iter().filter(|(dot, _)| dot.origin == origin).count() as u64;
            if known != seq {
                return Err(format!("I7: {known} of {seq} transactions of {origin} were ever shown"));
            }
        }
        self.check_stamps(&events)?;
        self.check_versions(&events, first)
    }

    /// I11: stamps extend causality.
    fn check_stamps(&self, events: &[(&Dot, &Event)]) -> Result<(), String> {
        for (dot, event) in events {
            let seen = event.context.iter().filter_map(|(origin, seq)| self.events.get(&Dot { origin, seq }));
            for cause in seen {
                if cause.txn.stamp >= event.txn.stamp {
                    return Err(format!("I11: {dot} saw {} and has a smaller stamp", cause.txn.dot()));
                }
            }
        }
        Ok(())
    }

    /// I2 and I10: each key has exactly the writes that no other write took away, the latest last.
    fn check_versions(&self, events: &[(&Dot, &Event)], replica: &Replica) -> Result<(), String> {
        let mut writes: BTreeMap<&Key, Vec<(&Event, bool)>> = BTreeMap::new();
        for (_, event) in events {
            for write in &event.txn.writes {
                writes.entry(&write.key).or_default().push((event, write.value.is_none()));
            }
        }
        for (key, writes) in &writes {
            let takes = |by: &Event, (of, deletion): &(&Event, bool)| {
                let floor = by.txn.rebase.as_ref().map(|rebase| &rebase.floor);
                by.context.contains(of.txn.dot())
                    || *deletion && floor.is_some_and(|floor| floor.contains(of.txn.dot()))
            };
            let mut left: Vec<&(&Event, bool)> =
                writes.iter().filter(|write| !writes.iter().any(|(by, _)| takes(by, write))).collect();
            left.sort_by_key(|(event, _)| event.txn.stamp);
            if left.iter().all(|(_, deletion)| *deletion) {
                left.clear();
            }
            let expected: Vec<Dot> = left.iter().map(|(event, _)| event.txn.dot()).collect();
            let versions = replica.state().versions(key);
            let shown: Vec<Dot> = versions.iter().map(|version| version.dot).collect();
            let deleted = versions.iter().all(|version| version.value.is_none());
            if shown != expected && !(deleted && expected.is_empty()) {
                let why = |dot: Dot| self.events.get(&dot).map(|event| (dot, &event.context, &event.txn.rebase));
                let all = writes.iter().map(|(event, _)| event.txn.dot());
                let why: Vec<_> = all.filter_map(|dot| why(dot).map(|why| format!("{why:?}"))).collect();
                return Err(format!("I2, I10: {key} has {shown:?}, not {expected:?}\n{why:#?}"));
            }
        }
        let known: BTreeSet<&Key> = writes.into_keys().collect();
        let strange = replica.state().scan("").map(|(key, _)| key).find(|key| !known.contains(key));
        strange.map_or(Ok(()), |key| Err(format!("I9: {key} was never written")))
    }
}
