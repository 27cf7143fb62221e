//! Controllers in one process. No value is lost between them, the node sees one program, and a kill ends all of them.

use dca_tests::cluster::{Cluster, Host, Program, SOON, executable, pass, wait_until};
use rustix::process::Signal;
use serde_json::Value;
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

/// No spec contains the values between members, but they can still be watched: by name and type, and value by value.
/// This also holds for a group without ports, and the group loses nothing through watching.
#[test]
fn what_members_send_each_other_is_listed_and_echoed() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let [file, all] = ["sink", "all"].map(|name| cluster.folder().join(name).display().to_string());
    let instances = format!(
        "source instof Source(c1); twice instof Twice(c1); sink instof Sink(c1, \"{file}\");
        all instof Caterpillar(c1, \"{all}\");"
    );
    let wires = "source, Out -> twice, In queue 8000; twice, Out -> sink, In queue 8000;";
    let mission = deploy(&cluster, &here, &instances, wires, "source, twice, sink, all");

    let listed = here.ask(&["list", "twice"]);
    assert_eq!(listed.code, Some(0), "{listed}");
    let has = |cells: &[&str]| listed.out.lines().any(|line| line.split_whitespace().eq(cells.iter().copied()));
    assert!(has(&["count:main/twice", "first.Out", "->", "second.In", "wire", "Numbers"]), "{listed}");
    assert!(has(&["count:main/twice", "Out", "out", "Numbers"]), "{listed}");
    let listed = here.ask(&["list", "all", "--json"]);
    let rows: Value = serde_json::from_str(&listed.out).unwrap_or_else(|why| panic!("{why}: {listed}"));
    let rows = rows.as_array().unwrap();
    let wire =
        |from: &str, to: &str| rows.iter().any(|row| row["name"] == from && row["to"] == to && row["kind"] == "wire");
    assert!(rows.len() == 16 && wire("stage0.Out", "stage1.In") && wire("stage8.Out", "sink8.In"), "{listed}");

    for output in ["twice.first.Out", "all.stage3.Out"] {
        let echoed = here.ask(&["echo", output, "-n", "20", "--json"]);
        assert_eq!(echoed.code, Some(0), "{echoed}");
        let lines =
            echoed.out.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {line}")));
        let lines: Vec<Value> = lines.collect();
        let (end, values) = lines.split_last().unwrap();
        assert_eq!((values.len(), end["end"].as_str()), (20, Some("enough")), "{echoed}");
        let name = format!("main/{output}");
        assert!(values.iter().all(|value| value["output"] == *name && value["type"] == "Numbers"), "{echoed}");
        for pair in values.windows(2) {
            let [one, next] = pair else { continue };
            let (number, lost) = (next["number"].as_u64().unwrap(), next["lost"].as_u64().unwrap());
            assert_eq!(number, one["number"].as_u64().unwrap() + 1 + lost, "{echoed}");
        }
    }
    let unknown = here.ask(&["echo", "twice.third.Out"]);
    assert_eq!(unknown.code, Some(1), "{unknown}");
    assert!(unknown.err.contains("the outputs are `main/twice.Out`, `main/twice.first.Out`"), "{unknown}");

    let stop = here.ask(&["stop", "count"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert!(wait_until(SOON, || !mission.is_running()).is_some());
    let runs: Vec<_> = (1..=8).map(|number| cluster.counted(&format!("all{number}"))).collect();
    assert!(runs.iter().all(|runs| runs.len() == 1 && runs[0].0 == 1), "{runs:?}");
}

/// The exposed ports of a group are wires like others. A kill ends all members, and they come back together.
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
    cluster.expect_leaf("main/twice").signal(Signal::KILL);
    let is_back = || here.pids().get("main/twice").is_some_and(|pid| *pid != before["main/twice"]);
    assert!(wait_until(SOON, is_back).is_some());
    pass(WHILE);
    let stop = here.ask(&["stop", "count"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert!(wait_until(SOON, || !mission.is_running()).is_some());
    // Only the values sent during its absence are lost.
    let runs = cluster.counted("sink");
    assert!(runs.len() == 2 && runs[0].1 < runs[1].0, "{runs:?}");
}
