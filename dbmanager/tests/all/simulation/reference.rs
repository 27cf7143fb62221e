//! The invariants, computed only from the set of all transactions.
//!
//! A transaction is identified by its dot and its hash, because after a rollback two transactions may have the same dot. The
//! transactions of a replica are the chains of each origin, followed back from its head. The following table names the place
//! where each invariant of the study is checked:
//!
//! | | what | where |
//! |---|---|---|
//! | I1 | equal version vectors mean equal states | [`Reference::same_state`], after each step and at the end |
//! | I2 | the shown state is the fold of all transactions | [`Reference::check_versions`], now and then and at the end |
//! | I3 | the applied transactions are closed under causality | [`Reference::visible`] |
//! | I4 | no client sees a part of a transaction | I2 between two inputs; fractured reads in `history` |
//! | I5 | acknowledged transactions survive crashes | [`Reference::check_acknowledged`] |
//! | I6 | transactions replicated to `k` disks survive there | `World::reached`: `k` other disks have it when the caller is
//! told so |
//! | I7 | chains have no gaps; forks are reported | [`Reference::chain`], `World::alarm` |
//! | I8 | logs are cut only below the transactions that all members have | `World::truncated` |
//! | I9 | deleted values stay deleted | [`Reference::check_versions`] |
//! | I10 | conflicts are exactly the concurrent writes | [`Reference::check_versions`], [`Reference::is_listed`] |
//! | I11 | timestamps extend causality | [`Reference::check_stamps`] |
//! | I12 | watchers get each transaction once | [`Reference::visible`], [`Reference::check`] |
//! | I13 | convergence takes bounded time | `World::converge`; the named cases of the network |
//! | I14 | not much more is sent than is needed | the named cases of the network |
//! | I15 | memory and log are bounded | `World::check_limits` |
//! | I16 | no secret in plain text | not checked here: it concerns sealed values |

use dbmanager::logic::clock::Timestamp;
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::Replica;
use dbmanager::logic::state::Version;
use dbmanager::logic::txn::{EncodedTxn, Txn};
use dbmanager::logic::version_vector::{Dot, ReplicaId, VersionVector};
use std::collections::{BTreeMap, BTreeSet};

/// The hash that chains transactions.
type ChainHash = [u8; 8];
/// One transaction, identified also when numbers are used twice.
pub(crate) type Id = (Dot, ChainHash);

/// A transaction, with everything that it had seen: numbers, and the transactions that these stood for where it was written.
struct Event {
    txn: Txn,
    context: VersionVector,
    seen: BTreeMap<ReplicaId, Id>,
}

/// The events so far, as reported to callers and watchers.
#[derive(Default)]
pub(crate) struct Reference {
    events: BTreeMap<Id, Event>,
    /// Where each was acknowledged.
    acknowledged: BTreeMap<Id, usize>,
    /// The transactions that their own robot has lost.
    orphaned: BTreeSet<Id>,
    /// Whether a robot has returned without the transactions of other robots that it held, since those robots bring them
    /// themselves.
    pub(crate) left_behind: bool,
    /// Whether a store may have been set back without a witness. Its later writes may then be concurrent with a deletion that
    /// it had acknowledged, and only robots that still know the deletion show this.
    pub(crate) can_roll_back: bool,
    /// The dots under which each transaction was committed again.
    names: BTreeMap<Id, Vec<Id>>,
    /// The transactions that watchers at each robot have seen.
    shown: BTreeMap<usize, VersionVector>,
    links: BTreeMap<(usize, Dot), ChainHash>,
    /// The hashes of their dots before another state was taken over: rebased transactions have names of that time.
    meant: BTreeMap<(usize, Dot), ChainHash>,
    /// Pairs of writes that were shown as conflicts.
    listed: BTreeSet<(Key, Timestamp, Timestamp)>,
    broken: Option<String>,
}

impl Reference {
    pub(crate) fn len(&self) -> usize {
        self.events.len()
    }

    pub(crate) fn blame(&mut self, why: String) {
        self.broken.get_or_insert(why);
    }

    pub(crate) fn verdict(&self) -> Result<(), String> {
        self.broken.clone().map_or(Ok(()), Err)
    }

    /// Restarts the watchers of a robot at the present state.
    pub(crate) fn replaced(&mut self, node: usize, cut: VersionVector) {
        self.shown.insert(node, cut);
    }

