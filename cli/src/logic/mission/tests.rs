//! Tests of phases, peaks and verdicts, with events from tables.

use super::*;
use crate::logic::record::Entry;
use comms::logic::signals::{Signal, Signals};
use comms::logic::time::Time;
use expect_test::{Expect, expect};
use language::plan::{Expression as E, Group, Leaf, LeafKind, Member, MemberKind, Policy, Supervision};
use language::{Options, Source, compile};
use node::logic::protocol::FailureCause;
use std::fmt::Write as _;

pub(crate) fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// Returns a plan with one group under `main` whose members are all programs. A name that ends in `!` is a service.
pub(crate) fn plan(names: &[&str], expression: Expression) -> Plan {
    let mut leaves = Vec::new();
    let mut members = Vec::new();
    for (index, name) in (0..).zip(names) {
        let (name, service) = name.strip_suffix('!').map_or((*name, false), |name| (name, true));
        members.push(Member { name: name.to_owned(), kind: MemberKind::Leaf(index), service });
        leaves.push(Leaf {
            path: format!("main/sys/{name}"),
            module: "Test".to_owned(),
            host: index % 2,
            arguments: Vec::new(),
            exec: None,
            parameters: None,
            environment: Default::default(),
            kind: LeafKind::Controller,
            stop_within: seconds(1.0),
            outcomes: Vec::new(),
            policy: Policy::default(),
            keys: Vec::new(),
            external: None,
        });
    }
    let group = |path: &str, members, expression| Group {
        path: path.to_owned(),
        process: "Test".to_owned(),
        host: 0,
        members,
        sets: Vec::new(),
        sets_always: Vec::new(),
        expression,
        supervision: Supervision::default(),
    };
    let sys = Member { name: "sys".to_owned(), kind: MemberKind::Group(1), service: false };
    let main = group("main", vec![sys], run(0));
    let hosts = vec!["c1".to_owned(), "c2".to_owned()];
    Plan {
        name: "test".to_owned(),
        hosts,
        groups: vec![main, group("main/sys", members, expression)],
        leaves,
        wires: Vec::new(),
        claims: Vec::new(),
        on_boot: Default::default(),
    }
}

type Expression = E;

pub(crate) fn run(member: u32) -> E {
    E::Run { member, sets: Vec::new() }
}

fn seq(of: Vec<E>) -> E {
    of.into_iter().rev().reduce(|rest, first| E::Sequence(Box::new(first), Box::new(rest))).unwrap()
}

/// The door's shape: background # (servo # near ; (open, approach) # hit ; close ; pull).
pub(crate) fn door() -> Plan {
    let names = ["motion!", "servo!", "near", "open", "approach", "hit", "close", "pull"];
    let grasp = E::Disable(vec![E::Concurrent(vec![run(3), run(4)]), run(5)]);
    let chain = seq(vec![E::Disable(vec![run(1), run(2)]), grasp, run(6), run(7)]);
    plan(&names, E::Disable(vec![run(0), chain]))
}

/// Gives a mission GO, and then the events of a table.
pub(crate) fn feed(mission: &mut Mission, table: &str) {
    mission.report(&Report::Go { took: seconds(0.8), signals: Vec::new() });
    feed_more(mission, table);
}

/// Gives a mission the events of a table.
pub(crate) fn feed_more(mission: &mut Mission, table: &str) {
    for entry in event_table(table) {
        match entry {
            Entry::Report(report) => mission.report(&report),
            Entry::Signals { path, at, sample } => mission.signals(&path, at, &sample),
            Entry::Output { .. } | Entry::Port { .. } | Entry::Missing { .. } => {}
        }
    }
}

/// Reads a table with one event on each line: `at process activated|stopping|done|stopped|why it aborted`, or `at
/// process signal value unit`.
pub(crate) fn event_table(table: &str) -> Vec<Entry> {
    let lines = table.lines().map(str::trim).filter(|line| !line.is_empty());
    let entry = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let (at, path) = (seconds(words[0].parse().unwrap()), format!("main/sys/{}", words[1]));
        let [_, _, name, value, unit] = words[..] else { return Entry::Report(event(&path, words[2], at)) };
        let (headline, value) = (!name.starts_with('_'), value.parse().unwrap());
        let signal = Signal { name: name.replace('_', " "), unit: unit.to_owned(), value, headline };
        Entry::Signals { path, at, sample: Signals { stamp: Time::from_nanos(5), values: vec![signal] } }
    };
    lines.map(entry).collect()
}

