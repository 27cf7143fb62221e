//! Programs that die and are started again, on virtual time.

use super::world::{Draw, World};
use comms::logic::switch::{Flip, Opening};
use node::logic::protocol::{Answer, Change, Ending, FailureCause, Report};
use shim::protocol::{EndReason, ProgramEnd, ShimReport};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A sensor on one host feeds a task on another, which feeds a third here; then a plain program.
const RELAY: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        sensor instof Sensor("c1") { restart transient; }
        first instof Long("c2") { restart transient; }
        second instof Step("c1") { restart permanent; }
        script instof Script("c2") { restart transient; }
    }
    internal_connections(sensor, feed) { sensor, Out -> first, In; }
    internal_connections(first, on) { first, Out -> second, In; }
    internal_event_actions { sensor[feed] , (first[on] ; second ; script) }
}
"#;

/// Checks the invariants for moments without messages in transit: each living program is where its consumers look for
/// it, and its wires are as its supervisor wants them.
#[track_caller]
fn check_links(world: &World) {
    let plan = world.plan.as_ref().expect("it is deployed");
    let alive: BTreeMap<u32, _> = world.alive.iter().map(|(_, process)| (process.leaf, process)).collect();
    for wire in &plan.wires {
        let (Some(from), Some(to)) = (alive.get(&wire.from.leaf), alive.get(&wire.to.leaf)) else { continue };
        let expected = BTreeSet::from([world.session(from)]);
        assert_eq!(world.dialled[*to], expected, "{} looks for {}", wire.to.leaf, wire.from.leaf);
    }
}

/// Returns the changes of each process, by its path: each activation must end once, before the next.
fn changes(world: &World, call: u64) -> BTreeMap<String, Vec<Change>> {
    let mut changes: BTreeMap<String, Vec<Change>> = BTreeMap::new();
    for answer in &world.answers[&call] {
        if let Answer::Report(Report::Process { path, change, .. }) = answer {
            changes.entry(path.clone()).or_default().push(change.clone());
        }
    }
    for (path, changes) in &changes {
        let steps = changes.iter().filter_map(|change| match change {
            Change::Activated => Some(true),
            Change::Ended(_) => Some(false),
            _ => None,
        });
        let steps: Vec<bool> = steps.collect();
        assert!(steps.chunks(2).all(|pair| pair == [true, false]), "{path}: {changes:?}");
    }
    changes
}

fn restarts(changes: &[Change]) -> usize {
    changes.iter().filter(|change| matches!(change, Change::Restarting { .. })).count()
}

#[test]
fn a_program_that_dies_goes_on_where_it_was() {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", RELAY);
    world.run_for(Duration::from_secs(1));
    for (host, leaf) in [("c2", 1), ("c1", 0)] {
        world.kill(host, leaf);
        world.run_for(Duration::from_millis(200));
        check_links(&world);
    }
    // `second` reads from `first`, so that one's wire must be open again; `second` itself is killed while it is idle.
    assert_eq!(world.wires_open, BTreeSet::from([0, 1]));
    world.kill("c1", 2);
    world.run_for(Duration::from_millis(200));
    check_links(&world);
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let changes = changes(&world, call);
    assert_eq!(["sensor", "first", "second"].map(|name| restarts(&changes[&format!("main/{name}")])), [1, 1, 1]);
    assert!(changes["main/first"].contains(&Change::Resumed) && !changes["main/second"].contains(&Change::Resumed));
    assert_eq!(world.alive, BTreeSet::new());
}

/// As a consumer that is connected late does.
#[test]
fn a_consumer_that_was_started_again_gets_the_last_values_of_latched_wires() {
    let latched = RELAY.replace("first, In;", "first, In latch;");
    for (text, host, expected) in
        [(latched.clone(), "c2", 1), (latched.replace("\"c2\"", "\"c1\""), "c1", 1), (RELAY.to_owned(), "c2", 0)]
    {
        let mut world = World::new(&["c1", "c2"]);
        world.deploy("c1", &text);
        world.run_for(Duration::from_secs(1));
        world.traffic.flips.clear();
        world.kill(host, 1);
        world.run_for(Duration::from_millis(200));
        let again = Flip { close: vec![0], open: vec![Opening { wire: 0, after: Vec::new() }], ..Flip::default() };
        let found = world.traffic.flips.iter().filter(|(producer, flip)| *producer == 0 && *flip == again).count();
        assert_eq!(found, expected, "{host}: {:?}", world.traffic.flips);
        assert!(world.wires_open.contains(&0));
    }
}

