//! Events cost no memory: a counting allocator watches a loop and a mission.

#[path = "allocation/counter.rs"]
mod counter;

use counter::allocations;
use language::algebra::{Activation, Command, Event, Program, State, Value, step};
use language::plan::{Arm, Expression, Group, Member, MemberKind, Supervision};

fn run(member: u32) -> Expression {
    Expression::Run { member, sets: vec![member] }
}

fn program(members: u32, expression: Expression) -> Program {
    let member = |index| Member { name: format!("m{index}"), kind: MemberKind::Leaf(index), service: false };
    Program::compile(&Group {
        path: "main".into(),
        process: "main".into(),
        host: 0,
        members: (0..members).map(member).collect(),
        sets: vec![],
        sets_always: vec![],
        expression,
        supervision: Supervision::default(),
    })
}

/// Lets the first running member end, `events` times: a member that is asked to stop confirms, an activated one is done
/// with `value`. Returns the number of allocations after the first hundred events, and the last state.
fn drive(program: &Program, value: &Value, events: u64) -> (u64, State) {
    let (mut state, mut commands, mut waiting) = (State::new(program), Vec::with_capacity(64), Vec::with_capacity(64));
    let mut before = 0;
    assert_eq!(step(program, &mut state, Event::Start(value.clone()), &mut commands), None);
    for count in 0..events {
        for command in commands.drain(..) {
            match command {
                Command::Activate { member, activation, .. } => waiting.push((member, activation, true)),
                Command::Stop { member, activation } => {
                    let stopped = waiting.iter_mut().find(|other| (other.0, other.1) == (member, activation));
                    stopped.expect("what is stopped was activated").2 = false;
                }
                Command::Connect { .. } | Command::Disconnect { .. } => {}
                Command::Send { .. } | Command::Log { .. } | Command::Lost { .. } => {
                    panic!("there are no activities here")
                }
                Command::Arm { .. } | Command::Cancel { .. } => panic!("there are no timers here"),
            }
        }
        let (member, activation, done): (u32, Activation, bool) = waiting.remove(0);
        let event = match done {
            true => Event::Done { member, activation, value: value.clone() },
            false => Event::Stopped { member, activation },
        };
        assert_eq!(step(program, &mut state, event, &mut commands), None);
        if count == 100 {
            before = allocations();
        }
    }
    (allocations() - before, state)
}

#[test]
fn a_loop_of_a_million_rounds_allocates_nothing() {
    // a ;; (b # (c, d, (e ; f)))
    let tail = Expression::Sequence(Box::new(run(4)), Box::new(run(5)));
    let group = Expression::Concurrent(vec![run(2), run(3), tail]);
    let body = Expression::Disable(vec![run(1), group]);
    let program = program(6, Expression::Recurrent(Box::new(run(0)), Box::new(body)));
    let (allocations, state) = drive(&program, &Value::EMPTY, 5_000_010);
    assert_eq!(allocations, 0);
    assert!(state.activation(0) > Activation(1_000_000), "{:?}", state.activation(0));
}

#[test]
fn values_that_are_passed_on_are_shared() {
    // (a : b) ;; (c else d)
    let first = Expression::Conditional(Box::new(run(0)), Box::new(run(1)));
    let second = Expression::Otherwise(Box::new(run(2)), Box::new(run(3)));
    let program = program(4, Expression::Recurrent(Box::new(first), Box::new(second)));
    assert_eq!(drive(&program, &Value::new(b"a pose"), 300_000).0, 0);
}

#[test]
fn what_runs_at_the_end_costs_nothing() {
    // (a finally b) ;; ((c # d) finally skip)
    let first = Expression::Finally(Box::new(run(0)), Box::new(run(1)));
    let disabled = Expression::Disable(vec![run(2), run(3)]);
    let second = Expression::Finally(Box::new(disabled), Box::new(Expression::Skip));
    let program = program(4, Expression::Recurrent(Box::new(first), Box::new(second)));
    assert_eq!(drive(&program, &Value::new(b"a pose"), 300_000).0, 0);
}

#[test]
fn scopes_cost_nothing_either() {
    // (a : match { done => b, else => c }) ;; ((using(r) d ; skip), (using(r) shield e ; skip), (f ::[1] g))
    let arm = |tag: Option<&str>, member| Arm { tag: tag.map(str::to_owned), body: run(member) };
    let matching = Expression::Match(vec![arm(Some("done"), 1), arm(None, 2)]);
    let first = Expression::Conditional(Box::new(run(0)), Box::new(matching));
    // A tuple of values would need separate memory.
    let using = |of| {
        let using = Expression::Using { resources: vec!["r".to_owned()], of: Box::new(of) };
        Expression::Sequence(Box::new(using), Box::new(Expression::Skip))
    };
    let shield = Expression::Shield { bound: None, of: Box::new(run(4)) };
    let pool = Expression::Asynchronous { source: Box::new(run(5)), pool: vec![run(6)] };
    let second = Expression::Concurrent(vec![using(run(3)), using(shield), pool]);
    let program = program(7, Expression::Recurrent(Box::new(first), Box::new(second)));
    assert_eq!(drive(&program, &Value::tagged("done", b"12 N").unwrap(), 300_000).0, 0);
}