    /// Notes the transactions that a robot's numbers stand for: those to which its heads lead back. The state of another
    /// robot, or an older disk of its own, may have different ones.
    pub(crate) fn means(&mut self, node: usize, replica: &Replica) {
        self.meant.retain(|(at, _), _| *at != node);
        for (origin, head) in replica.log().heads() {
            let mut id = (Dot { origin: *origin, seq: head.seq }, head.hash.0);
            while id.0.seq > 0 {
                if let Some(before) = self.links.insert((node, id.0), id.1) {
                    self.meant.insert((node, id.0), before);
                }
                let prev = self.events.get(&id).map(|event| event.txn.prev.0);
                let prev = prev.or_else(|| Some(replica.log().encoded(id.0)?.open().ok()?.prev.0));
                let Some(prev) = prev else { break };
                id = (Dot { seq: id.0.seq - 1, ..id.0 }, prev);
            }
        }
    }

    pub(crate) fn acknowledged(&mut self, node: usize, dot: Dot) {
        match self.links.get(&(node, dot)) {
            Some(link) => drop(self.acknowledged.insert((dot, *link), node)),
            None => self.blame(format!("I12: {dot} is acknowledged at {node} before it is shown")),
        }
    }

    /// Returns the transaction that was shown at a robot under this name.
    pub(crate) fn id(&self, node: usize, dot: Dot) -> Option<Id> {
        Some((dot, *self.links.get(&(node, dot))?))
    }

    pub(crate) fn renamed(&mut self, node: usize, from: Dot, to: Dot) {
        let link = |dot: Dot| {
            let own = self.links.get(&(node, dot)).copied();
            let own = self.meant.get(&(node, dot)).copied().filter(|_| dot == from).or(own);
            own.or_else(|| {
                Some(self.events.range((dot, ChainHash::default())..).next().filter(|(id, _)| id.0 == dot)?.0.1)
            })
        };
        match (link(from), link(to)) {
            (Some(before), Some(after)) => self.names.entry((from, before)).or_default().push((to, after)),
            _ => self.blame(format!("{from} was renamed to {to}, and one of them was never shown")),
        }
    }

    /// Notes a transaction that is on some disk. Returns the transactions that it had seen.
    pub(crate) fn happened(&mut self, node: usize, dot: Dot, frame: &EncodedTxn) -> VersionVector {
        let id = (dot, frame.hash().0);
        self.links.insert((node, dot), id.1);
        if let Some(event) = self.events.get(&id) {
            return event.context.clone();
        }
        let Ok(txn) = frame.open() else {
            self.blame(format!("{dot} cannot be read"));
            return VersionVector::default();
        };
        let before = Dot { origin: dot.origin, seq: dot.seq - 1 };
        let earlier = self.events.get(&(before, txn.prev.0)).map(|event| (event.context.clone(), event.seen.clone()));
        let (mut context, mut seen) = earlier.unwrap_or_default();
        context.join(&txn.context);
        context.include(before);
        // A transaction is first shown at the robot that wrote it.
        let more = txn.context.iter().map(|(origin, seq)| Dot { origin, seq });
        seen.extend(more.filter_map(|of| Some((of.origin, (of, *self.links.get(&(node, of))?)))));
        seen.insert(dot.origin, (before, txn.prev.0));
        self.events.insert(id, Event { txn, context: context.clone(), seen });
        context
    }

    /// Checks a transaction that is shown to a watcher: it is shown once, and after everything that it had seen (I3, I12).
    pub(crate) fn visible(&mut self, node: usize, dot: Dot, frame: &EncodedTxn) {
        let context = self.happened(node, dot, frame);
        let shown = self.shown.entry(node).or_default();
        let (early, again) = (!shown.dominates(&context), shown.contains(dot));
        shown.include(dot);
        if early {
            self.blame(format!("I3: {dot} is shown at {node} before what it saw"));
        }
        if again {
            self.blame(format!("I12: {dot} is shown twice at {node}"));
        }
    }

    /// Notes the conflicts that a read shows for the keys that a transaction has written.
    pub(crate) fn note_conflicts(&mut self, replica: &Replica, frame: &EncodedTxn) {
        let Some(event) = frame.open().ok().and_then(|txn| self.events.get(&(txn.dot(), frame.hash().0))) else {
            return;
        };
        for write in &event.txn.writes {
            if replica.state().is_conflict(&write.key) {
                note(&mut self.listed, &write.key, replica.state().versions(&write.key));
            }
        }
    }

    /// Notes the conflicts that a read of all conflicts shows.
    pub(crate) fn note_all_conflicts(&mut self, replica: &Replica) {
        replica.state().conflicts("").for_each(|(key, versions)| note(&mut self.listed, key, versions));
    }