fn event(path: &str, word: &str, at: Duration) -> Report {
    let failure = |cause| Failure { origin: path.to_owned(), cause, at };
    let change = match word {
        "activated" => Change::Activated,
        "stopping" => Change::Stopping,
        "done" => Change::Ended(Ending::Done(Vec::new())),
        "stopped" => Change::Ended(Ending::Stopped),
        "died" => Change::Died(FailureCause::Signal(11)),
        "killed" => Change::Ended(Ending::Aborted(failure(FailureCause::Signal(9)))),
        why => Change::Ended(Ending::Aborted(failure(FailureCause::Reported(why.to_owned())))),
    };
    Report::Process { path: path.to_owned(), change, at }
}

pub(crate) const OPENING: &str = "
    0.0 motion activated
    0.0 servo activated
    0.0 near activated
    1.0 motion force 3 N
    6.8 near done
    6.8 servo stopping
    6.9 servo stopped
    6.9 hit activated
    6.9 open activated
    6.9 approach activated
    7.5 open done
    8.0 motion force -16 N
    8.0 motion _torque 2.5 Nm
    11.7 hit done
    11.7 approach stopping
    11.8 approach stopped
    11.8 close activated
    12.4 close done
    12.5 pull activated
    13.0 pull angle 0.5 deg
    14.0 motion force 28.8 N
    22.0 pull angle 74.04 deg
    22.0 pull done
    22.0 motion stopping
    22.1 motion stopped
";

#[track_caller]
fn check(plan: &Plan, table: &str, expect: &Expect) {
    let mut mission = Mission::new(plan);
    feed(&mut mission, table);
    let mut text = String::new();
    for phase in mission.phases() {
        let end = phase.end.map_or("-".to_owned(), |end| format!("{:.1}", end.as_secs_f64()));
        write!(text, "{:.1}..{end} {} | {} |", phase.begin.as_secs_f64(), phase.name, phase.ended()).unwrap();
        for (index, track) in mission.tracks().iter().enumerate() {
            if let Some(peak) = phase.peak(index) {
                write!(text, " {}={}{}", track.name, track.text(peak), track.unit).unwrap();
            }
        }
        text.push('\n');
    }
    expect.assert_eq(&text);
}

