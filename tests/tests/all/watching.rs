//! The watching commands, `dca events` and `dca status --watch`, while programs run and end, and while nodes die.

use dca_tests::cluster::{Cluster, Ended, Host, Program, SOON, Stream, rounds, wait_until};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::collections::BTreeMap;

/// Two programs. A file ends each of them.
const TWO: &str = "
module Wait(host, file) { exec \"sh -c 'until test -e ${0#file=}; do sleep 0.05; done'\"; plain; done; }
process main() {
    host { \"c1\" }
    instantiated_processes { first instof Wait(\"c1\", \"FOLDER/first\"); second instof Wait(\"c1\", \"FOLDER/second\"); }
    internal_event_actions { first ; second }
}
";

/// Makes a cluster with a spec that runs until its files exist.
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

/// Returns the number, kind and process of each event of one deployment.
fn told(objects: &[Value]) -> Vec<(u64, String, Option<String>)> {
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let event = |one: &Value| Some((one["number"].as_u64()?, text(&one["kind"])?, text(&one["process"])));
    objects.iter().filter_map(event).collect()
}

/// Returns the time of each event in one deployment, by its number.
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
    // Every number occurs once, and every event has a place and a time.
    let numbers: Vec<u64> = told(&live).iter().map(|(number, _, _)| *number).collect();
    assert!(numbers.is_sorted_by(|a, b| a < b), "{numbers:?}");
    assert!(live.iter().filter(|one| one["kind"].is_string()).all(|one| one["host"] == "c1" && one["time"].is_f64()));
    // Afterwards, the same events are known, with an end.
    let known = here.ask(&["events", "--json", "two"]);
    assert_eq!(known.code, Some(0), "{known}");
    let known = objects(&known.out);
    assert_eq!(known.last().unwrap()["end"], "complete");
    assert_eq!(told(&known), told(&live));
    assert_eq!(times(&known), times(&live));
    // A node that ends on request says that its stream is complete.
    let following = here.dca(&["events", "-f", "--json"]);
    wait_for_events(&following, "\"kind\":\"finished\"");
    let nothing = here.ask(&["events", "--json", "other"]);
    assert_eq!((nothing.code, objects(&nothing.out).len()), (Some(2), 0), "{nothing}");
    node.signal(Signal::TERM);
    wait_for_events(&following, "{\"left\":\"c1\"");
}

/// The node is killed and restarted during a watch. This is reported, and no event is repeated or left out.
#[test]
fn a_node_that_is_lost_is_told_and_heard_again() {
    let (cluster, here, spec) = with_spec();
    // The second node keeps the command's connection, but has no events.
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
    // Events from before the kill keep their times. The asked node may not have found the other node again yet, and
    // then it says so.
    let live = times(&objects(&ended.out));
    let is_whole = wait_until(SOON, || {
        let known = here.ask(&["events", "--json", "two"]);
        let is_whole = says_all(&known, "c1");
        assert!(!is_whole || times(&objects(&known.out)) == live, "{known}\n{ended}");
        is_whole
    });
    assert!(is_whole.is_some());
    let ends = |path: &str| events.iter().filter(|(_, kind, of)| kind == "done" && of.as_deref() == Some(path)).count();
    assert_eq!((ends("main/first"), ends("main/second"), ends("main")), (1, 1, 1), "{events:?}");
}

/// Returns whether an answer from `dca events` says that it is complete. An incomplete answer names the missing host.
fn says_all(known: &Ended, missing: &str) -> bool {
    let objects = objects(&known.out);
    let Some(end) = objects.last() else { return false };
    if known.code == Some(0) {
        assert_eq!(end["end"], "complete", "{known}");
        return true;
    }
    assert_eq!((known.code, end["end"].as_str()), (Some(3), Some("incomplete")), "{known}");
    assert!(end["lost"].as_array().is_some_and(|lost| lost.iter().any(|host| host == missing)), "{known}");
    false
}

/// A node is killed and restarted during continuous questions to other nodes. A complete answer has every earlier
/// event, and an incomplete one names the missing host. The same holds for a status.
#[test]
fn what_is_complete_has_heard_every_host_that_is_known() {
    let (_cluster, here, spec) = with_spec();
    let (_other, mut node) = (here.node("a0", &[]), here.node("c1", &[]));
    let following = here.dca(&["events", "-f", "--json"]);
    let _deploy = here.dca(&["deploy", "--no-record", &spec]);
    wait_for_events(&following, "\"kind\":\"activated\"");
    let before = told(&objects(&here.ask(&["events", "--json", "two"]).out));
    assert!(!before.is_empty());
    for round in 0..rounds(4) {
        node.kill();
        let starting = here.start_node("c1", &[]);
        let (mut answers, mut is_whole) = (0, false);
        let ready = wait_until(SOON, || {
            let [known, status] = [&["events", "--json", "two"][..], &["status", "two"]].map(|asked| here.ask(asked));
            answers += 1;
            is_whole = says_all(&known, "c1");
            let told = told(&objects(&known.out));
            assert!(!is_whole || told.starts_with(&before), "round {round}, answer {answers}: {known}");
            // It is unknown whether it runs while the only host that may have it does not answer.
            let is_unknown =
                status.code == Some(3) && status.err.contains("`c1` does not answer, and it may run there");
            assert!(status.code == Some(0) || is_unknown, "{status}");
            let is_shown = status.out.contains("main/first") || status.out.contains("first: Wait");
            assert!(is_shown || status.err.contains("`c1`"), "round {round}, answer {answers}: {status}");
            is_whole && is_shown
        });
        assert!(ready.is_some(), "round {round}");
        starting.wait_for(Stream::Out, "node `c1` is ready", SOON);
        println!("round {round}: whole after {answers} answers");
        node = starting;
    }
}

/// Programs of the home and of another host die while the home's node is away. An answer that says that it is complete
/// contains these events.
#[test]
fn a_home_that_is_back_tells_what_has_happened_meanwhile() {
    let cluster = Cluster::new();
    let text = "
module Sleep(host) { exec \"sleep 600\"; plain; done; }
process main() {
    host { \"c1\" }
    instantiated_processes {
        near instof Sleep(\"c1\") { restart transient; }
        far instof Sleep(\"c2\") { restart transient; on_link_loss keep; }
    }
    internal_event_actions { near , far }
}
";
    let (here, spec) = (cluster.here(), cluster.file("two.dca", text));
    let (mut node, _other) = (here.node("c1", &[]), here.node("c2", &[]));
    let _deploy = here.dca(&["deploy", "--no-record", &spec]);
    let restarts = |known: &Ended| {
        let told = told(&objects(&known.out));
        ["main/near", "main/far"]
            .map(|path| told.iter().filter(|(_, kind, of)| kind == "restarting" && of.as_deref() == Some(path)).count())
    };
    for round in 0..rounds(3) {
        let both_run = wait_until(SOON, || here.pids().len() == 2);
        assert!(both_run.is_some(), "round {round}");
        let pids: Vec<u32> = here.pids().into_values().collect();
        node.kill();
        for pid in pids.into_iter().filter_map(|pid| Pid::from_raw(i32::try_from(pid).ok()?)) {
            kill_process(pid, Signal::SEGV).expect("it runs");
        }
        let starting = here.start_node("c1", &[]);
        let mut answers = 0;
        let whole = wait_until(SOON, || {
            let known = here.ask(&["events", "--json", "two"]);
            answers += 1;
            // The first asked node may not know of the other one yet, or may not have received everything.
            let is_whole = known.code == Some(0);
            assert!(!is_whole || restarts(&known) == [round + 1; 2], "round {round}, answer {answers}: {known}");
            is_whole
        });
        assert!(whole.is_some(), "round {round}");
        starting.wait_for(Stream::Out, "node `c1` is ready", SOON);
        println!("round {round}: whole after {answers} answers");
        node = starting;
    }
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
    // Once a row is drawn, Ctrl-C is pressed.
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
