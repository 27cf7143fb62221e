//! Whole nodes on virtual time: agents, the frames between them, and programs that follow a script.

#![expect(clippy::wildcard_enum_match_arm, reason = "a test looks for one variant and shows any other")]

mod absence;
mod activities;
mod adoption;
mod aligned;
mod boot;
mod changes;
mod check_in;
mod components;
mod detours;
mod devices;
mod estop;
mod externals;
mod flaps;
mod golden;
mod large;
mod leaving;
mod listening;
mod losses;
mod messages;
mod names;
mod namesakes;
mod network;
mod orders;
mod overlap;
mod programs;
mod quiet;
mod reasons;
mod refusals;
mod rejoining;
mod restarts;
mod scale;
mod starting;
mod supervision;
mod switching;
mod unended;
mod waiting;
mod world;

use node::logic::agent::Input;
use node::logic::effect::ProcessId;
use node::logic::protocol::{
    Answer, Change, Deployment, Ending, FailureCause, ProgramEnd, Report, Request, SEVERAL, StopReply,
};
use std::collections::BTreeSet;
use std::time::Duration;
use world::{Coming, World};

const TWO_HOSTS: &str = r#"
process Pair(here, there) {
    host { there }
    instantiated_processes {
        sensor instof Sensor(here);
        first instof Step(there);
        second instof Step(here);
    }
    internal_connections(sensor, feed) { sensor, Out -> first, In; }
    internal_connections(first, on) { first, Out -> second, In; }
    internal_event_actions { sensor[feed] , (first[on] ; second) }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c1", "c2"); last instof Step("c2"); }
    internal_event_actions { pair ; last }
}
"#;

#[test]
fn a_spec_on_two_hosts_runs_to_its_end_and_leaves_nothing() {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    assert_eq!(world.alive, BTreeSet::new());
    assert_eq!(world.wires_open, BTreeSet::new());
    let expected = ["Sensor with wires {0, 1}", "Step with wires {0, 1}", "Step with wires {0}", "Step with wires {}"];
    assert_eq!(world.log, expected);
}

#[test]
fn a_crash_ends_the_mission_with_its_cause() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
    world.run_for(Duration::from_millis(500));
    world.kill("c1", 0);
    world.run_for(Duration::from_secs(8));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/pair/sensor", &FailureCause::Signal(9)));
    assert!(failure.to_string().starts_with("main ← pair ← sensor: SIGKILL (external) at 0."), "{failure}");
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn a_program_that_died_idle_fails_when_its_turn_comes() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(40));
    world.kill("c2", 3);
    world.run_for(Duration::from_secs(5));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/last", &FailureCause::Signal(9)));
}

#[test]
fn stop_ends_it_everywhere_even_what_does_not_listen() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy(
        "c1",
        &TWO_HOSTS
            .replace("first instof Step", "first instof Stubborn")
            .replace("[feed]", "")
            .replace("[on]", "")
            .replace("sensor, Out -> first, In;", "")
            .replace("first, Out -> second, In;", ""),
    );
    world.run_for(Duration::from_millis(500));
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(10));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert_eq!(world.alive, BTreeSet::new());
}

