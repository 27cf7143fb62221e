//! Laws of the merge rule, compared with a fold over the set of transactions.

use super::*;
use crate::logic::version_vector::ReplicaId;
use proptest::prelude::*;
use std::collections::BTreeMap;

/// A committed transaction, with everything that it had seen.
#[derive(Clone, Debug)]
struct Event {
    dot: Dot,
    stamp: Timestamp,
    context: VersionVector,
    writes: Vec<Write>,
}

/// One step: the replica that commits, the replica whose state it has taken over before, and the keys that it puts
/// (true) or deletes.
type Step = (u8, u8, Vec<(u8, bool)>);

/// A history of three origins.
fn history() -> impl Strategy<Value = Vec<Step>> {
    let writes = proptest::collection::vec((0..4_u8, any::<bool>()), 0..4);
    proptest::collection::vec((0..3_u8, 0..3_u8, writes), 1..14)
}

fn key(number: u8) -> Key {
    Key::new(format!("k{number}")).unwrap()
}

/// Runs a history: in each step one origin learns everything that another one knows, and commits.
fn events(steps: Vec<Step>) -> Vec<Event> {
    let mut vectors = vec![VersionVector::default(); 3];
    let mut clocks = [0_u64; 3];
    let mut events = Vec::new();
    for (who, other, changes) in steps {
        let (me, peer) = (usize::from(who), usize::from(other));
        let known = vectors[peer].clone();
        vectors[me].join(&known);
        clocks[me] = clocks[me].max(clocks[peer]) + 1;
        let origin = ReplicaId::new(u64::from(who) + 1);
        let dot = Dot { origin, seq: vectors[me].get(origin) + 1 };
        let writes: BTreeMap<u8, bool> = changes.into_iter().collect();
        let value = |put: bool| put.then(|| Value::from(&dot.seq.to_le_bytes()));
        let writes = writes.into_iter().map(|(k, put)| Write { key: key(k), value: value(put) }).collect();
        let stamp = Timestamp { epoch: 0, hlc: clocks[me], origin };
        events.push(Event { dot, stamp, context: vectors[me].clone(), writes });
        vectors[me].include(dot);
    }
    events
}

/// Applies events in an order that `choices` selects among the permitted orders.
fn run(events: &[Event], choices: &[u8]) -> State {
    let mut state = State::default();
    let mut left: Vec<&Event> = events.iter().collect();
    let mut vector = VersionVector::default();
    let mut choices = choices.iter().copied().cycle();
    while !left.is_empty() {
        let ready =
            |event: &&Event| vector.dominates(&event.context) && vector.get(event.dot.origin) + 1 == event.dot.seq;
        let ready: Vec<usize> = (0..left.len()).filter(|index| ready(&left[*index])).collect();
        assert!(!ready.is_empty(), "T7: among the missing ones the first by causality can always be applied");
        let event = left.remove(ready[usize::from(choices.next().unwrap_or(0)) % ready.len()]);
        state.apply(event.dot, event.stamp, CausalContext { context: &event.context, only: None }, &event.writes);
        vector.include(event.dot);
    }
    state
}

proptest! {
    #[test]
    fn any_order_gives_the_same_state(steps in history(), choices: Vec<u8>) {
        let events = events(steps);
        let (one, other) = (run(&events, &[]), run(&events, &choices));
        prop_assert_eq!(&one.entries, &other.entries);
        prop_assert_eq!(one.digest(), other.digest());
        prop_assert_eq!(one, other);
    }

    #[test]
    fn a_read_shows_the_last_write_by_stamp_and_conflicts_are_the_concurrent_ones(steps in history()) {
        let events = events(steps);
        let state = run(&events, &[]);
        for number in 0..4 {
            let key = key(number);
            let writes = |event: &&Event| event.writes.iter().any(|write| write.key == key);
            let written: Vec<&Event> = events.iter().filter(writes).collect();
            let last = written.iter().max_by_key(|event| event.stamp);
            let shown = state.versions(&key).last();
            prop_assert_eq!(shown.map(|version| version.dot), last.map(|event| event.dot));
            let unseen = |event: &&&Event| !written.iter().any(|other| other.context.contains(event.dot));
            let mut maximal: Vec<&&Event> = written.iter().filter(unseen).collect();
            maximal.sort_by_key(|event| event.stamp);
            let maximal: Vec<Dot> = maximal.iter().map(|event| event.dot).collect();
            let versions: Vec<Dot> = state.versions(&key).iter().map(|version| version.dot).collect();
            prop_assert_eq!(versions, maximal);
        }
    }

    #[test]
    fn what_was_deleted_for_everybody_can_be_dropped(steps in history()) {
        let mut state = run(&events(steps), &[]);
        let before = state.clone();
        let everything = (1..4).map(|origin| (ReplicaId::new(origin), u64::MAX)).collect();
        state.drop_deleted(&everything);
        prop_assert_eq!(&state, &before);
        prop_assert_eq!(state.digest(), before.digest());
        prop_assert!(state.entries.values().all(|versions| !is_deleted(versions)));
    }
}

