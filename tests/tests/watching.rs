//! The views of people who watch: `dca events` and `dca status --watch`, while programs run, end, and nodes die.

use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeMap;

/// Two programs that a file ends.
const TWO: &str = "
module Wait(host, file) { exec \"sh -c 'until test -e $0; do sleep 0.05; done'\"; plain; done; }
process main() {
    host { \"c1\" }
    instantiated_processes { first instof Wait(\"c1\", \"FOLDER/first\"); second instof Wait(\"c1\", \"FOLDER/second\"); }
    internal_event_actions { first ; second }
}
";

/// A cluster with a spec that runs until its files are there.
fn with_spec() -> (Cluster, Host, String) {
    let cluster = Cluster::new();
    let text = TWO.replace("FOLDER", &cluster.folder().display().to_string());
    let spec = cluster.file("two.dca", &text);
    let here = cluster.here();
    (cluster, here, spec)
}

fn objects(out: &str) -> Vec<Value> {
    out.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {line}"))).collect()
}

/// Returns what was told of one deployment: number, kind, process.
fn told(objects: &[Value]) -> Vec<(u64, String, Option<String>)> {
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let event = |one: &Value| Some((one["number"].as_u64()?, text(&one["kind"])?, text(&one["process"])));
    objects.iter().filter_map(event).collect()
}

/// Returns when each event of one deployment was, as it was told: by its number.
fn times(objects: &[Value]) -> BTreeMap<u64, String> {
    objects.iter().filter_map(|one| Some((one["number"].as_u64()?, one["time"].to_string()))).collect()
}

fn wait_for_events(events: &Program, wanted: &str) {
    events.wait_for(Stream::Out, wanted, SOON);
}

#[test]
fn events_are_told_as_they_come_and_again_afterwards() {
    let (cluster, here, spec) = with_spec();
    let node = here.node("c1", &[]);
    let following = here.dca(&["events", "-f", "--json"]);
    let lines = here.dca(&["events", "-f"]);
    let deploy = here.dca(&["deploy", "--no-record", &spec]);
    wait_for_events(&following, "\"process\":\"main/first\"");
    wait_for_events(&lines, "two@1  main/first  activated");
    cluster.file("first", "");
    wait_for_events(&lines, "two@1  main/first  done");
    cluster.file("second", "");
    assert_eq!(deploy.ended(SOON).code, Some(0));
    wait_for_events(&following, "\"kind\":\"finished\"");
    wait_for_events(&lines, "two@1  finished: done");
    for program in [&following, &lines] {
        program.signal(Signal::INT);
    }
    let (following, lines) = (following.ended(SOON), lines.ended(SOON));
    assert_eq!((following.code, lines.code), (Some(0), Some(0)), "{following}\n{lines}");
    let live = objects(&following.out);
    assert_eq!(live.last().unwrap()["end"], "interrupted");
    // Every event has its number, once, and place and time.
    let numbers: Vec<u64> = told(&live).iter().map(|(number, _, _)| *number).collect();
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    assert!(live.iter().filter(|one| one["kind"].is_string()).all(|one| one["host"] == "c1" && one["time"].is_f64()));
    // Afterwards the same is known, with an end.
    let known = here.ask(&["events", "--json", "two"]);
    assert_eq!(known.code, Some(0), "{known}");
    let known = objects(&known.out);
    assert_eq!(known.last().unwrap()["end"], "complete");
    assert_eq!(told(&known), told(&live));
    assert_eq!(times(&known), times(&live));
    // A node that ends as it is told to says that this was all.
    let following = here.dca(&["events", "-f", "--json"]);
    wait_for_events(&following, "\"kind\":\"finished\"");
    let nothing = here.ask(&["events", "--json", "other"]);
    assert_eq!((nothing.code, objects(&nothing.out).len()), (Some(0), 1), "{nothing}");
    node.signal(Signal::TERM);
    wait_for_events(&following, "{\"left\":\"c1\"");
}

/// The node is killed and started again while somebody listens: that is said, and nothing is told twice or left out.
#[test]
fn a_node_that_is_lost_is_told_and_heard_again() {
    let (cluster, here, spec) = with_spec();
    // The second keeps the command's connection, and has nothing to tell.
    let (_other, node) = (here.node("a0", &[]), here.node("c1", &[]));
    let _deploy = here.dca(&["deploy", "--no-record", &spec]);
    let following = here.dca(&["events", "-f", "--json"]);
    wait_for_events(&following, "\"kind\":\"activated\"");
    node.kill();
    wait_for_events(&following, "{\"lost\":\"c1\"");
    let _node = here.node("c1", &[]);
    wait_for_events(&following, "{\"back\":\"c1\"");
    cluster.file("first", "");
    cluster.file("second", "");
    wait_for_events(&following, "\"kind\":\"finished\"");
    following.signal(Signal::INT);
    let ended = following.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    let events = told(&objects(&ended.out));
    let numbers: Vec<u64> = events.iter().map(|(number, _, _)| *number).collect();
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    // What was told before the node was killed has the same time afterwards.
    // The node that is asked may not have found the other one again yet.
    let mut known = here.ask(&["events", "--json", "two"]);
    let is_found = wait_until(SOON, || {
        let is_found = known.code == Some(0) && !times(&objects(&known.out)).is_empty();
        if !is_found {
            known = here.ask(&["events", "--json", "two"]);
        }
        is_found
    });
    assert!(is_found.is_some(), "{known}");
    assert_eq!(times(&objects(&known.out)), times(&objects(&ended.out)), "{known}");
    let ends = |path: &str| events.iter().filter(|(_, kind, of)| kind == "done" && of.as_deref() == Some(path)).count();
    assert_eq!((ends("main/first"), ends("main/second"), ends("main")), (1, 1, 1), "{events:?}");
}

#[test]
fn a_status_is_watched_on_a_terminal_and_in_a_pipe() {
    let (cluster, here, spec) = with_spec();
    let _node = here.node("c1", &[]);
    let _deploy = here.dca(&["deploy", "--no-record", &spec]);
    let lines = here.dca(&["status", "--watch"]);
    lines.wait_for(Stream::Out, "c1  two@1  main/first  running  pid ", SOON);
    let json = here.dca(&["status", "--watch", "--json"]);
    json.wait_for(Stream::Out, "\"state\":\"running\"", SOON);
    // A row is drawn, Ctrl-C is pressed.
    let (code, screen) = here.on_terminal_until(80, "running", &["status", "--watch"]);
    assert_eq!(code, Some(0), "{screen:?}");
    assert!(screen.contains("two@1") && screen.contains("\x1b[J"), "{screen:?}");
    assert!(screen.split("\r\n").all(|line| line.replace("\x1b[K", "").chars().count() <= 100), "{screen:?}");
    cluster.file("first", "");
    lines.wait_for(Stream::Out, "main/second  running", SOON);
    cluster.file("second", "");
    lines.wait_for(Stream::Out, "c1  two@1  main  is over", SOON);
    for program in [lines, json] {
        program.signal(Signal::INT);
        let ended = program.ended(SOON);
        assert_eq!(ended.code, Some(0), "{ended}");
    }
}

#[test]
fn without_nodes_there_is_nothing_to_watch() {
    let cluster = Cluster::new();
    for arguments in [&["events"][..], &["events", "-f"], &["status", "--watch"], &["names"]] {
        let ended = cluster.here().ask(arguments);
        assert_eq!(ended.code, Some(3), "{ended}");
        assert!(ended.err.contains("no node runs on this machine"), "{ended}");
    }
}