#[test]
fn a_lost_host_aborts_what_ran_there_and_a_short_cut_does_not() {
    let long = TWO_HOSTS.replace("last instof Step", "last instof Long");
    for (cut_for, survives) in [(2, true), (9, false)] {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", &long);
        world.run_for(Duration::from_secs(1));
        world.cut.insert("c2".into());
        for (on, lost, boot) in [("c1", "c2", 2), ("c2", "c1", 1)] {
            world.at(900, on, Coming::Input(Input::Vanished { host: lost.into(), boot }));
        }
        world.run_for(Duration::from_secs(cut_for));
        world.cut.clear();
        for (on, back, boot) in [("c1", "c2", 2), ("c2", "c1", 1)] {
            world.at(100, on, Coming::Input(Input::Appeared { host: back.into(), boot }));
        }
        world.run_for(Duration::from_secs(40));
        let ending = match world.last_report(call) {
            Report::Finished { ending, .. } => ending,
            other => panic!("{other:?}"),
        };
        match ending {
            Ending::Done(_) => assert!(survives),
            Ending::Aborted(failure) => {
                assert!(!survives, "{failure}");
                assert_eq!(failure.cause, FailureCause::HostLost("c2".into()));
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(world.alive, BTreeSet::new(), "a host that lost its home leaves by itself");
    }
}

/// If a host is lost while it stops a member, the loss is reported as the failure, and not the unconfirmed member.
#[test]
fn a_host_that_is_lost_while_it_stops_is_told_as_that() {
    let text = r#"process main() {
    host { "c1" }
    instantiated_processes { rock instof Stubborn("c2"); hit instof Step("c1"); last instof Step("c1"); }
    internal_event_actions { (rock # hit) ; last }
}"#;
    // Cut before the order arrives, and after.
    for cut_at in [40, 56] {
        let mut world = World::new(&["c1", "c2"]);
        world.immortal = true;
        let call = world.deploy("c1", text);
        world.run_for(Duration::from_millis(cut_at));
        world.cut.insert("c2".into());
        world.run_for(Duration::from_secs(40));
        let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
            panic!("{:?}", world.last_report(call))
        };
        assert_eq!(failure.origin, "main/rock", "cut at {cut_at} ms");
        assert_eq!(failure.cause, FailureCause::HostLostStopping("c2".into()), "cut at {cut_at} ms");
        assert_eq!(world.log.len(), 2, "`last` must not run beside `rock`: {:?}", world.log);
    }
}

/// Here `Stubborn` ignores the stop, and its shim cannot kill it either: the detector of the inner group fires, and the
/// unconfirmed stop there must not look like a clean stop to the group above.
#[test]
fn a_stop_that_nobody_confirms_is_told_to_the_top() {
    let text = r#"
process Inner(here) {
    instantiated_processes { rock instof Stubborn(here); hit instof Step(here); }
    internal_event_actions { rock # hit }
}
process main() {
    host { "c1" }
    instantiated_processes { inner instof Inner("c1"); last instof Step("c1"); }
    internal_event_actions { inner ; last }
}
"#;
    let mut world = World::new(&["c1"]);
    world.immortal = true;
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(30));
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("not aborted")
    };
    assert_eq!((failure.origin.as_str(), &failure.cause), ("main/inner/rock", &FailureCause::StopUnconfirmed));
    assert_eq!(world.log, ["Stubborn with wires {}", "Step with wires {}"], "`last` must not run beside `rock`");
}

#[test]
fn watchers_see_every_change() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    let changes: Vec<String> = world.answers[&call]
        .iter()
        .filter_map(|answer| match answer {
            Answer::Report(Report::Process { path, change: Change::Activated, .. }) => Some(path.clone()),
            _ => None,
        })
        .collect();
    assert_eq!(changes, ["main", "main/pair", "main/pair/sensor", "main/pair/first", "main/pair/second", "main/last"]);
}

/// Opens wires at a host that does not answer, at 50 ms; stops on contact at 100 ms.
fn behind_a_slow_host(actions: &str) -> World {
    let text = format!(
        r#"
process main() {{
    host {{ "c1" }}
    instantiated_processes {{
        cam instof Sensor("c2");
        first instof Step("c1");
        viewer instof Long("c1");
        near instof Step("c1");
        contact instof Step("c1");
        arm instof Long("c1");
    }}
    internal_connections(viewer, view) {{ cam, Out -> viewer, In; }}
    internal_event_actions {{ {actions} }}
}}
"#
    );
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", &text);
    while world.log.is_empty() {
        world.run_for(Duration::from_millis(1));
    }
    world.run_for(Duration::from_millis(20));
    world.cut.insert("c2".into());
    world
}

/// A stop does not wait behind another member that waits for its wires.
#[test]
fn a_stop_does_not_wait_behind_a_slow_host() {
    let mut world = behind_a_slow_host("cam , (first ; viewer[view]) , ((near ; contact) # arm)");
    let is_running = |world: &World, path: &str| {
        let leaves = &world.plan.as_ref().unwrap().leaves;
        let is_meant = |leaf: u32| leaves[leaf as usize].path == format!("main/{path}");
        world.running.keys().any(|(_, process)| is_meant(process.leaf))
    };
    assert!(is_running(&world, "arm"));
    world.run_for(Duration::from_millis(130));
    assert!(!is_running(&world, "arm"), "contact was made 30 ms ago");
    assert!(!is_running(&world, "viewer"), "its wires are not confirmed");
    world.run_for(Duration::from_secs(1));
    assert!(is_running(&world, "viewer"), "it is not kept waiting for longer than 1 s");
}

