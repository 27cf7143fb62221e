//! A large spec is deployed repeatedly. Nothing is left of it, and the node does not grow.

use dca_tests::cluster::{Cluster, Process, SOON, Stream, descriptors, rounds, threads, wait_until};
use node::logic::protocol::NodeStatus;
use std::fmt::Write;
use std::time::Duration;

const GROUPS: usize = 5;
const LEAVES_PER_GROUP: usize = 40;
/// The number of programs that one `dca stop` has to end.
const PROGRAMS: usize = 500;
/// The longest time until sockets of the node, and ending shims, have settled after a round.
const SETTLE: Duration = Duration::from_secs(5);
/// The number of threads that pools of the network library may start late and keep. One leftover thread in each round would be
/// more.
const LATE: usize = 3;
/// How long the threads of a pool may stay without work. Tokio keeps them for 10 s.
const POOL: Duration = Duration::from_secs(30);

/// 200 leaves in 5 nested groups are deployed and stopped on one machine. After four rounds, no thread, descriptor or process is
/// left over.
#[test]
fn two_hundred_leaves_come_and_go() {
    come_and_go(4);
}

#[test]
#[ignore = "long: 20 rounds"]
fn two_hundred_leaves_come_and_go_again_and_again() {
    come_and_go(rounds(20));
}

fn come_and_go(times: usize) {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("local", &[]);
    let file = cluster.file("many.dca", &nested());
    // The network library starts its threads with the first caller.
    assert_eq!(here.ask(&["nodes"]).code, Some(0));
    let limit = threads(node.pid()) + LATE;
    let mut descriptors_first = None;
    for round in 1..=times {
        let deployed = here.dca(&["deploy", "--no-record", &file]);
        deployed.wait_for(Stream::Err, "200 programs on 1 host, started in", SOON);
        if round == 1 {
            // All programs receive GO at once, and each shim reports when its program runs.
            let all_run = || running(&here.statuses(&[])) == GROUPS * LEAVES_PER_GROUP;
            assert!(wait_until(SETTLE, all_run).is_some(), "{:#?}", here.statuses(&[]));
        }
        let stop = here.ask(&["stop", "many"]);
        assert_eq!(stop.code, Some(0), "{stop}");
        // A shim takes a moment to end after its last report.
        let is_other = |process: &Process| {
            process.pid.cast_unsigned() != node.pid() && process.pid.cast_unsigned() != deployed.pid()
        };
        let left = || cluster.left().into_iter().filter(is_other).collect::<Vec<_>>();
        wait_until(SETTLE, || left().is_empty()).unwrap_or_else(|| panic!("after round {round}: {:?}", left()));
        let ended = deployed.ended(SOON);
        assert!(ended.code == Some(1) && ended.out.starts_with("many: stopped after"), "{ended}");

        let count = descriptors(node.pid()).len();
        let limit = *descriptors_first.get_or_insert(count);
        let is_as_before = || descriptors(node.pid()).len() <= limit;
        let grown = || format!("{limit} after round 1, more after {round}: {:#?}", descriptors(node.pid()));
        wait_until(SETTLE, is_as_before).unwrap_or_else(|| panic!("descriptors: {}", grown()));
    }
    let took = wait_until(POOL, || threads(node.pid()) <= limit);
    assert!(took.is_some(), "at most {limit} threads expected, {} after the last round", threads(node.pid()));
}

/// `dca stop` ends 500 programs on one machine, and reports this with exit code 0.
#[test]
fn five_hundred_programs_stop_when_asked() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("local", &[]);
    let deployed = here.dca(&["deploy", "--no-record", &cluster.file("crowd.dca", &crowd())]);
    deployed.wait_for(Stream::Err, "500 programs on 1 host, started in", 2 * SOON);
    let stop = here.dca(&["stop", "crowd"]).ended(2 * SOON);
    assert_eq!(stop.code, Some(0), "{stop}");
    let ended = deployed.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.starts_with("crowd: stopped after"), "{ended}");
    assert!(!ended.out.contains("not confirmed"), "{ended}");
    let is_node = |process: &Process| process.pid.cast_unsigned() == node.pid();
    let left = || cluster.left().into_iter().filter(|process| !is_node(process)).collect::<Vec<_>>();
    wait_until(SETTLE, || left().is_empty()).unwrap_or_else(|| panic!("left: {:?}", left()));
}

/// Returns a spec of [`PROGRAMS`] simultaneous plain programs.
fn crowd() -> String {
    let leaves: Vec<String> = (1..=PROGRAMS).map(|leaf| format!("idle{leaf}")).collect();
    let declared: String =
        leaves.iter().map(|leaf| format!("{leaf} instof Idle(local) {{ ready within 60 s; }} ")).collect();
    format!(
        "module Idle(host) {{ exec \"sleep 3600\"; plain; service; }}\nprocess main() {{\n  host {{ local }}\n  \
         instantiated_processes {{ {declared}}}\n  internal_event_actions {{ {} }}\n}}",
        leaves.join(", ")
    )
}

/// Returns how many programs run.
fn running(statuses: &[NodeStatus]) -> usize {
    let processes = statuses.iter().flat_map(|node| &node.deployments).flat_map(|part| &part.processes);
    processes.filter(|process| process.pid.is_some() && process.state == "running").count()
}

/// Returns a spec of nested groups. Each group has plain programs and one pair of controllers.
fn nested() -> String {
    let mut text = "module Idle(host) { exec \"sleep 3600\"; plain; service; }\n".to_owned();
    for group in 1..=GROUPS {
        let name = if group == 1 { "main".to_owned() } else { format!("Group{group}") };
        let plain = LEAVES_PER_GROUP - 2;
        let mut members: Vec<String> = (1..=plain).map(|leaf| format!("idle{leaf}")).collect();
        let mut declared: String = members.iter().map(|leaf| format!("{leaf} instof Idle(local); ")).collect();
        declared += "source instof RateSource(local); monitor instof RateMonitor(local); ";
        members.extend(["source[lbl1]".to_owned(), "monitor".to_owned()]);
        if group < GROUPS {
            write!(declared, "inner instof Group{}(); ", group + 1).expect("a string takes everything");
            members.push("inner".to_owned());
        }
        let connections = "internal_connections(source, lbl1) { source, Out -> monitor, In; }";
        let members = members.join(", ");
        writeln!(
            text,
            "process {name}() {{\n  host {{ local }}\n  instantiated_processes {{ {declared}}}\n  {connections}\n  \
             internal_event_actions {{ {members} }}\n}}"
        )
        .expect("a string takes everything");
    }
    text
}
