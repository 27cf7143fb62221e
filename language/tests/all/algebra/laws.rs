//! The laws, and equations that do not hold: two expressions are compared step by step, with every event in every
//! state.

use super::pair::{command, event_of, outcome_of};
use super::reference::{Command, Declared, Event, Outcome, Reason, Term};
use super::spec::Spec;
use language::algebra::{Activity, Cell, Program, State, step};
use std::collections::HashSet;

/// Members 0 to 5 are tasks, 6 to 8 services.
pub(crate) const TASKS: u32 = 6;
const MEMBERS: u32 = 9;

#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum UpTo {
    /// The same commands and outcomes.
    Nothing,
    /// The commands of one reaction may come in another order.
    Order,
    /// An abort may name another of several causes.
    Reason,
}

fn program(term: &Term) -> Program {
    let declared = |member| if member < TASKS { Declared::Task } else { Declared::Service };
    let spec = Spec { term: term.clone(), declared: (0..MEMBERS).map(declared).collect() };
    Program::compile(&spec.group())
}

/// Returns the events that lead to a difference, or none. Values are empty, so that tuples cannot differ.
fn difference(left: &Term, right: &Term, up_to: UpTo) -> Option<Vec<Event>> {
    let (p, q) = (program(left), program(right));
    let mut seen = HashSet::new();
    let mut todo = vec![(State::new(&p), State::new(&q), vec![])];
    while let Some((s, t, trace)) = todo.pop() {
        for event in events(&s) {
            let (mut s, mut t, mut trace) = (s.clone(), t.clone(), trace.clone());
            trace.push(event.clone());
            if react(&p, &mut s, &event, up_to) != react(&q, &mut t, &event, up_to) {
                return Some(trace);
            }
            if seen.insert((configuration(&s), configuration(&t))) {
                todo.push((s, t, trace));
            }
        }
    }
    None
}

fn configuration(state: &State) -> (Vec<Cell>, Vec<usize>) {
    let (cells, queue) = state.configuration();
    (cells.to_vec(), queue.to_vec())
}

fn react(program: &Program, state: &mut State, event: &Event, up_to: UpTo) -> (Vec<Command>, Option<Outcome>) {
    let mut commands = Vec::new();
    let mut outcome = step(program, state, event_of(event), &mut commands).map(outcome_of);
    let mut commands: Vec<Command> = commands.iter().map(command).collect();
    if up_to == UpTo::Order {
        commands.sort();
    }
    if up_to == UpTo::Reason && matches!(outcome, Some(Outcome::Aborted(_))) {
        outcome = Some(Outcome::Aborted(Reason::Instant));
    }
    (commands, outcome)
}

fn events(state: &State) -> Vec<Event> {
    let mut events = if state.is_idle() { vec![Event::Start(vec![])] } else { vec![Event::Stop] };
    for member in state.members_active() {
        let n = state.activation(member).0;
        events.push(Event::Aborted(member, n, vec![]));
        if member < TASKS || state.activity(member) == Activity::Stopping {
            events.push(Event::Done(member, n, vec![]));
        }
        events.push(Event::Unconfirmed(member, n));
    }
    events
}

pub(crate) fn law(left: &Term, right: &Term, up_to: UpTo) {
    if let Some(trace) = difference(left, right, up_to) {
        panic!("{left:?} is not {right:?}: {trace:?}");
    }
}

pub(crate) fn no_law(left: &Term, right: &Term) {
    assert!(difference(left, right, UpTo::Order).is_some(), "{left:?} is {right:?} after all");
}

pub(crate) fn leaf(member: u32) -> Term {
    Term::Leaf(member, vec![member])
}

pub(crate) fn two(operator: fn(Box<Term>, Box<Term>) -> Term, e: &Term, f: &Term) -> Term {
    operator(Box::new(e.clone()), Box::new(f.clone()))
}

pub(crate) fn many(operator: fn(Vec<Term>) -> Term, es: &[&Term]) -> Term {
    operator(es.iter().copied().cloned().collect())
}

/// Returns operands with the members `task`, `task + 1`, `service`, none of which ends at once.
fn operands(task: u32, service: u32) -> Vec<Term> {
    let (a, b, s) = (leaf(task), leaf(task + 1), leaf(service));
    let mut all = tasks(task);
    all.extend([two(Term::Rec, &a, &b), many(Term::Par, &[&a, &s]), many(Term::Dis, &[&s, &a]), s]);
    all
}

/// Returns operands that are not services and do not end at once.
fn tasks(task: u32) -> Vec<Term> {
    let (a, b) = (leaf(task), leaf(task + 1));
    let binary = [Term::Seq, Term::Cond, Term::Else].map(|operator| two(operator, &a, &b));
    let n_ary = [Term::Par, Term::Dis, Term::Ff].map(|operator| many(operator, &[&a, &b]));
    [vec![a], binary.to_vec(), n_ary.to_vec()].concat()
}

/// Calls `check` with all P, Q without common members.
pub(crate) fn pairs(kind: fn(u32) -> Vec<Term>, check: impl Fn(&Term, &Term)) {
    for p in kind(0) {
        for q in kind(1) {
            check(&p, &q);
        }
    }
}