/// Returns a state with one write of each origin, none of which has seen another.
fn concurrent(count: u64) -> State {
    let mut state = State::default();
    for number in 1..=count {
        let origin = ReplicaId::new(number);
        let stamp = Timestamp { epoch: 0, hlc: number, origin };
        let writes = [Write { key: key(0), value: Some((&number.to_le_bytes()).into()) }];
        let context = VersionVector::default();
        state.apply(Dot { origin, seq: 1 }, stamp, CausalContext { context: &context, only: None }, &writes);
    }
    state
}

#[test]
fn a_100_way_conflict_on_one_key_is_kept_and_one_write_resolves_it() {
    let mut state = concurrent(100);
    assert_eq!((state.versions(&key(0)).len(), state.conflicts("").count()), (100, 1));
    let context: VersionVector = (1..=100).map(|number| (ReplicaId::new(number), 1)).collect();
    let stamp = Timestamp { epoch: 0, hlc: 101, origin: ReplicaId::new(1) };
    let writes = [Write { key: key(0), value: Some(b"y".into()) }];
    state.apply(
        Dot { origin: ReplicaId::new(1), seq: 2 },
        stamp,
        CausalContext { context: &context, only: None },
        &writes,
    );
    assert_eq!((state.versions(&key(0)).len(), state.conflicts("").count()), (1, 0));
}

#[test]
fn conditions() {
    let check = |state: &State, condition| state.check(&Require { key: key(0), condition }).is_ok();
    let (none, one, two) = (State::default(), concurrent(1), concurrent(2));
    let dot = |number| Condition::Is(Dot { origin: ReplicaId::new(number), seq: 1 });
    assert_eq!([Condition::Absent, Condition::Exists, dot(1)].map(|c| check(&none, c)), [true, false, false]);
    assert_eq!([Condition::Absent, Condition::Exists, dot(1)].map(|c| check(&one, c)), [false, true, true]);
    assert_eq!([Condition::Absent, Condition::Exists, dot(2)].map(|c| check(&two, c)), [false, true, false]);
    let refused = two.check(&Require { key: key(0), condition: dot(2) }).unwrap_err();
    assert!(
        refused.to_string().starts_with("`k0` is required to ") && !refused.to_string().contains("Dot {"),
        "{refused}"
    );
}

#[test]
fn utf8_prefix_edge() {
    let mut state = State::default();
    for name in ["a", "a/b", "a/é", "ab", "b"] {
        let version =
            Version { dot: Dot { origin: ReplicaId::new(1), seq: 1 }, stamp: Timestamp::default(), value: None };
        state.restore(Key::new(name).unwrap(), vec![version]);
    }
    let scan = |prefix: &str| state.scan(prefix).map(|(key, _)| key.as_str().to_owned()).collect::<Vec<_>>();
    assert_eq!(scan(""), ["a", "a/b", "a/é", "ab", "b"]);
    assert_eq!(scan("a/"), ["a/b", "a/é"]);
    assert_eq!(scan("a"), ["a", "a/b", "a/é", "ab"]);
    assert_eq!(scan("a/é"), ["a/é"]);
    assert_eq!(scan("c"), Vec::<String>::new());
}

#[test]
fn the_same_resolution_twice_is_none() {
    let mut state = concurrent(2);
    let context: VersionVector = [(ReplicaId::new(1), 1), (ReplicaId::new(2), 1)].into_iter().collect();
    for number in 1..=2 {
        let origin = ReplicaId::new(number);
        let stamp = Timestamp { epoch: 0, hlc: 10, origin };
        let writes = [Write { key: key(0), value: Some(b"both".into()) }];
        state.apply(Dot { origin, seq: 2 }, stamp, CausalContext { context: &context, only: None }, &writes);
    }
    assert_eq!((state.versions(&key(0)).len(), state.is_conflict(&key(0))), (2, false));
    let require = Require { key: key(0), condition: Condition::Is(Dot { origin: ReplicaId::new(2), seq: 2 }) };
    assert_eq!(state.check(&require), Ok(()));
}
