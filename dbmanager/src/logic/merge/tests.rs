//! Two sides of a partition that have retired each other, with cut logs and dropped deletions, compared with the set
//! of all transactions.

use super::*;
use crate::logic::clock::Wall;
use crate::logic::log::Verdict;
use crate::logic::state::CausalContext;
use crate::logic::txn::{EncodedTxn, Rebase, Txn};
use proptest::prelude::*;

/// A replica, and the timestamps of all transactions it knows.
#[derive(Clone, Default)]
struct Node {
    log: Log,
    state: State,
    knows: BTreeSet<Timestamp>,
}

/// A transaction, as it was committed.
struct Event {
    stamp: Timestamp,
    knew: BTreeSet<Timestamp>,
    writes: Vec<Write>,
}

/// One step: the replica, the replica that it merges with, and the keys that it puts (true) or deletes.
type Step = (usize, usize, Vec<(u8, bool)>);

fn steps(most: usize) -> impl Strategy<Value = Vec<Step>> {
    let writes = proptest::collection::vec((0..4_u8, any::<bool>()), 0..4);
    proptest::collection::vec((0..4_usize, 0..4_usize, writes), 0..most)
}

fn write(key: &str, value: Option<u64>) -> Write {
    Write { key: Key::new(key).unwrap(), value: value.map(|value| (&value.to_le_bytes()).into()) }
}

impl Node {
    fn commit(&mut self, stamp: Timestamp, writes: Vec<Write>, rebase: Option<Rebase>) {
        let origin = stamp.origin;
        let head = self.log.head(origin).cloned().unwrap_or_default();
        let context = self.log.vector().clone().without(origin);
        let (wall, reason, requires) = (Wall::default(), String::new(), Vec::new());
        let (seq, prev, wants_ack) = (head.seq + 1, head.hash, false);
        let txn = Txn { stamp, seq, prev, wall, context, reason, requires, writes, wants_ack, rebase };
        assert!(self.enter(&EncodedTxn::seal(&txn).unwrap()));
    }

    fn enter(&mut self, encoded: &EncodedTxn) -> bool {
        let txn = encoded.open().unwrap();
        if self.log.judge(&txn, encoded) != Verdict::Next {
            return false;
        }
        let only = txn.rebase.as_ref().map(|rebase| rebase.takes.as_slice());
        let context = self.log.context(&txn);
        let context = if only.is_some() { context.without(txn.stamp.origin) } else { context };
        self.state.apply(txn.dot(), txn.written(), CausalContext { context: &context, only }, &txn.writes);
        self.log.append(&txn, encoded.clone());
        true
    }

    fn take(&mut self, other: &Self) {
        for (_, encoded) in other.log.in_order() {
            self.enter(encoded);
        }
        assert!(self.log.vector().dominates(other.log.vector()), "a log was cut too early");
        self.knows.extend(&other.knows);
    }

    /// Comes back as `origin`, with the state of `sponsor`; returns the replica after that.
    fn come_back(&self, sponsor: &Self, origin: ReplicaId, mut hlc: u64) -> Self {
        let mut back = Self { log: Log::new(sponsor.log.heads().clone()), ..sponsor.clone() };
        let (old_members, members) = (Members::of(&self.state), Members::of(&sponsor.state));
        let old = Side { state: &self.state, log: &self.log, members: &old_members };
        let new = Side { state: &sponsor.state, log: &sponsor.log, members: &members };
        let mut next = || {
            hlc += 1;
            Timestamp { epoch: 0, hlc, origin }
        };
        for ((stamp, from), piece) in rebase(old, new, &Forked::new(), origin) {
            let takes: BTreeSet<Dot> = piece.iter().flat_map(|(_, takes)| takes).copied().collect();
            let taken = sponsor.state.scan("").flat_map(|(_, versions)| versions).filter(|v| takes.contains(&v.dot));
            assert!(taken.into_iter().all(|version| version.stamp < stamp), "T2");
            let rebase = Rebase { from, stamp, takes: takes.into_iter().collect() };
            back.commit(next(), piece.into_iter().map(|(write, _)| write).collect(), Some(rebase));
        }
        back.commit(next(), member::arrival(origin, &arrival(old, new, &Forked::new())), None);
        back.knows.extend(&self.knows);
        back
    }
}

/// The replicas, and the events so far.
struct Team {
    nodes: Vec<Node>,
    events: Vec<Event>,
    hlc: u64,
}

impl Team {
    /// Returns four replicas. The second and the fourth always stay members, and so do the origins under which
    /// replicas come back.
    fn new() -> Self {
        let mut first = Node::default();
        let members = [2, 4, 10, 11].map(|number| member::admission(ReplicaId::new(number), "r").unwrap());
        first.commit(Timestamp { epoch: 0, hlc: 1, origin: ReplicaId::new(2) }, members.to_vec(), None);
        Self { nodes: vec![first; 4], events: Vec::new(), hlc: 1 }
    }

