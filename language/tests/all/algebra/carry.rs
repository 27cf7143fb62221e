//! Groups whose event actions change while they run.

use super::random::{spec, term};
use super::reference::Term;
use super::spec::{Spec, any, number};
use language::algebra::{Activation, Activity, Command, Event, Outcome, Program, State, Value, carry, step};
use language::plan::{ConnectionSet, Expression, Group, Member, MemberKind, Supervision};
use proptest::collection::vec;
use proptest::prelude::prop;
use proptest::prelude::{ProptestConfig, TestCaseError};
use proptest::test_runner::{RngSeed, TestRunner};
use std::collections::BTreeSet;
use std::time::Duration;

/// A group of seven tasks and a service, `s`.
fn program(expression: &Expression) -> Program {
    let names = ["a", "b", "c", "d", "e", "f", "g", "s"];
    let member = |(index, name): (u32, &&str)| Member {
        name: (*name).into(),
        kind: MemberKind::Leaf(index),
        service: *name == "s",
    };
    Program::compile(&Group {
        path: "main".into(),
        process: "main".into(),
        host: 0,
        members: (0..).zip(&names).map(member).collect(),
        sets: vec![ConnectionSet { owner: None, label: None, wires: vec![] }; 8],
        sets_always: vec![],
        expression: expression.clone(),
        supervision: Supervision::default(),
    })
}

fn run(member: u32) -> Expression {
    Expression::Run { member, sets: vec![member] }
}

fn begun(program: &Program) -> State {
    let mut state = State::new(program);
    step(program, &mut state, Event::Start(Value::EMPTY), &mut Vec::new());
    state
}

fn done(member: u32, activation: u32) -> Event {
    Event::Done { member, activation: Activation(activation), value: Value::EMPTY }
}

const NOBODY: BTreeSet<u32> = BTreeSet::new();

#[test]
fn what_is_new_beside_starts_and_what_is_gone_is_stopped() {
    let (one, two) = (run(0), Expression::Concurrent(vec![run(0), run(1)]));
    let (alone, both) = (program(&one), program(&two));
    let carried = carry((&alone, &begun(&alone)), &both, &NOBODY).unwrap();
    let activate = Command::Activate { member: 1, activation: Activation(1), value: Value::EMPTY };
    assert_eq!((carried.ended, carried.begun), (vec![], vec![Command::Connect { set: 1 }, activate]));
    let mut state = carried.state;
    assert_eq!(step(&both, &mut state.clone(), done(0, 1), &mut Vec::new()), None, "it waits for the other one");
    // Only a process that is taken away is not waited for.
    assert!(carry((&both, &state), &alone, &NOBODY).is_err());
    let back = carry((&both, &state), &alone, &BTreeSet::from([1])).unwrap();
    let stop = Command::Stop { member: 1, activation: Activation(1) };
    assert_eq!((back.ended, back.begun), (vec![stop, Command::Disconnect { set: 1 }], vec![]));
    // If the remaining members are already done, the group is done.
    let three = program(&Expression::Concurrent(vec![run(0), run(1), run(2)]));
    step(&both, &mut state, done(0, 1), &mut Vec::new());
    let ends = carry((&both, &state), &program(&Expression::Concurrent(vec![run(0), run(0)])), &BTreeSet::from([1]));
    assert_eq!(ends.unwrap().state.activity(0), Activity::Active, "the second one of two is new");
    let more = carry((&both, &state), &three, &NOBODY).unwrap().state;
    let fewer = carry((&three, &more), &both, &BTreeSet::from([2])).unwrap();
    assert_eq!((fewer.outcome, fewer.state.activity(1)), (None, Activity::Active));
    let ended = carry((&both, &state), &program(&Expression::Concurrent(vec![run(0)])), &BTreeSet::from([1])).unwrap();
    assert!(matches!(ended.outcome, Some(Outcome::Done(_))), "{ended:?}");
}

#[test]
fn what_has_not_begun_may_be_anything_else() {
    let then = |second: Expression| Expression::Sequence(Box::new(run(0)), Box::new(second));
    let (old, new) = (program(&then(run(1))), program(&then(Expression::Disable(vec![run(2), run(3)]))));
    let state = begun(&old);
    let carried = carry((&old, &state), &new, &NOBODY).unwrap();
    assert_eq!((carried.ended.len(), carried.begun.len()), (0, 0));
    let (mut state, mut commands) = (carried.state, Vec::new());
    step(&new, &mut state, done(0, 1), &mut commands);
    assert_eq!(state.members_active().collect::<Vec<_>>(), [2, 3]);
    // A chain is longer afterwards, however its pairs are nested.
    let chain = |members: &[u32], is_left: bool| {
        let mut parts: Vec<Expression> = members.iter().map(|member| run(*member)).collect();
        while parts.len() > 1 {
            let at = if is_left { 0 } else { parts.len() - 2 };
            let (p, q) = (parts.remove(at), parts.remove(at));
            parts.insert(at, Expression::Sequence(Box::new(p), Box::new(q)));
        }
        parts.remove(0)
    };
    let (old, new) = (program(&chain(&[0, 1, 2], true)), program(&chain(&[0, 4, 1, 2, 3], false)));
    let mut state = begun(&old);
    step(&old, &mut state, done(0, 1), &mut Vec::new());
    let mut state = carry((&old, &state), &new, &NOBODY).unwrap().state;
    for member in [1, 2] {
        assert_eq!(step(&new, &mut state, done(member, 1), &mut Vec::new()), None);
    }
    assert!(step(&new, &mut state, done(3, 1), &mut Vec::new()).is_some());
    // A running member needs a place.
    let misfit = carry((&old, &begun(&old)), &program(&chain(&[4, 5], true)), &NOBODY).unwrap_err();
    assert_eq!(misfit.members, BTreeSet::from([0]));
}

