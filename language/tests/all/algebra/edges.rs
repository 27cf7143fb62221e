//! Cases that a checked spec does not contain but a plan may, and limits.

use super::pair::Pair;
use super::reference::{Declared, Event as Reported, Outcome as Expected, Reason, Term};
use super::spec::{Spec, number};
use language::algebra::{Activation, Activity, Command, Event, Outcome, Program, State, Value, step};
use language::plan::{DEPTH_MAX, Expression, Group, Member, MemberKind, Supervision};
use std::time::Duration;

fn group(expression: Expression) -> Group {
    let member = |index| Member { name: format!("m{index}"), kind: MemberKind::Leaf(index), service: false };
    Group {
        path: "main".into(),
        process: "main".into(),
        host: 0,
        members: (0..4).map(member).collect(),
        sets: vec![],
        sets_always: vec![],
        expression,
        supervision: Supervision::default(),
    }
}

fn run(member: u32) -> Expression {
    Expression::Run { member, sets: vec![] }
}

/// Starts an expression and returns its outcome, if it ends at once, and its commands.
fn start(expression: Expression) -> (Option<Outcome>, Vec<Command>) {
    let program = Program::compile(&group(expression));
    let mut commands = Vec::new();
    let outcome = step(&program, &mut State::new(&program), Event::Start(Value::EMPTY), &mut commands);
    (outcome, commands)
}

fn done() -> Option<Outcome> {
    Some(Outcome::Done(Value::EMPTY))
}

#[test]
fn operators_without_operands_end_as_their_rules_say() {
    assert_eq!(start(Expression::Concurrent(vec![])).0, done());
    assert_eq!(start(Expression::FailFast(vec![])).0, done());
    assert_eq!(start(Expression::AnyOf { count: 3, of: vec![] }).0, done());
    assert_eq!(start(Expression::AtLeast { count: 3, of: vec![] }).0, done());
    assert_eq!(start(Expression::Disable(vec![])).0, None);
    let one = Expression::Concurrent(vec![Expression::Never]);
    let kinds = [(Expression::Concurrent(vec![]), false), (one, true), (Expression::Disable(vec![]), true)];
    for (expression, service) in kinds {
        assert_eq!(Program::compile(&group(expression)).is_service(), service);
    }
}

#[test]
fn any_of_asks_for_no_more_than_there_are() {
    let one = Activation(1);
    let activate = Command::Activate { member: 0, activation: one, value: Value::EMPTY };
    let none = start(Expression::AnyOf { count: 0, of: vec![run(0)] });
    assert_eq!(none, (None, vec![activate.clone(), Command::Stop { member: 0, activation: one }]));
    assert_eq!(start(Expression::AnyOf { count: 9, of: vec![run(0)] }), (None, vec![activate]));
}

#[test]
fn an_expression_as_deep_as_allowed_runs_and_stops() {
    let deep = |depth| (1..depth).fold(run(0), |inner, _| Expression::Disable(vec![inner]));
    let program = Program::compile(&group(deep(DEPTH_MAX)));
    let (mut state, mut commands) = (State::new(&program), Vec::new());
    assert_eq!(step(&program, &mut state, Event::Start(Value::EMPTY), &mut commands), None);
    assert_eq!(step(&program, &mut state, Event::Stop, &mut commands), None);
    let stopped = Event::Stopped { member: 0, activation: Activation(1) };
    assert_eq!(step(&program, &mut state, stopped, &mut commands), Some(Outcome::Stopped));
    assert!(std::panic::catch_unwind(|| Program::compile(&group(deep(DEPTH_MAX + 1)))).is_err());
}

#[test]
fn a_group_may_start_again_and_numbers_go_on() {
    let program = Program::compile(&group(Expression::Sequence(
        Box::new(Expression::Wait(Duration::from_millis(20))),
        Box::new(run(2)),
    )));
    let mut state = State::new(&program);
    for round in 1..=3 {
        let (activation, mut commands) = (Activation(round), Vec::new());
        assert_eq!(step(&program, &mut state, Event::Start(Value::new(b"v")), &mut commands), None);
        assert_eq!(step(&program, &mut state, Event::Elapsed { timer: 0, activation }, &mut commands), None);
        let arm = Command::Arm { timer: 0, activation, after: Duration::from_millis(20) };
        assert_eq!(commands, [arm, Command::Activate { member: 2, activation, value: Value::EMPTY }]);
        assert_eq!(state.activity(2), Activity::Active);
        let done = Event::Done { member: 2, activation, value: Value::new(b"u") };
        assert_eq!(step(&program, &mut state, done, &mut commands), Some(Outcome::Done(Value::new(b"u"))));
        assert!(state.is_idle() && state.activity(2) == Activity::Idle && state.activity(99) == Activity::Idle);
    }
}

#[test]
fn values_form_tuples_by_position() {
    let values = [Value::new(b"ab"), Value::EMPTY];
    let bytes = [&2_u64.to_le_bytes()[..], b"ab", &0_u64.to_le_bytes()].concat();
    assert_eq!(Value::tuple(values.iter()), Value::new(&bytes));
    assert_eq!(Value::tuple(values[..1].iter()), values[0]);
    assert_eq!(Value::tuple([Value::EMPTY, Value::EMPTY].iter()), Value::EMPTY);
    assert_eq!(Value::tuple([].iter()), Value::EMPTY);
}

/// The guard counts rounds within one reaction: the loop `((m0? # m1) ;; (wait # skip))` turns as often as it likes
/// while `m0` can run, and is aborted when `m0` is busy elsewhere, so that a round takes no time.
#[test]
fn a_loop_is_aborted_in_the_reaction_in_which_its_round_takes_no_time() {
    let leaf = |member| Term::Leaf(member, vec![]);
    let both = |operator: fn(Box<Term>, Box<Term>) -> Term, e, f| operator(Box::new(e), Box::new(f));
    let body = Term::Dis(vec![both(Term::Else, leaf(0), Term::Skip), leaf(1)]);
    let recurrent = both(Term::Rec, body, Term::Dis(vec![Term::Wait(0), Term::Skip]));
    let mut term = Term::Ff(vec![recurrent, both(Term::Seq, leaf(2), leaf(0))]);
    number(&mut term);
    let spec = Spec { term, declared: vec![Declared::Task; 3] };
    let program = Program::compile(&spec.group());
    let mut pair = Pair::new(&spec, &program);
    let round = [Reported::Done(0, 1, vec![]), Reported::Stopped(1, 1)];
    let taken =
        [Reported::Done(0, 2, vec![]), Reported::Done(2, 1, vec![]), Reported::Stopped(1, 2), Reported::Stopped(0, 3)];
    let mut outcome = None;
    for event in [&[Reported::Start(vec![])], &round[..], &taken].concat() {
        assert_eq!(outcome, None, "before {event:?}");
        outcome = pair.send(&event).unwrap();
    }
    assert_eq!(outcome, Some(Expected::Aborted(Reason::Instant)));
}
