//! Bytes from a network: if they are a plan, the plan is checked, and a valid one takes any events.
//!
//! The rest of the bytes is read as events, two bytes each: valid ones, stale ones, and ones for members that do not
//! exist. At the end the group is stopped, and everything confirms: then it has to end, and to be idle.
#![no_main]

use language::algebra::{Activation, Activity, Event, Outcome, Program, State, Value, step};
use language::plan::{Expression, Plan};
use libfuzzer_sys::fuzz_target;

/// The most events of one run: more only take longer.
const STEPS_MAX: usize = 2000;

fuzz_target!(|bytes: &[u8]| {
    let Ok((plan, rest)) = postcard::take_from_bytes::<Plan>(bytes) else { return };
    if plan.validate().is_err() {
        return;
    }
    // A member that may not be stopped and does not end cannot be ended at all; `dca check` refuses it.
    for group in plan.groups.iter().filter(|group| !is_held_up(&group.expression)) {
        let program = Program::compile(group);
        let members = u32::try_from(group.members.len()).expect("a plan has few members");
        run(&program, members, rest);
    }
});

/// Whether something in it has a shield without a bound, or runs something at its end that no stop ends.
fn is_held_up(expression: &Expression) -> bool {
    matches!(expression, Expression::Shield { bound: None, .. } | Expression::Finally(..)) || expression.operands().into_iter().any(is_held_up)
}

fn run(program: &Program, members: u32, events: &[u8]) {
    let (mut state, mut commands) = (State::new(program), Vec::new());
    let mut outcome = step(program, &mut state, Event::Start(Value::EMPTY), &mut commands);
    for pair in events.chunks_exact(2).take(STEPS_MAX) {
        if outcome.is_some() {
            check_idle(&state, outcome.as_ref());
            outcome = step(program, &mut state, Event::Start(Value::new(b"again")), &mut commands);
            continue;
        }
        let next = event(program, &state, members, (pair[0], pair[1]));
        outcome = step(program, &mut state, next, &mut commands);
        commands.clear();
    }
    if outcome.is_none() {
        outcome = step(program, &mut state, Event::Stop, &mut commands);
    }
    // Time passes; members that are asked to stop confirm it; members under a shield may end. A shield's timer stands
    // before those below it, so a loop that it holds up cannot go on for ever.
    while outcome.is_none() {
        commands.clear();
        let mut timers = (0..program.timers()).map(|timer| (timer, state.timer(program, timer)));
        let event = match (timers.find(|(_, (_, is_armed))| *is_armed), state.members_active().next()) {
            (Some((timer, (activation, _))), _) => Event::Elapsed { timer, activation },
            (None, Some(member)) => ending(&state, member),
            (None, None) => panic!("it waits for nothing"),
        };
        outcome = step(program, &mut state, event, &mut commands);
    }
    check_idle(&state, outcome.as_ref());
}

fn ending(state: &State, member: u32) -> Event {
    let activation = state.activation(member);
    match state.activity(member) {
        Activity::Stopping => Event::Stopped { member, activation },
        Activity::Active | Activity::Idle => Event::Aborted { member, activation, report: Value::EMPTY },
    }
}

/// A random event; every fourth is about an older activation.
fn event(program: &Program, state: &State, members: u32, (what, who): (u8, u8)) -> Event {
    let member = u32::from(who) % (members + 1);
    let stale = u32::from(what / 16 == 0);
    let activation = Activation(state.activation(member).0.wrapping_sub(stale));
    match what % 7 {
        0 | 1 => Event::Done { member, activation, value: Value::new(&[who]) },
        2 => Event::Aborted { member, activation, report: Value::new(b"why") },
        3 => Event::Stopped { member, activation },
        4 => Event::StopUnconfirmed { member, activation },
        5 => Event::Stop,
        _ => {
            let timer = u32::from(who) % (program.timers() + 1);
            let (activation, _) = state.timer(program, timer);
            Event::Elapsed { timer, activation: Activation(activation.0.wrapping_sub(stale)) }
        }
    }
}

fn check_idle(state: &State, outcome: Option<&Outcome>) {
    assert!(state.is_idle(), "{outcome:?}, but it is not idle");
    assert_eq!(state.members_active().next(), None, "{outcome:?}, but a member is active");
}
