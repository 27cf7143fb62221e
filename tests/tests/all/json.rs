//! The form of every answer with `--json`: one value on each line, and nothing else on standard output.

use dca_tests::cluster::{Cluster, Ended, SOON, Stream};
use serde_json::Value;
use std::fs;

const SLEEP: &str = "
module Sleep(host) { exec \"sleep 600\"; plain; done; }
process main() { host { c1 } instantiated_processes { p instof Sleep(c1); } internal_event_actions { p } }
";

/// Checks the form of an answer, and returns the values in it.
fn values(ended: &Ended) -> Vec<Value> {
    let read = |line: &str| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {line}\n{ended}"));
    let values: Vec<Value> = ended.out.lines().map(read).collect();
    assert!(!values.is_empty(), "nothing is answered: {ended}");
    values
}

#[test]
fn an_answer_about_files_is_one_value_a_line() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let corpus = |file: &str| format!("{}/../verify/tests/corpus/{file}.dca", env!("CARGO_MANIFEST_DIR"));
    let (good, bad) = (corpus("good/tidy_up"), corpus("bad/lock_cycle"));
    let tests = cluster.folder().join("tests").display().to_string();
    here.ask(&["verify", &bad, "--test", &tests]);
    let copy = cluster.file("copy.dca", &fs::read_to_string(&good).expect("the corpus is there"));
    let types =
        cluster.file("types.dca", "type R = { a: Length };\nprocess main() { internal_event_actions { wait(1 s) } }");
    for (arguments, code) in [
        (&["check", &good][..], 0),
        (&["check", "--format", "sarif", &good], 0),
        (&["verify", &good], 0),
        (&["verify", &bad], 1),
        (&["fmea", &good], 0),
        (&["fix", &copy], 0),
        (&["fmt", &copy], 0),
        (&["fmt", "--check", &copy], 0),
        (&["graph", &good], 0),
        (&["types", "--python", &types], 0),
        (&["explain"], 0),
        (&["explain", "E0201"], 0),
    ] {
        let ended = here.ask(&[arguments, &["--json"]].concat());
        assert!(ended.code == Some(code) && values(&ended).len() == 1, "{arguments:?}: {ended}");
    }
    let tested = here.ask(&["test", &tests, "--json"]);
    let told = values(&tested);
    assert!(told[0]["outcome"] == "failed" && told.last().is_some_and(|end| end["end"] == "complete"), "{tested}");
}

#[test]
fn an_answer_about_a_mission_is_one_value_a_line() {
    let cluster = Cluster::new();
    let (here, _node) = (cluster.here(), cluster.here().node("c1", &[]));
    let file = cluster.file("sleep.dca", SLEEP);
    let deploy = here.dca(&["deploy", "--no-record", &file]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    for arguments in [
        &["status"][..],
        &["nodes"],
        &["names"],
        &["clock"],
        &["logs"],
        &["list"],
        &["queue"],
        &["router"],
        &["lock"],
        &["plan", &file],
        &["param", "list"],
        &["replace", "sleep", "p", "--probation", "0"],
        &["doctor"],
        &["stop", "sleep"],
        &["estop"],
        &["estop", "--release"],
    ] {
        let ended = here.ask(&[arguments, &["--json"]].concat());
        assert!(values(&ended).len() == 1, "{arguments:?}: {ended}");
    }
    let events = here.ask(&["events", "--json"]);
    assert!(values(&events).last().is_some_and(|end| end["end"] == "complete"), "{events}");
}
