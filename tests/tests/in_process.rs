//! Controllers that share a process: nothing is lost between them, the node sees one program, and what kills it ends them all.

use dca_tests::cluster::{Cluster, Host, Program, SOON, executable, pass, wait_until};
use rustix::process::Signal;
use std::time::Duration;

/// How long a source counts, at 1 kHz.
const WHILE: Duration = Duration::from_secs(1);

/// Deploys a spec with these modules, instances, wires and actions.
fn deploy(cluster: &Cluster, here: &Host, instances: &str, wires: &str, actions: &str) -> Program {
    let program = executable("dca-counting").display().to_string();
    let text = format!(
        "module Source(host: Host) {{ exec \"'{program}' Source\"; out Out: Numbers; service; }}
        module Twice(host: Host) {{ exec \"'{program}' Twice\"; in In: Numbers; out Out: Numbers; service; }}
        module Sink(host: Host, file: Text) {{
            exec \"'{program}' Sink\"; in In: Numbers; in Other: Numbers optional; service;
        }}
        module Caterpillar(host: Host, file: Text) {{ exec \"'{program}' Caterpillar\"; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ {instances} }}
            internal_connections {{ {wires} }}
            internal_event_actions {{ {actions} }}
        }}"
    );
    here.mission(&cluster.file("count.dca", &text))
}

#[test]
fn a_source_eight_stages_and_eight_sinks_are_one_program_that_loses_nothing() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let file = cluster.folder().join("sink").display().to_string();
    let mission = deploy(&cluster, &here, &format!("all instof Caterpillar(c1, \"{file}\");"), "", "all");
    assert!(wait_until(SOON, || here.pids().len() == 1).is_some(), "{:?}", here.pids());
    pass(WHILE);
    let stop = here.ask(&["stop", "count"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert!(wait_until(SOON, || !mission.is_running()).is_some());
    let all: Vec<_> = (1..=8).map(|number| cluster.counted(&format!("sink{number}"))).collect();
    assert!(all.iter().all(|runs| runs.len() == 1 && runs[0].0 == 1 && *runs == all[0]), "{all:?}");
}

/// The ports that a group exposes are wires like others; a kill ends all members, and they come back together.
#[test]
fn a_group_is_wired_and_restarted_as_one_program() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let file = cluster.folder().join("sink").display().to_string();
    let instances = format!(
        "source instof Source(c1); twice instof Twice(c1) {{ restart permanent; }} sink instof Sink(c1, \"{file}\");"
    );
    let wires = "source, Out -> twice, In queue 8000; twice, Out -> sink, In queue 8000;";
    let mission = deploy(&cluster, &here, &instances, wires, "source, twice, sink");
    assert!(wait_until(SOON, || here.pids().len() == 3).is_some(), "{:?}", here.pids());
    pass(WHILE);
    let before = here.pids();
    cluster.leaf("main/twice").expect("it runs").signal(Signal::KILL);
    let is_back = || here.pids().get("main/twice").is_some_and(|pid| *pid != before["main/twice"]);
    assert!(wait_until(SOON, is_back).is_some());
    pass(WHILE);
    let stop = here.ask(&["stop", "count"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert!(wait_until(SOON, || !mission.is_running()).is_some());
    // What came while it was away is lost, and nothing else.
    let runs = cluster.counted("sink");
    assert!(runs.len() == 2 && runs[0].1 < runs[1].0, "{runs:?}");
}