#[test]
fn a_deadline_that_changes_begins_anew() {
    let within = |seconds: u64| {
        let wait = Box::new(Expression::Wait(Duration::from_secs(seconds)));
        let late = Expression::Sequence(wait, Box::new(Expression::Fail(format!("{seconds}"))));
        Expression::Disable(vec![run(0), late])
    };
    let (old, new) = (program(&within(5)), program(&within(9)));
    let carried = carry((&old, &begun(&old)), &new, &NOBODY).unwrap();
    let cancel = Command::Cancel { timer: 0, activation: Activation(1) };
    let arm = Command::Arm { timer: 0, activation: Activation(2), after: Duration::from_secs(9) };
    assert_eq!((carried.ended, carried.begun), (vec![cancel], vec![arm]));
}

/// Follows a word of choices; `each` sees the states after each event, until the group ends.
fn follow(program: &Program, word: &[u16], mut each: impl FnMut(&State, &Event, &[Command], Option<&Outcome>) -> bool) {
    let mut state = State::new(program);
    let mut event = Event::Start(Value::new(b"first"));
    for choice in std::iter::once(&0).chain(word) {
        let mut commands = Vec::new();
        let outcome = step(program, &mut state, event.clone(), &mut commands);
        if !each(&state, &event, &commands, outcome.as_ref()) || outcome.is_some() {
            return;
        }
        let Some(next) = choose(program, &state, usize::from(*choice)) else { return };
        event = next;
    }
}

fn choose(program: &Program, state: &State, choice: usize) -> Option<Event> {
    let mut events = Vec::new();
    for member in state.members_active() {
        let activation = state.activation(member);
        events.extend([
            Event::Done { member, activation, value: Value::EMPTY },
            Event::Done { member, activation, value: Value::new(b"\x01av") },
            Event::Aborted { member, activation, report: Value::EMPTY },
            Event::Stopped { member, activation },
        ]);
    }
    for timer in 0..program.timers() {
        let (activation, is_armed) = state.timer(program, timer);
        events.extend(is_armed.then_some(Event::Elapsed { timer, activation }));
    }
    if choice.is_multiple_of(17) {
        events.push(Event::Stop);
    }
    (!events.is_empty()).then(|| events.swap_remove(choice / 17 % events.len()))
}

/// Puts another term in the place of one part.
fn changed(spec: &Spec, place: usize, other: &Term) -> Spec {
    let mut spec = spec.clone();
    fn walk<'a>(term: &'a mut Term, left: &mut usize) -> Option<&'a mut Term> {
        if *left == 0 {
            return Some(term);
        }
        *left -= 1;
        term.parts_mut().into_iter().find_map(|part| walk(part, left))
    }
    fn size(term: &Term) -> usize {
        1 + term.parts().into_iter().map(size).sum::<usize>()
    }
    let mut left = place % size(&spec.term);
    if let Some(term) = walk(&mut spec.term, &mut left) {
        *term = other.clone();
    }
    number(&mut spec.term);
    spec
}

fn cases(count: u32, mut check: impl FnMut(Spec, Spec, Vec<u16>) -> Result<(), String>) {
    let config =
        ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::with_cases(count) };
    let check = std::cell::RefCell::new(&mut check);
    let input =
        (spec(), proptest::prelude::any::<prop::sample::Index>(), term(), vec(proptest::prelude::any::<u16>(), 1..30));
    let result = TestRunner::new(config).run(&input, |(spec, place, other, word)| {
        let next = changed(&spec, place.index(40), &other);
        (check.borrow_mut())(spec, next, word).map_err(TestCaseError::fail)
    });
    if let Err(failure) = result {
        panic!("{failure}");
    }
}

/// Whether a member may end in the reaction that starts it: then its end cannot be seen from outside.
fn is_instant(term: &Term) -> bool {
    fn members(term: &Term, all: &mut Vec<u32>) {
        if let Term::Leaf(member, _) = term {
            all.push(*member);
        }
        term.parts().into_iter().for_each(|part| members(part, all));
    }
    let mut all = Vec::new();
    members(term, &mut all);
    let count = all.len();
    all.sort_unstable();
    all.dedup();
    all.len() < count || any(term, &|term| matches!(term, Term::Skip | Term::Fail(_) | Term::Match(_)))
}