    /// Returns the transactions of a replica (I7): the chain of each origin, followed back from its head.
    pub(crate) fn chain(&self, replica: &Replica) -> Result<BTreeMap<Dot, ChainHash>, String> {
        let mut chain = BTreeMap::new();
        for (origin, head) in replica.log().heads() {
            let mut id = (Dot { origin: *origin, seq: head.seq }, head.hash.0);
            while id.0.seq > 0 {
                let Some(event) = self.events.get(&id) else {
                    return Err(format!("I7: {} of {origin} was never shown by this link", id.0.seq));
                };
                chain.insert(id.0, id.1);
                id = (Dot { seq: id.0.seq - 1, ..id.0 }, event.txn.prev.0);
            }
        }
        Ok(chain)
    }

    /// Returns the keys of the writes that returning robots have rebased.
    pub(crate) fn brought_in(&self) -> impl Iterator<Item = &Key> {
        let brought = self.events.values().filter(|event| event.txn.rebase.is_some());
        brought.flat_map(|event| event.txn.writes.iter().map(|write| &write.key))
    }

    /// Returns all names that a transaction has had.
    fn lives(&self, id: Id) -> Vec<Id> {
        let mut lives = vec![id];
        let mut index = 0;
        while let Some(id) = lives.get(index) {
            let next: Vec<Id> = self.names.get(id).into_iter().flatten().copied().collect();
            lives.extend(next.into_iter().filter(|id| !lives.contains(id)).collect::<Vec<_>>());
            index += 1;
        }
        lives
    }

    /// Returns whether a replica has a transaction, under one of its names.
    pub(crate) fn has(&self, (replica, chain): (&Replica, &BTreeMap<Dot, ChainHash>), id: Id) -> bool {
        let lives = self.lives(id);
        let there = |(dot, link): &Id| chain.get(dot) == Some(link);
        lives.iter().any(there)
            || lives.iter().any(|(dot, _)| {
                // If a number was used twice, the name may belong to the other transaction: one that is here, or one that was
                // committed again.
                let is_other = chain.get(dot).is_some_and(|there| lives.iter().all(|(_, link)| there != link))
                    || self.twins(*dot).any(|twin| !lives.contains(&twin) && self.names.contains_key(&twin));
                let name = replica.name_of(*dot);
                !is_other && name != *dot && chain.contains_key(&name)
            })
    }

    /// Allows the loss of transactions that were on a disk and are now on no disk.
    ///
    /// Copies of them on other robots are orphans. If those robots are retired and return, they may leave the copies behind,
    /// because the robot that wrote them is a member and would bring them itself. Such a loss requires a lost disk and a
    /// retirement.
    pub(crate) fn forgive(&mut self, before: &Replica, left: &[&Replica]) -> Result<(), String> {
        let had = self.chain(before)?;
        let orphans = self.acknowledged.keys().filter(|id| self.has((before, &had), **id)).copied();
        self.orphaned.extend(orphans.collect::<Vec<_>>());
        let chains = left.iter().map(|replica| self.chain(replica)).collect::<Result<Vec<_>, _>>()?;
        let somewhere = |id: Id| left.iter().zip(&chains).any(|(replica, chain)| self.has((replica, chain), id));
        let lost = self.acknowledged.keys().filter(|id| self.has((before, &had), **id) && !somewhere(**id));
        for id in lost.copied().collect::<Vec<_>>() {
            self.acknowledged.remove(&id);
        }
        Ok(())
    }

    /// I1: two replicas with the same version vector have the same state, unless their numbers stand for different
    /// transactions, which is noticed when they meet.
    pub(crate) fn same_state(&self, a: &Replica, b: &Replica) -> Result<(), String> {
        let means =
            |replica: &Replica| replica.log().heads().iter().map(|(of, head)| (*of, head.hash.0)).collect::<Vec<_>>();
        if a.log().vector() != b.log().vector()
            || means(a) != means(b)
            || a.state() == b.state() && a.state().digest() == b.state().digest()
        {
            return Ok(());
        }
        let mut differing = String::new();
        let keys: BTreeSet<&Key> = a.state().scan("").chain(b.state().scan("")).map(|(key, _)| key).collect();
        for key in keys {
            let (of_a, of_b) = (a.state().versions(key), b.state().versions(key));
            if of_a != of_b && !(self.can_roll_back && values(of_a).eq(values(of_b))) {
                differing += &format!("\n{key}: {of_a:?} and {of_b:?}");
            }
        }
        if self.can_roll_back && differing.is_empty() {
            return Ok(());
        }
        Err(format!("I1: equal cuts, different states{differing}"))
    }