/// A member that waits for its wires can be stopped: it never runs.
#[test]
fn an_activation_that_waits_for_its_wires_can_be_stopped() {
    let mut world = behind_a_slow_host("cam # ((first ; viewer[view]) # (near ; contact))");
    world.run_for(Duration::from_millis(500));
    world.cut.clear();
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.log.iter().filter(|line| line.starts_with("Long")).count(), 0, "{:?}", world.log);
    assert_eq!(world.ending(world.calls[0]), &Ending::Done(vec![]));
    assert_eq!(world.wires_open, BTreeSet::new());
}

/// Rounds that end at once must not keep the node from anything else: found by a reader, both hung the agent.
#[test]
fn a_loop_that_takes_no_time_can_be_stopped() {
    let main = |body: &str| {
        format!(
            r#"process main() {{
    host {{ "c1" }}
    instantiated_processes {{ a instof Step("c1"); }}
    internal_event_actions {{ {body} }}
}}"#
        )
    };
    for body in ["a? ;; skip", "(a? , wait(0 s)) ;; wait(0 s)"] {
        let mut world = World::new(&["c1"]);
        let call = world.deploy("c1", &main(body));
        world.run_for(Duration::from_millis(300));
        world.kill("c1", 0);
        world.run_for(Duration::from_secs(1));
        world.stop("c1");
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.ending(call), &Ending::Stopped, "{body}");
    }
}

#[test]
fn what_has_not_begun_can_be_stopped() {
    let mut world = World::new(&["c1"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(100));
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(5));
    assert!(matches!(world.last_report(call), Report::Refused { .. }));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert_eq!(world.alive, BTreeSet::new());
}

const WRITES: [&str; 2] = ["Traceback (most recent call last):", "ValueError: no lens"];

#[test]
fn a_program_that_fails_says_why_and_its_output_is_there_after_the_end() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
    world.run_for(Duration::from_millis(500));
    world.output = WRITES.map(str::to_owned).to_vec();
    world.kill("c1", 0);
    world.run_for(Duration::from_secs(3));
    let Ending::Aborted(failure) = world.ending(call) else { panic!("not aborted") };
    let output = WRITES.map(str::to_owned).to_vec();
    assert_eq!(failure.cause, FailureCause::Program { end: ProgramEnd::Signal(9), restarts: 0, output });
    assert!(failure.to_string().starts_with("main ← pair ← sensor: SIGKILL (external) at 0."), "{failure}");
    let logs = |process: &str| Request::Logs { deployment: None, process: process.into(), follow: false };
    let deployment = Deployment { name: "test".into(), epoch: 1 };
    world.ask("c1", logs("sensor"));
    world.ask("c1", Request::Output { deployment: deployment.clone() });
    let (unknown, several) = (world.ask("c1", logs("first")), world.ask("c2", logs("main/pair/none")));
    let never = world.ask("c2", Request::Output { deployment: Deployment { epoch: 2, ..deployment.clone() } });
    world.run_for(Duration::from_millis(10));
    let process = |leaf| ProcessId { deployment: deployment.clone(), leaf };
    assert_eq!(world.tailed, [vec![process(0)], vec![process(0), process(2)]]);
    for call in [unknown, several, never] {
        assert!(matches!(&world.answers[&call][..], [Answer::Refused(why)] if !why.starts_with(SEVERAL)));
    }
}

/// The host of a group's supervisor is lost: its programs here are stopped before something takes its place.
#[test]
fn a_lost_supervisor_leaves_nothing_running() {
    let text = r#"
process Pair(here, there) {
    host { there }
    instantiated_processes { slow instof Long(here); }
    internal_event_actions { slow }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c1", "c2"); fallback instof Long("c1"); }
    internal_event_actions { pair else fallback }
}
"#;
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    assert_eq!(world.running.len(), 1);
    world.cut.insert("c2".into());
    world.at(900, "c1", Coming::Input(Input::Vanished { host: "c2".into(), boot: 2 }));
    world.run_for(Duration::from_millis(6500));
    let running: Vec<u32> = world.running.keys().map(|(_, process)| process.leaf).collect();
    assert_eq!(running.len(), 1, "the fallback alone");
    // It comes back with the same boot: its part of the deployment is fenced off.
    world.cut.clear();
    world.at(0, "c1", Coming::Input(Input::Appeared { host: "c2".into(), boot: 2 }));
    world.run_for(Duration::from_secs(8));
    assert!(world.alive.iter().all(|(host, _)| host == "c1"));
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(30));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert_eq!(world.alive, BTreeSet::new());
}
