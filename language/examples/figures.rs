//! The speed of the language, compared with simple work on the same machine: one command, one table.
//!
//! ```text
//! cargo run --release -p language --example figures
//! ```
//!
//! Times are processor times of this thread, the best of some runs, because other programs may use
//! the machine. The important figure is the ratio.
#![expect(clippy::print_stdout, reason = "its output is its result")]

#[path = "../tests/allocation/counter.rs"]
mod counter;
#[path = "../tests/all/size/spec.rs"]
mod spec;

use counter::allocations;
use language::algebra::{Activation, Command, Event, Program, State, Value, step};
use language::plan::{Expression, Group, Member, MemberKind, Supervision};
use language::syntax::lex;
use language::{Options, Source, compile, format};
use std::collections::VecDeque;
use std::hint::black_box;
use std::time::Duration;

/// Runs of each measurement, of which the best is used.
const RUNS: usize = 5;
/// Events of one run.
const EVENTS: u64 = 20_000_000;
/// Rounds of the loop whose memory is measured.
const ROUNDS: u64 = 100_000_000;

fn main() {
    println!("| what | figure | ratio | reach |\n|---|---|---|---|");
    text();
    events();
    rounds();
}

/// The time of the best of some runs.
fn best<T>(mut work: impl FnMut() -> T) -> Duration {
    let once = || {
        let start = busy();
        black_box(work());
        busy() - start
    };
    std::iter::repeat_with(once).take(RUNS).min().unwrap_or_default()
}

/// How long this thread has been on a processor.
fn busy() -> Duration {
    let status = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = status.split_whitespace().next().and_then(|first| first.parse().ok());
    Duration::from_nanos(nanoseconds.expect("Linux counts how long a thread runs"))
}

fn text() {
    let spec = Source::new("large.dca", spec::large_spec());
    let lines = spec.text.lines().count();
    let lexing = best(|| lex(&spec.text));
    let compiling = best(|| compile(&spec, &[], &Options::named("large")));
    let formatting = best(|| format(&spec));
    let ratio = |time: Duration| time.as_secs_f64() / lexing.as_secs_f64();
    let rate = |time: Duration| spec.text.len() as f64 / time.as_secs_f64() / 1e6;
    println!(
        "| {lines} lines parsed, checked and planned | {compiling:.2?}, {:.0} MB/s | {:.1} of reading its tokens | 1 s |",
        rate(compiling),
        ratio(compiling)
    );
    println!(
        "| the same, formatted | {formatting:.2?}, {:.0} MB/s | {:.1} of reading its tokens | 10 MB/s |",
        rate(formatting),
        ratio(formatting)
    );
}

fn events() {
    let program = mission();
    let mut allocations = 0;
    let time = best(|| allocations = drive(&program, EVENTS));
    let hand = best(|| by_hand(EVENTS));
    println!(
        "| `step`, `a ;; (b # (c, d, (e ; f)))` | {:.1} M events/s, {allocations} allocations in {EVENTS} | {:.1} of the same written by hand | 10 M/s, 0 |",
        EVENTS as f64 / time.as_secs_f64() / 1e6,
        time.as_secs_f64() / hand.as_secs_f64()
    );
}

fn rounds() {
    let program = program(2, Expression::Recurrent(Box::new(run(0)), Box::new(run(1))));
    let before = resident();
    let start = busy();
    let allocations = drive(&program, 2 * ROUNDS);
    let time = busy() - start;
    println!(
        "| {ROUNDS} rounds of `a ;; b` | {:.1} s, {before} kB resident before, {} kB after, {allocations} allocations | | as before |",
        time.as_secs_f64(),
        resident()
    );
}

/// Memory of this process that is in use, as the kernel counts it.
fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0)
}

fn run(member: u32) -> Expression {
    Expression::Run { member, sets: vec![member] }
}

/// `a ;; (b # (c, d, (e ; f)))`
fn mission() -> Program {
    let tail = Expression::Sequence(Box::new(run(4)), Box::new(run(5)));
    let group = Expression::Concurrent(vec![run(2), run(3), tail]);
    let body = Expression::Disable(vec![run(1), group]);
    program(6, Expression::Recurrent(Box::new(run(0)), Box::new(body)))
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

/// Lets the first thing that runs end, `events` times: a member that is asked to stop confirms it, another is done. Returns
/// the number of allocations after the first hundred events.
fn drive(program: &Program, events: u64) -> u64 {
    let (mut state, mut commands) = (State::new(program), Vec::with_capacity(64));
    let mut waiting: VecDeque<(u32, Activation, bool)> = VecDeque::with_capacity(64);
    let mut before = 0;
    assert_eq!(step(program, &mut state, Event::Start(Value::EMPTY), &mut commands), None);
    for count in 0..events {
        for command in commands.drain(..) {
            if let Command::Activate { member, activation, .. } = command {
                waiting.push_back((member, activation, true));
            } else if let Command::Stop { member, .. } = command {
                waiting.iter_mut().filter(|other| other.0 == member).for_each(|other| other.2 = false);
            }
        }
        let (member, activation, is_done) = waiting.pop_front().expect("a loop always runs something");
        let event = match is_done {
            true => Event::Done { member, activation, value: Value::EMPTY },
            false => Event::Stopped { member, activation },
        };
        assert_eq!(step(program, &mut state, event, &mut commands), None);
        if count == 100 {
            before = allocations();
        }
    }
    allocations() - before
}

/// The same loop for the same events as a person would write it for this expression alone.
fn by_hand(events: u64) -> u64 {
    #[derive(Clone, Copy)]
    enum At {
        A,
        Body { b: bool, c: bool, d: bool, e: bool, f: bool },
        Drain(u8),
    }
    let mut at = At::A;
    let mut waiting: VecDeque<(u32, u32, bool)> = VecDeque::with_capacity(64);
    let (mut rounds, mut activations) = (0, [0_u32; 6]);
    let mut activate = |waiting: &mut VecDeque<(u32, u32, bool)>, member: u32| {
        activations[member as usize] += 1;
        waiting.push_back((member, activations[member as usize], true));
    };
    activate(&mut waiting, 0);
    for _ in 0..events {
        let (member, activation, _) = black_box(waiting.pop_front().expect("a loop always runs something"));
        black_box(activation);
        at = match (at, member) {
            (At::A, _) => {
                [1, 2, 3, 4].into_iter().for_each(|member| activate(&mut waiting, member));
                At::Body { b: true, c: true, d: true, e: true, f: false }
            }
            (At::Body { .. }, 1) => {
                let stopped = waiting.iter_mut().map(|other| other.2 = false).count();
                At::Drain(u8::try_from(stopped).unwrap_or(u8::MAX))
            }
            (At::Body { b, d, e, f, .. }, 2) => At::Body { b, c: false, d, e, f },
            (At::Body { b, c, e, f, .. }, 3) => At::Body { b, c, d: false, e, f },
            (At::Body { b, c, d, .. }, 4) => {
                activate(&mut waiting, 5);
                At::Body { b, c, d, e: false, f: true }
            }
            (At::Body { b, c, d, e, .. }, _) => At::Body { b, c, d, e, f: false },
            (At::Drain(1), _) => {
                rounds += 1;
                activate(&mut waiting, 0);
                At::A
            }
            (At::Drain(open), _) => At::Drain(open - 1),
        };
        if let At::Body { b: true, c: false, d: false, e: false, f: false } = at {
            at = At::Drain(1);
        }
    }
    rounds
}