    fn commit(&mut self, node: usize, writes: &[(u8, bool)]) {
        self.hlc += 1;
        let stamp = Timestamp { epoch: 0, hlc: self.hlc, origin: ReplicaId::new(node as u64 + 1) };
        let writes: BTreeMap<u8, bool> = writes.iter().copied().collect();
        let value = |put: bool| put.then_some(self.hlc);
        let writes: Vec<Write> = writes.into_iter().map(|(k, put)| write(&format!("k{k}"), value(put))).collect();
        let node = &mut self.nodes[node];
        self.events.push(Event { stamp, knew: node.knows.clone(), writes: writes.clone() });
        node.commit(stamp, writes, None);
        node.knows.insert(stamp);
    }

    /// Runs steps between replicas that can reach each other according to `together`. They may drop transactions that
    /// all of them have.
    fn run(&mut self, steps: &[Step], drops: bool, together: impl Fn(usize, usize) -> bool) {
        for (node, other, writes) in steps {
            let group: Vec<usize> = (0..4).filter(|other| together(*node, *other)).collect();
            if writes.is_empty() && together(*node, *other) {
                let other = self.nodes[*other].clone();
                self.nodes[*node].take(&other);
            } else {
                self.commit(*node, writes);
            }
            let vector = self.nodes[*node].log.vector().clone();
            if drops && group.iter().all(|other| *self.nodes[*other].log.vector() == vector) {
                for other in group {
                    self.nodes[other].state.drop_deleted(&vector);
                    self.nodes[other].log.truncate(&vector, 0);
                }
            }
        }
    }

    /// Returns the timestamps of the values at a key that were not overwritten by a writer who had seen them.
    fn expected(&self, key: u8) -> BTreeSet<Timestamp> {
        let key = Key::new(format!("k{key}")).unwrap();
        let writes = |event: &&Event| event.writes.iter().any(|write| write.key == key);
        let all: Vec<&Event> = self.events.iter().filter(writes).collect();
        let puts = all.iter().filter(|event| event.writes.iter().any(|w| w.key == key && w.value.is_some()));
        puts.filter(|event| !all.iter().any(|by| by.knew.contains(&event.stamp))).map(|event| event.stamp).collect()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn who_comes_back_brings_all_that_is_left_once_and_nothing_else(
        common in steps(12), apart in steps(24), between in steps(6), later in steps(6)
    ) {
        let mut team = Team::new();
        team.run(&common, true, |_, _| true);
        let meet = [(0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0)].map(|(node, other)| (node, other, Vec::new()));
        team.run(&meet, true, |_, _| true);
        team.run(&apart, true, |a, b| a % 2 == b % 2);
        let first = team.nodes[0].come_back(&team.nodes[1], ReplicaId::new(10), 1000);
        team.nodes[1].take(&first);
        let theirs: Vec<Step> = between.into_iter().map(|(a, b, writes)| (a | 1, b | 1, writes)).collect();
        team.hlc = 2000;
        team.run(&theirs, false, |a, b| a % 2 == b % 2);
        let sponsor = team.nodes[1].clone();
        team.nodes[3].take(&sponsor);
        let second = team.nodes[2].come_back(&team.nodes[3], ReplicaId::new(11), 3000);
        team.hlc = 4000;
        let theirs: Vec<Step> = later.into_iter().map(|(a, b, writes)| (a | 1, b | 1, writes)).collect();
        team.run(&theirs, false, |a, b| a % 2 == b % 2);
        team.nodes[3].take(&second);
        let mut all = team.nodes[3].clone();
        all.take(&team.nodes[1]);
        for key in 0..4 {
            let name = Key::new(format!("k{key}")).unwrap();
            let values = all.state.versions(&name).iter().filter(|version| version.value.is_some());
            let found: Vec<Timestamp> = values.map(|version| version.stamp).collect();
            prop_assert_eq!(found, team.expected(key).into_iter().collect::<Vec<_>>(), "at {}", name);
        }
    }
}

#[test]
fn of_a_number_used_twice_both_transactions_stay() {
    let mut team = Team::new();
    team.commit(0, &[(0, true)]);
    let clone = team.nodes[0].clone();
    team.commit(0, &[(0, true)]);
    let mut other = Team { nodes: vec![clone; 4], events: Vec::new(), hlc: 50 };
    other.commit(0, &[(0, true)]);
    let (old, new) = (&team.nodes[0], &other.nodes[0]);
    let members = [Members::of(&old.state), Members::of(&new.state)];
    let side = Side { state: &old.state, log: &old.log, members: &members[0] };
    let sponsor = Side { state: &new.state, log: &new.log, members: &members[1] };
    let pieces = rebase(side, sponsor, &Forked::from([(ReplicaId::new(1), 1)]), ReplicaId::new(10));
    let left: Vec<&Piece> = pieces.values().filter(|piece| !piece.is_empty()).collect();
    assert!(
        matches!(left[..], [piece] if piece.len() == 1 && piece[0].1.is_empty()),
        "it takes nothing away: {left:?}"
    );
}