#[test]
fn a_plain_program_is_started_again_unless_it_is_done() {
    let mut world = World::new(&["c1", "c2"]);
    let text = RELAY.replace("(first[on] ; second ; script)", "script");
    let call = world.deploy("c1", &text);
    world.run_for(Duration::from_millis(40));
    world.kill("c2", 3);
    world.run_for(Duration::from_secs(3));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let changes = changes(&world, call);
    assert_eq!(restarts(&changes["main/script"]), 1, "{changes:?}");
}

/// A shim that knows why a program has ended reports it, and the reason is passed on like any other.
#[test]
fn a_hang_is_a_death_with_a_reason_of_its_own() {
    let (hung, slow) = (Duration::from_millis(500), Duration::from_secs(3));
    let reasons = [
        (EndReason::Watchdog(hung), FailureCause::Watchdog(hung), "its loop has not come round for 0.5 s"),
        (EndReason::StartTimeout(slow), FailureCause::StartTimeout(slow), "it was not ready within 3 s"),
        (EndReason::AgentLost, FailureCause::AgentLost, "was stopped because its node was gone (`on_agent_loss`)"),
    ];
    for (why, cause, words) in reasons {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", RELAY);
        world.run_for(Duration::from_millis(500));
        let hangs = ShimReport::Ended { end: ProgramEnd::Signal(6), why };
        for _ in 0..6 {
            world.end("c2", 1, hangs.clone());
            world.run_for(Duration::from_secs(1));
        }
        world.run_for(Duration::from_secs(5));
        let changes = changes(&world, call);
        let told = changes["main/first"].iter().filter_map(|change| match change {
            Change::Restarting { cause, count } => Some((cause, *count)),
            _ => None,
        });
        assert!(told.eq((1..=5).map(|count| (&cause, count))), "{changes:?}");
        let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
        assert_eq!(failure.cause, FailureCause::Exhausted { last: words.to_owned(), restarts: 5 });
        assert!(failure.to_string().starts_with(&format!("main ← first: {words} after 5 restarts at 5.")), "{failure}");
        // Its last output is reported with it: it shows where the program hung.
        let (cause, output) = (Box::new(cause), vec!["loading the map".to_owned()]);
        let told = cause.as_ref().clone().of_program(2, output.clone());
        assert_eq!((told.to_string(), told.output()), (format!("{words} after 2 restarts"), &output[..]));
        assert_eq!(told, FailureCause::Ended { cause, restarts: 2, output });
    }
}

/// The first time at once, then after pauses that grow. An activation waits for that, a stop does not.
#[test]
fn a_back_off_keeps_a_program_away_and_a_stop_does_not_wait_for_it() {
    let mut world = World::new(&["c1", "c2"]);
    let slow = r#"first instof Long("c2") { restart transient; backoff 10 s to 30 s; }"#;
    let call = world.deploy("c1", &RELAY.replace(r#"first instof Long("c2") { restart transient; }"#, slow));
    world.run_for(Duration::from_secs(1));
    let is_there = |world: &World| world.alive.iter().any(|(_, process)| process.leaf == 1);
    world.kill("c2", 1);
    world.run_for(Duration::from_millis(50));
    assert!(is_there(&world), "the first time at once");
    for (at_least, at_most) in [(8, 10), (16, 20), (24, 30)] {
        world.kill("c2", 1);
        world.run_for(Duration::from_secs(at_least));
        assert!(!is_there(&world), "after {at_least} s");
        world.run_for(Duration::from_secs(at_most - at_least) + Duration::from_millis(500));
        assert!(is_there(&world), "after {at_most} s");
        check_links(&world);
    }
    world.kill("c2", 1);
    world.run_for(Duration::from_secs(1));
    world.stop("c1");
    world.run_for(Duration::from_secs(4));
    assert_eq!((world.ending(call), &world.alive), (&Ending::Stopped, &BTreeSet::new()));
    let changes = changes(&world, call);
    assert_eq!(restarts(&changes["main/first"]), 5, "the first of them was long ago: {changes:?}");
}

#[test]
fn what_dies_again_and_again_is_given_up_with_the_count() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", RELAY);
    world.run_for(Duration::from_millis(500));
    for _ in 0..6 {
        world.kill("c2", 1);
        // The longest pause is 0.8 s.
        world.run_for(Duration::from_secs(1));
    }
    world.run_for(Duration::from_secs(5));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    let cause = FailureCause::Exhausted { last: "SIGKILL (external)".to_owned(), restarts: 5 };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/first", &cause));
    assert!(failure.to_string().starts_with("main ← first: SIGKILL (external) after 5 restarts at 5."), "{failure}");
    assert_eq!(restarts(&changes(&world, call)["main/first"]), 5);
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn what_is_given_up_while_idle_is_missed_when_its_turn_comes() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", RELAY);
    world.run_for(Duration::from_millis(500));
    for _ in 0..6 {
        world.kill("c1", 2);
        world.run_for(Duration::from_secs(1));
    }
    assert!(world.answers[&call].iter().all(|answer| !matches!(answer, Answer::Report(Report::Finished { .. }))));
    world.run_for(Duration::from_secs(10));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    assert_eq!(failure.origin, "main/second");
}

/// A program that is being started again runs nothing. So a stop needs no answer from it, and its end is a stop and no
/// failure.
#[test]
fn a_program_that_is_being_started_again_can_be_stopped() {
    for millis in [0, 1, 3, 6, 8, 10, 12] {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", RELAY);
        world.run_for(Duration::from_millis(500));
        world.kill("c2", 1);
        world.run_for(Duration::from_millis(millis));
        world.stop("c1");
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.ending(call), &Ending::Stopped, "{millis} ms after the kill");
        changes(&world, call);
        assert_eq!(world.alive, BTreeSet::new());
    }
}