    /// Checks the final state, in which every robot has all transactions.
    pub(crate) fn check(&self, replicas: &[(usize, &Replica)]) -> Result<(), String> {
        let Some((_, first)) = replicas.first() else { return Ok(()) };
        for (node, replica) in replicas {
            self.same_state(first, replica)?;
            if self.shown.get(node) != Some(replica.log().vector()) {
                return Err(format!("I12: watchers at {node} have not seen all that is there"));
            }
        }
        let chain = self.chain(first)?;
        self.check_acknowledged((first, &chain))?;
        self.check_stamps(&chain)?;
        self.check_versions(first)
    }

    /// I5: each acknowledged transaction is here. Each of its writes is shown, or was overwritten by a transaction that had
    /// seen it.
    fn check_acknowledged(&self, (replica, chain): (&Replica, &BTreeMap<Dot, ChainHash>)) -> Result<(), String> {
        for (id, node) in &self.acknowledged {
            if self.left_behind && self.orphaned.contains(id) {
                continue;
            }
            if !self.has((replica, chain), *id) {
                return Err(format!("I5: {}, acknowledged at {node}, is lost (lives {:?})", id.0, self.lives(*id)));
            }
            let Some(event) = self.events.get(id) else { continue };
            // Deletions are left out: returning writes that had not seen a deletion take precedence over it.
            for write in event.txn.writes.iter().filter(|write| write.value.is_some()) {
                let shown = replica.state().versions(&write.key).iter().any(|v| v.stamp == event.txn.written());
                if !shown && !self.is_overwritten(*id, &write.key, (replica, chain)) {
                    return Err(format!("I5: what {} wrote to {}, acknowledged at {node}, is lost", id.0, write.key));
                }
            }
        }
        Ok(())
    }

    /// Returns whether a transaction had seen exactly this transaction, not a different one of the same name.
    fn sees(&self, event: &Event, id: Id) -> bool {
        if !event.context.contains(id.0) || !self.is_twice(id) {
            return event.context.contains(id.0);
        }
        let mut of = event.seen.get(&id.0.origin).copied();
        while let Some(above) = of.filter(|of| of.0.seq > id.0.seq) {
            let prev = self.events.get(&above).map(|event| event.txn.prev.0);
            of = prev.map(|prev| (Dot { seq: above.0.seq - 1, ..above.0 }, prev));
        }
        of == Some(id)
    }

    /// Returns all transactions with this name.
    fn twins(&self, dot: Dot) -> impl Iterator<Item = Id> {
        self.events.range((dot, [0; 8])..=(dot, [u8::MAX; 8])).map(|(id, _)| *id)
    }

    /// Returns whether another transaction has the same name.
    fn is_twice(&self, id: Id) -> bool {
        self.twins(id.0).count() > 1
    }

    fn is_overwritten(&self, id: Id, key: &Key, there: (&Replica, &BTreeMap<Dot, ChainHash>)) -> bool {
        let lives = self.lives(id);
        let sees = |event: &Event| lives.iter().any(|id| self.sees(event, *id));
        let takes = |event: &Event| {
            event.txn.rebase.as_ref().is_some_and(|rebase| lives.iter().any(|(dot, _)| rebase.takes.contains(dot)))
        };
        let stamp = self.events.get(&id).map(|event| event.txn.written());
        self.events.iter().any(|(at, event)| {
            Some(event.txn.written()) > stamp
                && event.txn.writes.iter().any(|write| write.key == *key)
                && (sees(event) || takes(event))
                && self.has(there, *at)
        })
    }

    /// I11: timestamps grow along chains, and extend causality.
    fn check_stamps(&self, chain: &BTreeMap<Dot, ChainHash>) -> Result<(), String> {
        for (dot, link) in chain {
            let Some(event) = self.events.get(&(*dot, *link)) else { continue };
            let named = event.context.iter().map(|(origin, seq)| Dot { origin, seq });
            let causes = named.filter_map(|dot| Some((dot, *chain.get(&dot)?))).filter(|id| self.sees(event, *id));
            for cause in causes.filter_map(|id| self.events.get(&id)) {
                if cause.txn.stamp >= event.txn.stamp {
                    return Err(format!("I11: {dot} saw {} and has a smaller stamp", cause.txn.dot()));
                }
            }
        }
        Ok(())
    }

