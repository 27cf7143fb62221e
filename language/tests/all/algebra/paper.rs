//! The paper's own examples.
//!
//! Source: Petersson, Austin, Christensen, "DCA: a distributed control architecture for robotics", section 2.1.1 and
//! Appendix A.

use super::pair::Pair;
use super::reference::{Declared, Event, Outcome, Reason, Term};
use super::spec::Spec;
use language::algebra::Program;
use std::collections::{BTreeSet, HashSet};

fn leaf(member: u32) -> Term {
    Term::Leaf(member, vec![member])
}

fn leaves(members: impl IntoIterator<Item = u32>) -> Term {
    Term::Par(members.into_iter().map(leaf).collect())
}

fn sequence(steps: Vec<Term>) -> Term {
    let together = |tail, step| Term::Seq(Box::new(step), Box::new(tail));
    steps.into_iter().rev().reduce(together).expect("a sequence has steps")
}

/// Appendix A with its groups written out.
fn door(services: &[u32]) -> Spec {
    let motion = leaves([0, 1, 2]);
    let servoing = Term::Dis(vec![leaf(3), leaves([4, 5])]);
    let approach = Term::Dis(vec![leaves([6, 7]), leaves([8, 9])]);
    let open = leaves(12..19);
    let steps = sequence(vec![servoing, approach, leaf(10), leaf(11), open]);
    let declared = |member| if services.contains(&member) { Declared::Service } else { Declared::Task };
    Spec { term: Term::Par(vec![motion, steps]), declared: (0..19).map(declared).collect() }
}

/// The leaves that end by themselves: the two thresholds, opening, closing, pressing, and the door's model.
const ENDING: [u32; 6] = [5, 6, 9, 10, 11, 16];
/// The sensors and controllers that run until they are stopped.
const SERVICES: [u32; 13] = [0, 1, 2, 3, 4, 7, 8, 12, 13, 14, 15, 17, 18];

/// Explores fault-free runs: members end, and stop when asked to. Returns the number of states, the leaves that ever
/// run and whether the group can end.
fn fault_free(spec: &Spec) -> (usize, BTreeSet<u32>, bool) {
    let program = Program::compile(&spec.group());
    let mut first = Pair::new(spec, &program);
    first.send(&Event::Start(vec![])).expect("both interpreters agree");
    let (mut seen, mut ran, mut ends) = (HashSet::from([first.key().1]), BTreeSet::new(), false);
    let mut todo = vec![first];
    while let Some(pair) = todo.pop() {
        let (active, stopping) = pair.machine.members();
        ran.extend(active.iter().copied());
        let done = active.into_iter().filter(|member| ENDING.contains(member));
        let done = done.map(|member| Event::Done(member, pair.machine.epoch(member), vec![]));
        let stopped = stopping.into_iter().map(|member| Event::Stopped(member, pair.machine.epoch(member)));
        for event in done.chain(stopped) {
            let mut next = pair.clone();
            let outcome = next.send(&event).expect("both interpreters agree");
            ends |= matches!(outcome, Some(Outcome::Done(_)));
            if seen.insert(next.key().1) {
                todo.push(next);
            }
        }
    }
    (seen.len(), ran, ends)
}

#[test]
fn the_door_opens_with_services() {
    let (states, ran, ends) = fault_free(&door(&SERVICES));
    assert_eq!(ran, (0..19).collect(), "every leaf must run");
    assert!(ends, "the mission must be able to end");
    assert_eq!(states, 87, "86 while it runs, as the study has measured, and the end");
}

#[test]
fn the_door_stays_shut_without_services() {
    let (states, ran, ends) = fault_free(&door(&[]));
    assert_eq!((states, ran.len(), ends), (2, 6, false));
}

/// Sends events of first activations. Returns the outcome of the last one, and the active and the stopping members.
fn scenario(spec: &Spec, events: &[Event]) -> (Option<Outcome>, Vec<u32>, Vec<u32>) {
    let program = Program::compile(&spec.group());
    let mut pair = Pair::new(spec, &program);
    let mut outcome = pair.send(&Event::Start(vec![])).expect("both interpreters agree");
    for event in events {
        assert_eq!(outcome, None, "ended before {event:?}");
        outcome = pair.send(event).expect("both interpreters agree");
    }
    let (active, stopping) = pair.machine.members();
    (outcome, active.into_iter().collect(), stopping.into_iter().collect())
}