/// A program that was ended by force is over: nothing is restarted after a stop, except for an activation that needs
/// it.
#[test]
fn a_program_that_was_ended_by_force_is_started_when_it_is_needed() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        stubborn instof Stubborn("c1") { restart transient; }
        step instof Step("c1");
        long instof Long("c1");
    }
    internal_event_actions { (stubborn # step) ; (stubborn # step) ; (stubborn # long) }
}
"#;
    let starts = |changes: &[Change]| changes.iter().filter(|change| matches!(change, Change::Started { .. })).count();
    for stops in [false, true] {
        let mut world = World::new(&["c1"]);
        let call = world.deploy("c1", text);
        world.run_for(Duration::from_secs(if stops { 1 } else { 60 }));
        if stops {
            world.stop("c1");
            world.run_for(Duration::from_secs(30));
        }
        let expected = if stops { Ending::Stopped } else { Ending::Done(vec![]) };
        assert_eq!(world.ending(call), &expected);
        let changes = changes(&world, call);
        let stubborn = &changes["main/stubborn"];
        assert_eq!((restarts(stubborn), starts(stubborn)), (0, 3), "{stubborn:?}");
        assert!(!matches!(stubborn.last(), Some(Change::Started { .. })), "{stubborn:?}");
        assert_eq!(world.alive, BTreeSet::new());
    }
}

/// A death fails one activation. The next activation of a controller gets a new program of its kind, with or without
/// restarts.
#[test]
fn a_controller_that_has_died_is_started_anew_with_its_next_activation() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes { long instof Long("c1"); }
    internal_event_actions { retry(2) long }
}
"#;
    let starts = |changes: &[Change]| changes.iter().filter(|change| matches!(change, Change::Started { .. })).count();
    // It dies in the first try, or before it; with the third death the last try has failed.
    for (deaths, is_done) in [(1, true), (2, true), (3, false)] {
        let mut world = World::new(&["c1"]);
        let call = world.deploy("c1", text);
        for _ in 0..deaths {
            world.run_for(Duration::from_millis(500));
            world.kill("c1", 0);
        }
        world.run_for(Duration::from_secs(60));
        assert_eq!(matches!(world.ending(call), Ending::Done(_)), is_done, "{deaths}: {:?}", world.ending(call));
        let changes = changes(&world, call);
        assert_eq!(starts(&changes["main/long"]), deaths.min(2) + 1, "{:?}", changes["main/long"]);
        assert_eq!(world.alive, BTreeSet::new());
    }
}

/// For any deaths of programs, as long as none dies too often, the mission does not notice.
#[test]
fn whatever_dies_whenever_the_mission_is_done() {
    for seed in 0..300 {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2", "c3"]);
        let call = world.deploy("c1", RELAY);
        // Programs that die before GO are a reason not to begin.
        world.run_for(Duration::from_millis(20));
        let mut deaths = BTreeMap::<u32, u32>::new();
        for _ in 0..draw.below(12) {
            let bound = if draw.below(2) == 0 { 10 } else { 1500 };
            world.run_for(Duration::from_millis(draw.below(bound)));
            let alive: Vec<(String, u32)> = world.alive.iter().map(|(host, one)| (host.clone(), one.leaf)).collect();
            let Some((host, leaf)) = alive.get(draw.index(4)) else { continue };
            let count = deaths.entry(*leaf).or_default();
            if *count < 5 {
                *count += 1;
                world.kill(host, *leaf);
            }
        }
        world.run_for(Duration::from_secs(2));
        check_links(&world);
        world.run_for(Duration::from_secs(100));
        assert_eq!(world.ending(call), &Ending::Done(vec![]), "seed {seed}: {deaths:?}");
        changes(&world, call);
        assert_eq!(world.alive, BTreeSet::new(), "seed {seed}");
    }
}