/// Calls `check` with all P, Q, R without common members.
pub(crate) fn triples(kind: fn(u32) -> Vec<Term>, check: impl Fn(&Term, &Term, &Term)) {
    pairs(kind, |p, q| kind(2).iter().for_each(|r| check(p, q, r)));
}

pub(crate) fn any_operands(which: u32) -> Vec<Term> {
    operands(2 * which, TASKS + which)
}

fn task_operands(which: u32) -> Vec<Term> {
    tasks(2 * which)
}

pub(crate) fn with_constants(which: u32) -> Vec<Term> {
    let constants = [Term::Skip, Term::Never, Term::Fail("f".into())];
    [operands(2 * which, TASKS + which), constants.to_vec()].concat()
}

#[test]
fn sequence_and_condition_are_associative() {
    triples(with_constants, |p, q, r| {
        for inner in [Term::Seq, Term::Cond] {
            for outer in [Term::Seq, Term::Cond] {
                let left = two(outer, &two(inner, p, q), r);
                law(&left, &two(inner, p, &two(outer, q, r)), UpTo::Nothing);
            }
        }
    });
}

#[test]
fn recurrence_unfolds() {
    pairs(with_constants, |p, q| {
        let recurrent = two(Term::Rec, p, q);
        law(&recurrent, &two(Term::Cond, p, &two(Term::Seq, q, &recurrent)), UpTo::Nothing);
    });
}

#[test]
fn else_is_associative() {
    triples(with_constants, |p, q, r| {
        let left = two(Term::Else, &two(Term::Else, p, q), r);
        law(&left, &two(Term::Else, p, &two(Term::Else, q, r)), UpTo::Nothing);
    });
}

#[test]
fn constants_are_units_and_zeros() {
    let fail = Term::Fail("f".into());
    for p in with_constants(0) {
        law(&two(Term::Seq, &Term::Skip, &p), &p, UpTo::Nothing);
        law(&two(Term::Seq, &fail, &p), &fail, UpTo::Nothing);
        law(&two(Term::Cond, &fail, &p), &fail, UpTo::Nothing);
        law(&two(Term::Else, &Term::Skip, &p), &Term::Skip, UpTo::Nothing);
        law(&many(Term::Dis, &[&Term::Skip, &p]), &Term::Skip, UpTo::Nothing);
        law(&many(Term::Dis, &[&Term::Never, &p]), &p, UpTo::Nothing);
        law(&many(Term::Par, &[&Term::Never, &p]), &p, UpTo::Nothing);
    }
}

#[test]
fn disabling_and_concurrency_commute() {
    pairs(any_operands, |p, q| {
        for operator in [Term::Dis, Term::Par, Term::Ff] {
            law(&many(operator, &[p, q]), &many(operator, &[q, p]), UpTo::Order);
        }
    });
    let r = leaf(4);
    pairs(any_operands, |p, q| law(&many(Term::Dis, &[p, q, &r]), &many(Term::Dis, &[&r, p, q]), UpTo::Order));
}

/// Up to the reason: in the nested form the first abort of `P, Q` counts from when the last of them has ended.
#[test]
fn concurrency_of_tasks_is_associative() {
    triples(task_operands, |p, q, r| {
        let nested = many(Term::Par, &[&many(Term::Par, &[p, q]), r]);
        law(&nested, &many(Term::Par, &[p, q, r]), UpTo::Reason);
    });
    let [p, q, r] = [0, 1, 2].map(leaf);
    no_law(&many(Term::Par, &[&many(Term::Par, &[&p, &q]), &r]), &many(Term::Par, &[&p, &q, &r]));
}

#[test]
fn nested_disabling_is_not_flat() {
    let (p, q, r) = (leaf(0), leaf(1), leaf(2));
    no_law(&many(Term::Dis, &[&many(Term::Dis, &[&p, &q]), &r]), &many(Term::Dis, &[&p, &q, &r]));
}

#[test]
fn nested_concurrency_with_a_service_is_not_flat() {
    let (s, p, q) = (leaf(TASKS), leaf(0), leaf(1));
    no_law(&many(Term::Par, &[&many(Term::Par, &[&s, &p]), &q]), &many(Term::Par, &[&s, &p, &q]));
}

#[test]
fn disabling_by_a_constant_does_not_commute() {
    no_law(&many(Term::Dis, &[&leaf(0), &Term::Skip]), &many(Term::Dis, &[&Term::Skip, &leaf(0)]));
}

#[test]
fn else_does_not_distribute_over_sequence() {
    let (p, q, r) = (leaf(0), leaf(1), leaf(2));
    no_law(&two(Term::Else, &two(Term::Seq, &p, &q), &r), &two(Term::Seq, &p, &two(Term::Else, &q, &r)));
}

#[test]
fn condition_is_not_sequence_for_values() {
    let (p, q) = (program(&two(Term::Cond, &leaf(0), &leaf(1))), program(&two(Term::Seq, &leaf(0), &leaf(1))));
    let (mut s, mut t) = (State::new(&p), State::new(&q));
    for event in [Event::Start(vec![]), Event::Done(0, 1, b"found".to_vec())] {
        let same = react(&p, &mut s, &event, UpTo::Nothing) == react(&q, &mut t, &event, UpTo::Nothing);
        assert_eq!(same, event == Event::Start(vec![]));
    }
}
