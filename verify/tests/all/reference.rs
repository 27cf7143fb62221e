//! The explorer agrees with an independent reference, by brute force, on many random expressions.
//!
//! The reference in `reference/term.rs` rewrites terms by the rules of the language and knows nothing of `step`, of packed
//! states or of the explorer. Both say in which situations the processes can be together, and whether the whole can get stuck.

mod random;
mod term;

use language::algebra::Activity;
use language::plan::{Group, Leaf, LeafKind, Member, MemberKind, Plan, Policy};
use language::sites::{GroupSites, LeafFacts, Sites};
use language::{Origin, Span};
use random::Random;
use std::collections::BTreeSet;
use std::time::Duration;
use term::{Expr, Phase, Universe};
use verify::{Alone, Always, Detail, Ending, Limits, flat, transitions};

/// As many random specs are compared.
const CASES: u64 = 10_000;
/// As many processes has a spec at most.
const LEAVES_MAX: usize = 5;

fn plan(expr: &Expr, services: &[bool]) -> Plan {
    let leaf = |index: usize| Leaf {
        path: format!("main/p{index}"),
        module: "Step".to_owned(),
        host: 0,
        arguments: Vec::new(),
        exec: None,
        kind: LeafKind::Controller,
        stop_within: Duration::from_secs(2),
        outcomes: Vec::new(),
        policy: Policy::default(),
        keys: Vec::new(),
        external: None,
    };
    let member = |(index, &service): (usize, &bool)| Member {
        name: format!("p{index}"),
        kind: MemberKind::Leaf(u32::try_from(index).unwrap_or(u32::MAX)),
        service,
    };
    let group = Group {
        path: "main".to_owned(),
        process: "main".to_owned(),
        host: 0,
        members: services.iter().enumerate().map(member).collect(),
        sets: Vec::new(),
        sets_always: Vec::new(),
        expression: expr.lower(),
        supervision: Default::default(),
    };
    Plan {
        name: "random".to_owned(),
        hosts: vec!["c1".to_owned()],
        groups: vec![group],
        leaves: (0..services.len()).map(leaf).collect(),
        wires: Vec::new(),
        claims: Vec::new(),
        on_boot: Default::default(),
    }
}

fn sites(leaves: usize) -> Sites {
    let span = Span { origin: Origin::Spec, start: 0, end: 0 };
    let group = GroupSites { name: span, members: vec![span; leaves], nodes: Vec::new(), sets: Vec::new() };
    Sites { groups: vec![group], leaves: vec![LeafFacts::default(); leaves], properties: Vec::new() }
}

#[test]
fn situations_and_verdicts_agree_with_the_reference() {
    let limits = Limits { states: 1_000_000, memory: 1 << 30, threads: &Alone, goes_on: &Always };
    let (mut states, mut stuck, mut hanging) = (0_u64, 0, 0);
    for seed in 0..CASES {
        let mut random = Random::new(seed);
        let services: Vec<bool> = (0..LEAVES_MAX).map(|_| random.below(4) == 0).collect();
        let expr = random.expression(&mut (0..LEAVES_MAX).collect::<Vec<_>>(), 3);
        let found = flat(&plan(&expr, &services), &sites(LEAVES_MAX), &limits, Detail::All);
        let expected = Universe::explore(&expr, &services);
        let situations: BTreeSet<(Vec<u8>, Phase)> = found
            .situations
            .iter()
            .map(|(activities, ending)| {
                let number = |activity: &Activity| match activity {
                    Activity::Idle => 0,
                    Activity::Active => 1,
                    Activity::Stopping => 2,
                };
                let phase = match ending {
                    Ending::Idle => Phase::Idle,
                    Ending::Running => Phase::Running,
                    Ending::Stopping => Phase::Stopping,
                    Ending::Done => Phase::Done,
                    Ending::Aborted => Phase::Aborted,
                    Ending::Stopped => Phase::Stopped,
                };
                (activities.iter().map(number).collect(), phase)
            })
            .collect();
        assert_eq!(situations, expected.situations, "seed {seed}: {expr:?} {services:?}");
        assert_eq!(found.gets_stuck, expected.gets_stuck, "seed {seed}: {expr:?} {services:?}");
        assert_eq!(found.stop_hangs, expected.stop_hangs, "seed {seed}: {expr:?} {services:?}");
        assert_eq!(found.states as usize, expected.states, "seed {seed}: {expr:?} {services:?}");
        states += u64::from(found.states);
        stuck += u64::from(found.gets_stuck);
        hanging += u64::from(found.stop_hangs);
    }
    assert!(states > 100_000 && stuck > 100, "{states} states, {stuck} stuck, {hanging} stops that hang");
}

/// As many random specs are exported and read again.
const EXPORTS: u64 = 1_000;

/// What another tool would find in the export: a checker of its own that reads the Aldebaran format and knows no spec.
#[test]
fn the_exported_system_has_the_states_and_the_dead_ends_of_the_reference() {
    let limits = Limits { states: 1_000_000, memory: 1 << 30, threads: &Alone, goes_on: &Always };
    let mut dead = 0;
    for seed in 0..EXPORTS {
        let mut random = Random::new(seed);
        let services: Vec<bool> = (0..LEAVES_MAX).map(|_| random.below(4) == 0).collect();
        let expr = random.expression(&mut (0..LEAVES_MAX).collect::<Vec<_>>(), 3);
        let exported = transitions(&plan(&expr, &services), &sites(LEAVES_MAX), &limits);
        let expected = Universe::explore(&expr, &services);
        let (states, all) = read_aut(&exported.aut());
        assert_eq!(states, expected.states, "seed {seed}: {expr:?}");
        let ends = can_end(states, &all);
        let has_dead_end = (1..states).any(|state| !ends[state]);
        assert_eq!(has_dead_end, expected.gets_stuck || expected.stop_hangs, "seed {seed}: {expr:?}");
        assert_eq!(exported.dot().matches(" -> ").count(), all.len());
        dead += usize::from(has_dead_end);
    }
    assert!(dead > 10, "only {dead} have dead ends");
}

fn read_aut(text: &str) -> (usize, Vec<(usize, String, usize)>) {
    let mut lines = text.lines();
    let head = lines.next().and_then(|line| line.strip_prefix("des (0, ")?.strip_suffix(')'));
    let (count, states) = head.and_then(|head| head.split_once(", ")).expect("a head");
    let read = |line: &str| {
        let (from, rest) = line.strip_prefix('(')?.split_once(", \"")?;
        let (word, to) = rest.strip_suffix(')')?.rsplit_once("\", ")?;
        Some((from.parse().ok()?, word.to_owned(), to.parse().ok()?))
    };
    let all: Vec<(usize, String, usize)> = lines.map(|line| read(line).expect("a transition")).collect();
    assert_eq!(count.parse(), Ok(all.len()));
    (states.parse().expect("a number of states"), all)
}

/// From which states one without transitions can be reached, nobody failing and nobody asking for a stop.
fn can_end(states: usize, all: &[(usize, String, usize)]) -> Vec<bool> {
    let mut ends = vec![true; states];
    all.iter().for_each(|(from, ..)| ends[*from] = false);
    let natural = |word: &str| ["start", "done(", "stopped(", "elapsed("].iter().any(|begin| word.starts_with(begin));
    loop {
        let before = ends.iter().filter(|end| **end).count();
        for (from, word, to) in all {
            ends[*from] |= natural(word) && ends[*to];
        }
        if ends.iter().filter(|end| **end).count() == before {
            return ends;
        }
    }
}