#[test]
fn the_arm_stops_when_the_force_sensor_dies() {
    let visual = [Event::Done(5, 1, vec![]), Event::Stopped(4, 1), Event::Stopped(3, 1)];
    let crash = [Event::Aborted(8, 1, b"SIGSEGV".to_vec())];
    let before = scenario(&door(&SERVICES), &visual);
    assert_eq!(before, (None, vec![0, 1, 2, 6, 7, 8, 9], vec![]));
    let after = scenario(&door(&SERVICES), &[&visual[..], &crash].concat());
    assert_eq!(after, (None, vec![0, 1, 2, 6, 7], vec![9]), "the detector fails when its own parts have stopped");
    let clean = [Event::Stopped(9, 1)];
    let failed = scenario(&door(&SERVICES), &[&visual[..], &crash, &clean].concat());
    assert_eq!(failed, (None, vec![0, 1, 2], vec![6, 7]), "what runs beside the detector stops");

    let rest = [9, 7, 6].map(|member| Event::Stopped(member, 1));
    let motion = scenario(&door(&SERVICES), &[&visual[..], &crash, &rest].concat());
    assert_eq!(motion, (None, vec![], vec![0, 1, 2]), "the sequence has failed, so motion control is not needed");
    let last = [0, 1, 2].map(|member| Event::Stopped(member, 1));
    let (outcome, ..) = scenario(&door(&SERVICES), &[&visual[..], &crash, &rest, &last].concat());
    assert_eq!(outcome, Some(Outcome::Aborted(Reason::Reported(8, b"SIGSEGV".to_vec()))));
}

/// `hit # (forcedata, compliant, puma)`
#[test]
fn compliant_motion_ends_with_the_hit() {
    let term = Term::Dis(vec![leaf(0), leaves([1, 2, 3])]);
    let spec = Spec { term, declared: [&[Declared::Task][..], &[Declared::Service; 3]].concat() };
    let hit = Event::Done(0, 1, b"12 N".to_vec());
    assert_eq!(scenario(&spec, std::slice::from_ref(&hit)), (None, vec![], vec![1, 2, 3]));
    let stopped = [3, 1, 2].map(|member| Event::Stopped(member, 1));
    let (outcome, ..) = scenario(&spec, &[&[hit][..], &stopped].concat());
    assert_eq!(outcome, Some(Outcome::Done(b"12 N".to_vec())));
}

/// `timeout # (FindA : PlaceA, FindB : PlaceB, FindC : PlaceC)` with the members 0, 1 to 3 and 4 to 6.
fn tidy_up() -> Spec {
    let object = |which: u32| Term::Cond(Box::new(leaf(1 + which)), Box::new(leaf(4 + which)));
    let term = Term::Dis(vec![leaf(0), Term::Par((0..3).map(object).collect())]);
    Spec { term, declared: vec![Declared::Task; 7] }
}

#[test]
fn tidying_up_goes_on_without_an_object_that_is_not_found() {
    let found = |object: u32| [Event::Done(1 + object, 1, b"pose".to_vec()), Event::Done(4 + object, 1, vec![])];
    let missing = [Event::Aborted(1, 1, b"not found".to_vec())];
    let placed = [&missing[..], &found(1), &found(2)].concat();
    assert_eq!(scenario(&tidy_up(), &missing), (None, vec![0, 2, 3], vec![]));
    assert_eq!(scenario(&tidy_up(), &placed), (None, vec![], vec![0]), "nothing is left to wait for");
    let (outcome, ..) = scenario(&tidy_up(), &[&placed[..], &[Event::Stopped(0, 1)]].concat());
    assert_eq!(outcome, Some(Outcome::Aborted(Reason::Reported(1, b"not found".to_vec()))));
}

#[test]
fn tidying_up_ends_with_the_timeout() {
    let late = [Event::Done(1, 1, vec![]), Event::Done(0, 1, b"late".to_vec())];
    assert_eq!(scenario(&tidy_up(), &late), (None, vec![], vec![2, 3, 4]));
    let stopped = [2, 3, 4].map(|member| Event::Stopped(member, 1));
    let (outcome, ..) = scenario(&tidy_up(), &[&late[..], &stopped].concat());
    assert_eq!(outcome, Some(Outcome::Done(b"late".to_vec())));
}

/// The parent sees a group of controllers as one service, and loses it like one.
#[test]
fn motion_control_is_inferred_to_be_a_service() {
    let motion = Spec { term: leaves([0, 1, 2]), declared: vec![Declared::Service; 3] };
    let detector = Spec { term: leaves([0, 1]), declared: vec![Declared::Service, Declared::Task] };
    assert!(Program::compile(&motion.group()).is_service());
    assert!(!Program::compile(&detector.group()).is_service());

    let parent = Spec { term: leaves([0, 1]), declared: vec![Declared::ServiceGroup, Declared::Task] };
    let lost = Event::Aborted(0, 1, vec![]);
    assert_eq!(scenario(&parent, &[lost]), (None, vec![], vec![1]));
    let (outcome, ..) = scenario(&parent, &[Event::Done(1, 1, vec![]), Event::Stopped(0, 1)]);
    assert_eq!(outcome, Some(Outcome::Done(vec![])));
}