    /// I2, I9 and I10: each key has exactly the writes that no other write took away, with the latest one last.
    pub(crate) fn check_versions(&self, replica: &Replica) -> Result<(), String> {
        let chain = self.chain(replica)?;
        let mut writes: BTreeMap<&Key, Vec<(&Event, bool)>> = BTreeMap::new();
        for event in chain.iter().filter_map(|(dot, link)| self.events.get(&(*dot, *link))) {
            for write in &event.txn.writes {
                writes.entry(&write.key).or_default().push((event, write.value.is_none()));
            }
        }
        for (key, writes) in &writes {
            let takes = |by: &Event, (of, deletion): &(&Event, bool)| {
                let dot = of.txn.dot();
                let named = by.txn.rebase.as_ref().is_none_or(|rebase| {
                    dot.origin != by.txn.stamp.origin && (*deletion || rebase.takes.contains(&dot))
                });
                by.context.contains(dot) && named
            };
            let mut left: Vec<&(&Event, bool)> =
                writes.iter().filter(|write| !writes.iter().any(|(by, _)| takes(by, write))).collect();
            left.sort_by_key(|(event, _)| (event.txn.written(), event.txn.dot()));
            let counts = |deletion: bool| !(deletion && self.can_roll_back);
            left.retain(|(_, deletion)| counts(*deletion));
            if left.iter().all(|(_, deletion)| *deletion) {
                left.clear();
            }
            let expected: Vec<Dot> = left.iter().map(|(event, _)| event.txn.dot()).collect();
            let versions = replica.state().versions(key);
            let shown = versions.iter().filter(|version| counts(version.value.is_none())).map(|version| version.dot);
            let shown: Vec<Dot> = shown.collect();
            let deleted = versions.iter().all(|version| version.value.is_none());
            if shown != expected && !(deleted && expected.is_empty()) {
                return Err(format!("I2, I10: {key} has {shown:?}, not {expected:?}"));
            }
            let differ = versions.iter().any(|version| version.value != versions[0].value);
            if replica.state().is_conflict(key) != differ && !expected.is_empty() {
                return Err(format!("I10: {key} has {} writes that did not see each other", left.len()));
            }
        }
        let strange = replica.state().scan("").map(|(key, _)| key).find(|key| !writes.contains_key(key));
        strange.map_or(Ok(()), |key| Err(format!("I9: {key} was never written")))
    }

    /// Returns whether two writes to a key, or their causal successors, were shown as a conflict (I10). Also true if a client
    /// that had seen one of them deleted it, since that deletion may have been dropped.
    pub(crate) fn is_listed(&self, key: &Key, a: Id, b: Id) -> bool {
        let writers = || self.events.iter().filter(|(_, event)| event.txn.writes.iter().any(|write| write.key == *key));
        let deletes = |event: &Event| event.txn.writes.iter().any(|write| write.key == *key && write.value.is_none());
        let heirs = |id: Id| {
            // A transaction that has seen a successor under another name may not have seen the writes that the successor had
            // overwritten.
            let mut lives: BTreeSet<Id> = self.lives(id).into_iter().collect();
            loop {
                let sees = |event: &Event| lives.iter().any(|id| self.sees(event, *id));
                let heirs = writers().filter(|(_, event)| sees(event)).flat_map(|(id, _)| self.lives(*id));
                let more: Vec<Id> = heirs.filter(|id| !lives.contains(id)).collect();
                if more.is_empty() {
                    break;
                }
                lives.extend(more);
            }
            let heirs: Vec<&Event> = writers().filter(|(id, _)| lives.contains(id)).map(|(_, event)| event).collect();
            let deleted = heirs.iter().any(|event| deletes(event));
            (heirs.iter().map(|event| event.txn.written()).collect::<BTreeSet<_>>(), deleted)
        };
        let ((a, a_deleted), (b, b_deleted)) = (heirs(a), heirs(b));
        let mut pairs = self.listed.iter().filter(|(of, ..)| of == key);
        a_deleted
            || b_deleted
            || pairs.any(|(_, x, y)| a.contains(x) && b.contains(y) || a.contains(y) && b.contains(x))
    }
}

/// Returns the versions that are not deletions.
fn values(versions: &[Version]) -> impl Iterator<Item = &Version> {
    versions.iter().filter(|version| version.value.is_some())
}

fn note(listed: &mut BTreeSet<(Key, Timestamp, Timestamp)>, key: &Key, versions: &[Version]) {
    for (index, a) in versions.iter().enumerate() {
        for b in &versions[index + 1..] {
            listed.insert((key.clone(), a.stamp.min(b.stamp), a.stamp.max(b.stamp)));
        }
    }
}