#[test]
fn phases_follow_the_main_sequence() {
    check(
        &door(),
        OPENING,
        &expect![[r#"
            0.0..6.9 servo # near | near done | force=3.0N
            6.9..11.8 (open, approach) # hit | hit done | force=16.0N  torque=2.50Nm
            11.8..12.4 close | done |
            12.5..22.0 pull | done | force=28.8N angle=74.0deg
        "#]],
    );
}

#[test]
fn an_abort_ends_a_phase_and_a_stop_from_outside_decides_nothing() {
    check(
        &door(),
        "0 servo activated \n 0 near activated \n 1 near blocked \n 1 servo stopping \n 1.1 servo stopped",
        &expect![[r#"
            0.0..1.1 servo # near | near aborted: blocked |
        "#]],
    );
    check(
        &door(),
        "0 servo activated \n 0 near activated \n 1 near stopping \n 1 servo stopping \n 1.1 servo stopped \n 1.2 near stopped",
        &expect![[r#"
            0.0..1.2 servo # near | stopped |
        "#]],
    );
}

#[test]
fn a_loop_makes_a_new_phase_each_time_round() {
    let plan = plan(&["a", "b"], E::Recurrent(Box::new(run(0)), Box::new(run(1))));
    let round = "0 a activated \n 1 a done \n 1 b activated \n 2 b done \n 2 a activated \n 3 a done \n 3 b activated";
    check(
        &plan,
        round,
        &expect![[r#"
            0.0..1.0 a | done |
            1.0..2.0 b | done |
            2.0..3.0 a | done |
            3.0..- b | running |
        "#]],
    );
}

#[test]
fn what_goes_on_beside_a_loop_ends_the_round_in_which_it_ends() {
    let round = E::Recurrent(Box::new(run(0)), Box::new(run(1)));
    let plan = plan(&["first", "second", "low", "dock"], seq(vec![E::Disable(vec![round, run(2)]), run(3)]));
    let table = "0 first activated \n 0 low activated \n 2 first done \n 2 second activated \n 3.5 second done \n \
        3.5 first activated \n 3.7 low done \n 3.7 first stopping \n 3.8 first stopped \n 3.8 dock activated";
    check(
        &plan,
        table,
        &expect![[r#"
            0.0..3.5 first ;; second # low | second done |
            3.5..3.8 first ;; second # low | low done |
            3.8..- dock | running |
        "#]],
    );
}

#[test]
fn a_member_that_comes_twice_belongs_to_the_step_at_hand() {
    let plan = plan(&["a", "b"], seq(vec![run(0), E::Concurrent(vec![run(0), run(1)]), run(0)]));
    let table =
        "0 a activated \n 1 a done \n 1 a activated \n 1 b activated \n 2 b done \n 2.5 a done \n 3 a activated";
    check(
        &plan,
        table,
        &expect![[r#"
            0.0..1.0 a | done |
            1.0..2.5 a, b | a done |
            3.0..- a | running |
        "#]],
    );
}

#[test]
fn without_a_sequence_there_is_one_phase() {
    let table = "0 a activated \n 0 b activated \n 1 a done \n 4 b done";
    check(
        &plan(&["a", "b"], E::Concurrent(vec![run(0), run(1)])),
        table,
        &expect![[r#"
            0.0..4.0 a, b | b done |
        "#]],
    );
}

#[test]
fn the_end_is_told_once_and_closes_the_last_phase() {
    let mut mission = Mission::new(&door());
    feed(&mut mission, "0 servo activated \n 0 near activated");
    assert!(mission.phase().is_some());
    let cause = FailureCause::Signal(9);
    let failure = Failure { origin: "main/sys/hit/force".to_owned(), cause, at: seconds(12.34) };
    let ending = Ending::Aborted(failure);
    mission.report(&Report::Finished { ending, at: seconds(12.5), unconfirmed: vec!["c2".to_owned()] });
    let Some(Verdict { outcome: Outcome::Aborted(failure), at, unconfirmed }) = mission.verdict() else { panic!() };
    assert_eq!(failure.to_string(), "main ← sys ← hit ← force: SIGKILL (external) at 12.3 s");
    assert_eq!((*at, unconfirmed.len()), (seconds(12.5), 1));
    assert_eq!(mission.phase(), None);
    assert_eq!(mission.phases()[0].end, Some(seconds(12.5)));
}

#[test]
fn a_death_is_noted_once() {
    let mut mission = Mission::new(&door());
    feed(&mut mission, "0 servo activated \n 1 hit died \n 2 servo killed");
    let notes: Vec<String> = mission.notes().iter().map(|note| format!("{}: {}", note.process, note.text)).collect();
    assert_eq!(notes, ["sys/hit: died: SIGSEGV", "sys/servo: aborted: SIGKILL (external)"]);
}

#[test]
fn a_peak_that_is_told_late_belongs_to_the_phase_in_which_it_was() {
    let table = "0 servo activated \n 0 near activated \n 1 near force 3 N \n 2 near done \n 2 servo stopping \n \
                 2 servo stopped \n 2 hit activated \n 2.1 near force 5 N \n 1.95 near force -40 N";
    check(
        &door(),
        table,
        &expect![[r#"
            0.0..2.0 servo # near | near done | force=40.0N
            2.0..- (open, approach) # hit | running | force=5.0N
        "#]],
    );
    let mut mission = Mission::new(&door());
    feed(&mut mission, table);
    let track = &mission.tracks()[0];
    assert_eq!((track.last, track.peak, track.peak_at), (5.0, 40.0, seconds(1.95)));
}

#[test]
fn steps_are_told_as_the_spec_has_them() {
    let names = |expression| {
        let mut mission = Mission::new(&plan(&["a", "b"], expression));
        feed(&mut mission, "0 a activated \n 1 a done \n 1 b activated");
        mission.phases().iter().map(|phase| phase.name.clone()).collect::<Vec<_>>()
    };
    let within = |of: E| {
        let fail = E::Fail("the deadline `a within 5 s` in line 3 has passed".to_owned());
        E::Disable(vec![of, E::Sequence(Box::new(E::Wait(seconds(5.0))), Box::new(fail))])
    };
    let otherwise = |p, q| E::Otherwise(Box::new(p), Box::new(q));
    let wait = |of| E::Sequence(Box::new(E::Wait(seconds(0.5))), Box::new(of));
    assert_eq!(names(within(run(0))), ["a within 5 s"]);
    assert_eq!(names(within(seq(vec![run(0), run(1)]))), ["a", "b"]);
    assert_eq!(names(within(E::Concurrent(vec![run(0), run(1)]))), ["(a, b) within 5 s"]);
    assert_eq!(names(seq(vec![otherwise(run(0), E::Skip), run(1)])), ["a?", "b"]);
    assert_eq!(names(E::Concurrent(vec![otherwise(run(0), otherwise(run(0), run(0))), run(1)])), ["retry(2) a, b"]);
    assert_eq!(names(E::Concurrent(vec![otherwise(run(0), run(1)), run(1)])), ["a else b, b"]);
    let paused = E::AnyOf { count: 1, of: vec![otherwise(run(0), wait(run(0))), run(1)] };
    assert_eq!(
        names(E::Concurrent(vec![within(paused), run(1)])),
        ["any 1 of (retry(1, pause 0.5 s) a, b) within 5 s, b"]
    );
}

/// After a change, the phases are those of the new plan. The running phase continues as its step there. Earlier phases stay.
#[test]
fn a_changed_plan_has_phases_of_its_own() {
    let names = ["motion!", "servo!", "near", "look", "close"];
    let before = plan(&names[..3], E::Disable(vec![run(0), seq(vec![run(1), run(2)])]));
    // `servo` has ended and `near` runs. From now on, `look` runs beside it, before `close`.
    let mut names = names;
    names.swap(1, 3);
    let after = plan(&names, E::Disable(vec![run(0), seq(vec![run(3), E::Disable(vec![run(2), run(1)]), run(4)])]));
    let mut mission = Mission::new(&before);
    feed(&mut mission, "0 motion activated \n 0 servo activated \n 2 servo done \n 2 near activated");
    let told = |mission: &Mission| {
        let phases = mission.phases().iter().map(|phase| format!("{} {}", phase.name, phase.ended()));
        phases.collect::<Vec<_>>()
    };
    assert_eq!(told(&mission), ["servo done", "near running"]);
    mission.report(&Report::Replanned { plan: Box::new(after) });
    assert_eq!(told(&mission), ["servo done", "near # look running"]);
    feed_more(
        &mut mission,
        "3 look activated \n 4 look done \n 4 near stopping \n 4.1 near stopped \n 4.1 close activated",
    );
    assert_eq!(told(&mission), ["servo done", "near # look look done", "close running"]);
    // The change is undone: in the earlier plan, no running member belongs to a step.
    mission.report(&Report::Replanned { plan: Box::new(before) });
    assert_eq!(told(&mission)[2], "close running");
    feed_more(&mut mission, "5 servo activated");
    assert_eq!(told(&mission)[2..], ["close stopped", "servo running"]);
}

/// The states of an activity may run no program.
#[test]
fn the_states_of_an_activity_without_programs_are_phases() {
    let text = "activity Ask(here: Host) { host{here} initial state s { on after 1 s -> f; } final state f; }
        process main(){
            host{c1}
            instantiated_processes{ ask instof Ask(c1); }
            internal_event_actions{ ask }
        }";
    let compiled = compile(&Source::new("ask.dca", text), &[], &Options::named("ask"));
    let mut mission = Mission::new(&compiled.plan.expect("it has a plan"));
    let mut report = |change: Change, at: f64| {
        mission.report(&Report::Process { path: "main/ask".to_owned(), change, at: seconds(at) });
        mission.phases().iter().map(|phase| phase.name.clone()).collect::<Vec<_>>()
    };
    report(Change::Activated, 0.0);
    assert_eq!(report(Change::Entered { states: vec!["s".to_owned()] }, 0.0), ["s"]);
    assert_eq!(report(Change::Ended(Ending::Done(Vec::new())), 1.0), ["s"]);
}

/// The states of an activity are its phases. Its programs may be reported before the state that starts them. An
/// activity may leave a state although no program has ended.
#[test]
fn the_states_of_an_activity_are_phases() {
    let text = "module Step { done; }
        activity Fetch(here: Host) {
            host{here}
            look instof Step(here);
            take instof Step(here);
            initial state search { run look; on done -> rest; }
            state rest { on after 2 s -> take_it; }
            state take_it { run take; on done -> done; }
        }
        process main(){
            host{c1}
            instantiated_processes{ fetch instof Fetch(c1); }
            internal_event_actions{ fetch }
        }";
    let compiled = compile(&Source::new("fetch.dca", text), &[], &Options::named("fetch"));
    let mut mission = Mission::new(&compiled.plan.expect("it has a plan"));
    let mut report = |member: &str, change: Change, at: f64| {
        let path = format!("main/fetch{member}");
        mission.report(&Report::Process { path, change, at: seconds(at) });
        mission.phases().iter().map(|phase| format!("{} {}", phase.name, phase.ended())).collect::<Vec<_>>()
    };
    let entered = |state: &str| Change::Entered { states: vec![state.to_owned()] };
    let done = || Change::Ended(Ending::Done(Vec::new()));
    report("", Change::Activated, 0.0);
    report("/look", Change::Activated, 0.0);
    assert_eq!(report("", entered("search"), 0.1), ["search running"]);
    report("/look", done(), 1.0);
    assert_eq!(report("", entered("rest"), 1.0), ["search look done", "rest running"]);
    report("/take", Change::Activated, 3.0);
    assert_eq!(report("", entered("take_it"), 3.0), ["search look done", "rest left", "take_it running"]);
    assert_eq!(report("/take", done(), 4.0)[2], "take_it take done");
    assert_eq!(mission.phases()[1].took(seconds(9.0)), seconds(2.0));
    assert!(mission.notes().is_empty(), "{:?}", mission.notes());
}

/// The end of a program that the activity handles within the same state does not end the phase.
#[test]
fn a_handled_end_does_not_end_the_phase_of_an_activity() {
    let text = "module Step { done; }
        activity Watch(here: Host) {
            host{here}
            in cmd: Text;
            var n: 0..9 = 0;
            a instof Step(here);
            b instof Step(here);
            c instof Step(here);
            initial state work { run a, b; on a.aborted when n < 9 -> work { n += 1; } on message cmd -> next; }
            state next { run c; on message cmd -> last; on done -> last; }
            state last { run a; on done -> done; on message cmd -> done; }
        }
        process main(){
            host{c1}
            instantiated_processes{ watch instof Watch(c1); }
            internal_event_actions{ watch }
        }";
    let compiled = compile(&Source::new("watch.dca", text), &[], &Options::named("watch"));
    let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
    // The second column is the phases after all events.
    let cases = [
        // `a` fails and runs again; a message ends the state, and soon after also the next state.
        ("2.3 a killed, 2.3 a activated, 2.4 a stopping, 2.4 a stopped, 2.4 = next", "work left, next left"),
        ("2.3 a killed, 2.3 a activated, 7.8 a stopping, 7.8 a stopped, 7.8 = next", "work left, next left"),
        ("2.3 a killed, 2.3 a activated, 7.8 b stopping, 9.8 b stopped, 9.8 = next", "work left, next left"),
        ("2.3 a killed, 2.3 a activated, 7.8 a killed, 7.8 = next", "work a aborted: SIGKILL (external), next left"),
        // `b` is done, which no transition waits for.
        ("1.0 b done, 7.8 a stopping, 7.9 a stopped, 7.9 = next", "work left, next left"),
        ("1.0 b done, 7.8 a killed, 7.8 = next", "work a aborted: SIGKILL (external), next left"),
        // The end of `a` ends the state, and stopping `b` takes long.
        ("1.0 a done, 1.0 b stopping, 5.0 b stopped, 5.0 = next", "work a done, next left"),
        // The end of `a` stops `b`, and the state goes on with nothing, or with `c`.
        ("1.0 a done, 1.0 b stopping, 5.0 b stopped, 7.8 = next", "work left, next left"),
        (
            "1.0 a done, 1.0 b stopping, 1.1 b stopped, 1.1 c activated, 1.2 c stopping, 1.2 = next",
            "work left, next left",
        ),
        // `a` is stopped and runs again before it fails.
        (
            "1.0 a stopping, 1.1 a stopped, 1.1 a activated, 3.0 a killed, 3.0 = next",
            "work a aborted: SIGKILL (external), next left",
        ),
        // The activity ends with a message, long after `b` was done.
        ("1.0 b done, 7.8 = ended", "work left"),
        ("1.0 a done, 1.1 = ended", "work a done"),
    ];
    for (events, expected) in cases {
        let mut mission = Mission::new(&plan);
        let mut report = |at: f64, member: &str, change: Change| {
            mission.report(&Report::Process { path: format!("main/watch{member}"), change, at: seconds(at) });
        };
        let entered = |state: &str| Change::Entered { states: vec![state.to_owned()] };
        report(0.0, "", Change::Activated);
        report(0.0, "/a", Change::Activated);
        report(0.0, "/b", Change::Activated);
        report(0.0, "", entered("work"));
        for line in events.split(", ") {
            let [at, who, what] = line.split(' ').collect::<Vec<_>>()[..] else { panic!("{line}") };
            let at = at.parse().unwrap();
            match (who, what) {
                ("=", "ended") => report(at, "", Change::Ended(Ending::Done(Vec::new()))),
                ("=", state) => report(at, "", entered(state)),
                (member, word) => {
                    let path = format!("main/watch/{member}");
                    let Report::Process { change, .. } = event(&path, word, seconds(at)) else { panic!("{word}") };
                    report(at, &format!("/{member}"), change);
                }
            }
        }
        mission.report(&Report::Finished { ending: Ending::Stopped, at: seconds(20.0), unconfirmed: Vec::new() });
        let found = mission.phases().iter().map(|phase| format!("{} {}", phase.name, phase.ended()));
        assert_eq!(found.collect::<Vec<_>>().join(", "), expected, "{events}");
    }
}
