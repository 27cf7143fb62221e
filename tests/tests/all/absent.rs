//! Reports about a node that no longer answers, and about the processes that may run there.

use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Host, Program, SOON, wait_until};
use rustix::process::Signal;
use std::time::Duration;

/// The longest time from the end of a node until it counts as lost, with a small reserve.
const LOST_WITHIN: Duration = Duration::from_secs(9);
/// The longest duration of a mission with one program.
const MISSION: Duration = Duration::from_secs(60);

/// Starts `c1` and `c2`, which see each other. It first gives a new node the time for its discovery, so that commands
/// get no delayed answer.
fn pair(here: &Host) -> [Program; 2] {
    let nodes = ["c1", "c2"].map(|name| here.node(name, &[]));
    let looked = Duration::from_secs(3);
    let see = || here.statuses(&[]).iter().filter(|node| node.peers.len() == 1 && node.up > looked).count() == 2;
    assert!(wait_until(SOON, see).is_some(), "{:?}", here.statuses(&[]));
    nodes
}

fn kill(node: Program) {
    node.signal(Signal::KILL);
    assert_eq!(node.ended(SOON).signal, Some(9));
}

/// From its death until it counts as lost, the node has a row. The row does not show it as well.
#[test]
fn a_node_that_was_killed_a_moment_ago_has_a_row() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let [_c1, c2] = pair(&here);
    kill(c2);
    let (began, mut states) = (now(), Vec::new());
    while now() - began < LOST_WITHIN {
        let listed = here.ask(&["nodes"]);
        let row = listed.out.lines().find(|line| line.starts_with("c2 "));
        let row = row.unwrap_or_else(|| panic!("{:?} after its end: {listed}", now() - began));
        let states_known = ["does not answer", "missing, heard", "lost, heard"];
        let state = states_known.into_iter().find(|state| row.contains(state)).unwrap_or_else(|| panic!("{listed}"));
        states.push(state);
        let json = here.ask(&["nodes", "--json"]);
        let json: serde_json::Value = serde_json::from_str(&json.out).unwrap_or_else(|why| panic!("{why}: {json}"));
        let missing = json["missing"].as_array().expect("it is a list");
        assert!(missing.iter().any(|one| one["host"] == "c2"), "{:?} after its end: {json}", now() - began);
    }
    states.dedup();
    println!("{states:?}");
    assert_eq!(states.last(), Some(&"lost, heard"));
}

/// A program that may run on an unreachable host gets no output from the record of an earlier run.
#[test]
fn another_runs_record_is_not_given_for_a_program_that_may_run() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let text = "
module Talker(host) { exec \"sh -c 'echo of the first run'\"; plain; }
process main() { host { c1 } instantiated_processes { talker instof Talker(c1); } internal_event_actions { talker } }
";
    let file = cluster.file("talk.dca", text);
    let ran = here.dca(&["run", &file, "--runs", "runs"]).ended(MISSION);
    assert_eq!(ran.code, Some(0), "{ran}");
    let logs = |arguments: &[&str]| here.ask(&[&["logs", "talker", "--runs", "runs"], arguments].concat());
    let none = logs(&[]);
    assert!(none.code == Some(0) && none.out == "of the first run\n", "no node runs: {none}");
    let [c1, c2] = pair(&here);
    let over = logs(&[]);
    assert!(over.code == Some(0) && over.out == "of the first run\n", "every node answers: {over}");
    kill(c2);
    let lost = || here.ask(&["nodes"]).out.lines().any(|line| line.starts_with("c2 ") && line.contains("lost"));
    assert!(wait_until(SOON, lost).is_some());
    let listed = here.ask(&["logs"]);
    assert!(
        listed.err.contains("`c2` is lost") && listed.err.contains("nothing runs on hosts that answer"),
        "{listed}"
    );
    let unknown = logs(&[]);
    assert!(unknown.code == Some(3) && unknown.out.is_empty(), "{unknown}");
    assert!(unknown.err.contains("`c2` does not answer") && unknown.err.contains("`--recorded`"), "{unknown}");
    let recorded = logs(&["--recorded"]);
    assert!(recorded.code == Some(0) && recorded.out == "of the first run\n", "{recorded}");
    assert!(recorded.err.contains("talk-1"), "it says which record: {recorded}");
    // The only node of this machine is suspended.
    c1.signal(Signal::STOP);
    let unknown = logs(&[]);
    c1.signal(Signal::CONT);
    assert!(unknown.code == Some(3) && unknown.out.is_empty(), "{unknown}");
    assert!(unknown.err.contains("does not answer") && unknown.err.contains("`--recorded`"), "{unknown}");
    let other = here.ask(&["logs", "walker", "--runs", "runs", "--recorded"]);
    assert!(other.code == Some(1) && other.err.contains("no record in `runs` has"), "{other}");
}

/// Only the home of a deployment knows all of its events, so answers from other nodes may be incomplete.
#[test]
fn events_are_not_complete_without_a_node() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let [_c1, c2] = pair(&here);
    let last = || {
        let told = here.ask(&["events", "--json"]);
        let line = told.out.lines().last().unwrap_or_default();
        let end: serde_json::Value = serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {told}"));
        (told.code, end["end"].as_str().map(str::to_owned), end["lost"].clone())
    };
    assert_eq!(last(), (Some(0), Some("complete".to_owned()), serde_json::json!([])));
    kill(c2);
    let began = now();
    while now() - began < LOST_WITHIN {
        assert_eq!(last(), (Some(3), Some("incomplete".to_owned()), serde_json::json!(["c2"])));
    }
}