/// If the new event actions would have done the same so far, the state is the one that they would have reached by
/// themselves.
#[test]
fn the_state_is_as_if_it_had_always_been_so() {
    let (mut compared, mut refused) = (0_u32, 0_u32);
    cases(30_000, |spec, next, word| {
        if is_instant(&spec.term) || is_instant(&next.term) {
            return Ok(());
        }
        let (old, new) = (Program::compile(&spec.group()), Program::compile(&next.group()));
        let mut other = State::new(&new);
        let mut wrong = Ok(());
        // An operand that has ended keeps its end, even if its place changes afterwards.
        let joins = |spec: &Spec| {
            any(&spec.term, &|term| matches!(term, Term::Par(_) | Term::Ff(_) | Term::Least(..) | Term::Tag(..)))
        };
        let finishes = |spec: &Spec| any(&spec.term, &|term| matches!(term, Term::Fin(..)));
        let joins = joins(&spec) || joins(&next) || finishes(&spec) != finishes(&next);
        follow(&old, &word, |state, event, commands, outcome| {
            let itself = carry((&old, state), &old, &NOBODY);
            if outcome.is_none() && itself.as_ref().map(|it| it.state.configuration()) != Ok(state.configuration()) {
                wrong = Err(format!("not the same: {itself:#?} of {state:#?}"));
            }
            let mut others = Vec::new();
            let is_timed = matches!(event, Event::Elapsed { .. })
                || commands.iter().any(|it| matches!(it, Command::Arm { .. } | Command::Cancel { .. }));
            let is_like = !is_timed
                && step(&new, &mut other, event.clone(), &mut others).as_ref() == outcome
                && others == commands;
            if !is_like || outcome.is_some() || joins && !matches!(event, Event::Start(_)) {
                return false;
            }
            match carry((&old, state), &new, &NOBODY) {
                Ok(carried) => {
                    compared += 1;
                    let is_quiet = carried.ended.is_empty() && carried.begun.is_empty() && carried.outcome.is_none();
                    if !is_quiet || carried.state.configuration() != other.configuration() {
                        wrong = Err(format!("{carried:#?} is not {other:#?}"));
                    }
                }
                Err(_) => refused += 1,
            }
            wrong.is_ok()
        });
        wrong
    });
    assert!(compared > 1_000 && refused < compared / 3, "{compared} compared, {refused} refused");
}

/// After any change, a group that is stopped comes to its end, and nothing is activated twice.
#[test]
fn what_was_carried_over_can_be_stopped() {
    let mut carried_over = 0_u32;
    cases(20_000, |spec, next, word| {
        let (old, new) = (Program::compile(&spec.group()), Program::compile(&next.group()));
        let mut last = State::new(&old);
        follow(&old, &word, |state, _, _, outcome| {
            if outcome.is_none() {
                last = state.clone();
            }
            true
        });
        // Half of the members are taken away; the running ones of the rest go on.
        let gone: BTreeSet<u32> =
            (0..spec.declared.len()).filter_map(|it| u32::try_from(it).ok()).filter(|it| it % 2 == 0).collect();
        let Ok(carried) = carry((&old, &last), &new, &gone) else { return Ok(()) };
        carried_over += 1;
        let before: BTreeSet<u32> = last.members_active().collect();
        let mut active = before.clone();
        for command in carried.ended.iter().chain(&carried.begun) {
            if let Command::Stop { member, .. } = command
                && carried.ended.contains(command)
                && !(gone.contains(member) && active.remove(member))
            {
                return Err(format!("member {member} is stopped: {carried:#?}"));
            }
            if let Command::Activate { member, .. } = command
                && !active.insert(*member)
            {
                return Err(format!("member {member} is activated twice: {carried:#?}"));
            }
        }
        let mut state = carried.state.clone();
        if carried.outcome.is_some() {
            return Ok(());
        }
        if !before
            .iter()
            .filter(|member| !gone.contains(member))
            .all(|member| state.activity(*member) != Activity::Idle)
        {
            return Err(format!("something was forgotten: {carried:#?}"));
        }
        let mut outcome = step(&new, &mut state, Event::Stop, &mut Vec::new());
        for _ in 0..200 {
            if outcome.is_some() {
                break;
            }
            let member = state.members_active().next();
            let timer = (0..new.timers()).find(|timer| state.timer(&new, *timer).1);
            let event = match (member, timer) {
                (Some(member), _) => Event::Stopped { member, activation: state.activation(member) },
                (None, Some(timer)) => Event::Elapsed { timer, activation: state.timer(&new, timer).0 },
                // A `never` in a `shield` or behind a `finally` ends with the programs alone.
                (None, None) => return Ok(()),
            };
            outcome = step(&new, &mut state, event, &mut Vec::new());
        }
        if state.members_active().next().is_some() && outcome.is_some() {
            return Err(format!("something goes on: {state:#?}"));
        }
        Ok(())
    });
    assert!(carried_over > 5_000, "{carried_over} carried over");
}
