//! Programs are replaced while a source counts at 1 kHz through them. With `replace overlap`, no number is lost or
//! doubled.
//!
//! `DCA_TEST_ROUNDS=1000 cargo test --test all overlap:: -- --ignored` replaces a program 1,000 times.

#![expect(clippy::print_stdout, reason = "a test says how many numbers were lost")]

use comms::logic::random::Random;
use dca_tests::cluster::{
    Cluster, Ended, Host, Network, Process, Program, SOON, Stream, executable, pass, rounds, wait_until,
};
use std::collections::BTreeMap;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::time::Duration;

/// Writes a spec of a source, a program that passes its numbers on, and a sink.
fn spec(cluster: &Cluster, pass: &str, arguments: &str, policy: &str) -> String {
    let text = format!("through instof Pass({pass}{arguments}) {{ {policy} }}",);
    spec_with(cluster, &text, "source, Out -> through, In queue 8000; through, Out -> sink, In queue 8000;", "through")
}

/// Writes a spec of a source and a sink, with other instances, wires and event actions between them.
fn spec_with(cluster: &Cluster, between: &str, wires: &str, actions: &str) -> String {
    let program = executable("dca-counting").display().to_string();
    let file = cluster.folder().join("sink").display().to_string();
    let text = format!(
        "module Source(host: Host) {{ exec \"'{program}' Source\"; out Out: Numbers; service; }}
        module Pass(host: Host, fails_at: Number = 0) {{
            exec \"'{program}' Pass\"; in In: Numbers; out Out: Numbers; service;
        }}
        module Sink(host: Host, file: Text) {{ exec \"'{program}' Sink\"; in In: Numbers; in Other: Numbers optional; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{
                source instof Source(c1);
                {between}
                sink instof Sink(c1, file = \"{file}\");
            }}
            internal_connections {{ {wires} }}
            internal_event_actions {{ source, {actions}, sink }}
        }}"
    );
    cluster.file("count.dca", &text)
}

/// Returns the program of each process. Once a change is over, each process has one.
fn pids(here: &Host) -> BTreeMap<String, u32> {
    assert!(wait_until(SOON, || here.pids().len() == 3).is_some());
    here.pids()
}

/// Stops the mission. Returns the runs of numbers in the sink.
fn end(cluster: &Cluster, here: &Host, mission: &Program) -> Vec<(u64, u64)> {
    end_with(cluster, here, mission, &[])
}

/// Does the same as [`end`], with additional options.
fn end_with(cluster: &Cluster, here: &Host, mission: &Program, options: &[&str]) -> Vec<(u64, u64)> {
    let stop = here.ask(&[&["stop", "count"], options].concat());
    assert_eq!(stop.code, Some(0), "{stop}");
    assert!(wait_until(SOON, || !mission.is_running()).is_some());
    cluster.counted("sink")
}

fn replace(here: &Host) -> Ended {
    here.ask(&["replace", "count", "through", "--probation", "0.3"])
}

/// Replaces a program repeatedly, and once by a changed spec. Every number arrives.
fn overlaps(cluster: &Cluster, here: &Host, (host, what): (&str, &str), times: u32) {
    let mission = here.mission(&spec(cluster, host, "", "replace overlap;"));
    let mut before = pids(here);
    for round in 0..times {
        let replaced = replace(here);
        assert_eq!(replaced.code, Some(0), "round {round}: {replaced}");
        let now = pids(here);
        assert!(now["main/through"] != before["main/through"], "{now:?}");
        assert!(now["main/source"] == before["main/source"] && now["main/sink"] == before["main/sink"], "{now:?}");
        before = now;
    }
    let changed =
        here.ask(&["deploy", "--probation", "0.3", &spec(cluster, host, ", fails_at = 1000000", "replace overlap;")]);
    let told = "replace    main/through: `fails_at` is 1000000, was 0; the two overlap";
    assert!(changed.code == Some(0) && changed.err.contains(told), "{changed}");
    assert!(pids(here)["main/through"] != before["main/through"]);
    let runs = end(cluster, here, &mission);
    assert_eq!(runs.len(), 1, "{what}: numbers were lost or doubled: {runs:?}");
    println!("{what}: {} replacements, {} numbers, none lost", times + 1, runs[0].1 - runs[0].0 + 1);
}

#[test]
fn nothing_is_lost_on_one_host() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    overlaps(&cluster, &here, ("c1", "on one host"), 2);
}

#[test]
#[ignore = "long: many replacements"]
fn nothing_is_lost_over_many_replacements() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    overlaps(&cluster, &here, ("c1", "on one host"), rounds(20));
}

#[test]
fn nothing_is_lost_between_two_hosts() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (here, there) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let _nodes = [here.node("c1", &["--insecure-lan"]), there.node("c2", &["--insecure-lan"])];
    overlaps(&cluster, &here, ("c2", "between two hosts"), 2);
}

/// A version fails after a while, and returns its connections to the previous program, which still runs.
#[test]
fn a_bad_version_is_taken_back_and_the_mission_goes_on() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.mission(&spec(&cluster, "c1", "", "replace overlap;"));
    let before = pids(&here);
    let bad = here.ask(&["deploy", &spec(&cluster, "c1", ", fails_at = 300", "replace overlap;")]);
    let why = "`count@1` is not changed: the new program of `main/through` was not healthy: it was to fail";
    assert!(bad.code == Some(1) && bad.err.contains(why), "{bad}");
    assert_eq!(pids(&here), before, "the program of before was never ended");
    // A version that cannot even begin takes over nothing.
    let worse = here.ask(&["deploy", &spec(&cluster, "c1", ", fails_at = -1", "replace overlap;")]);
    assert_eq!(worse.code, Some(1), "{worse}");
    assert_eq!(pids(&here), before);
    let good = replace(&here);
    assert_eq!(good.code, Some(0), "{good}");
    assert!(mission.is_running());
    let runs = end(&cluster, &here, &mission);
    // Only numbers that the bad version had received and not yet passed on are lost.
    assert!(runs.len() <= 2 && runs.windows(2).all(|pair| pair[0].1 < pair[1].0), "{runs:?}");
    let lost: u64 = runs.windows(2).map(|pair| pair[1].0 - pair[0].1 - 1).sum();
    println!("a bad version: {lost} numbers lost until the one before was back");
}

/// The node is killed at any moment of a replacement. Exactly one of the two programs stays with its connections, and
/// the mission continues.
#[test]
fn a_node_that_is_killed_while_programs_overlap_leaves_one_of_them() {
    kill_while_they_overlap(2);
}

#[test]
#[ignore = "long: many kills"]
fn a_node_that_is_killed_again_and_again_while_programs_overlap_leaves_one_of_them() {
    // A node that was killed more often within a minute takes on no more changes.
    kill_while_they_overlap(rounds(5));
}

fn kill_while_they_overlap(times: u32) {
    let cluster = Cluster::new();
    let here = cluster.here();
    let mut node = here.node("c1", &[]);
    let mission = here.mission(&spec(&cluster, "c1", "", "replace overlap;"));
    pids(&here);
    let mut random = Random::new(7);
    let is_pass = |process: &Process| process.command[0].ends_with("dca-counting") && process.command[1] == "Pass";
    let programs = || cluster.left().into_iter().filter(is_pass);
    for round in 0..times {
        let change = here.dca(&["replace", "count", "through", "--probation", "0.3"]);
        let at = Duration::from_millis(random.below(600));
        pass(at);
        node.kill();
        node = here.node("c1", &[]);
        let told = change.ended(2 * SOON);
        assert!(matches!(told.code, Some(0 | 1 | 3)), "round {round}, killed after {at:?}: {told}");
        let is_one = || here.pids().len() == 3 && programs().count() == 1;
        let left = || (here.pids(), programs().collect::<Vec<_>>());
        assert!(wait_until(SOON, is_one).is_some(), "round {round}, killed after {at:?}: {:?}; {told}", left());
        assert!(mission.is_running(), "round {round}: {}", mission.text(Stream::Err));
        println!("killed after {at:?}: exit code {:?}, {}", told.code, told.err.trim());
    }
    // The pending change continues under the next node. Until it is over, other changes are refused.
    let mut last = replace(&here);
    let is_over = wait_until(2 * SOON, || {
        let is_over = !last.err.contains("is changing `count` at this moment");
        if !is_over {
            last = replace(&here);
        }
        is_over
    });
    assert!(is_over.is_some() && last.code == Some(0), "{last}");
    pass(Duration::from_secs(1));
    let runs = end(&cluster, &here, &mission);
    assert!(runs.windows(2).all(|pair| pair[0].1 < pair[1].0), "numbers are doubled: {runs:?}");
    assert!(runs.last().is_some_and(|(from, to)| to - from > 500), "nothing came after the last change: {runs:?}");
    let lost: u64 = runs.windows(2).map(|pair| pair[1].0 - pair[0].1 - 1).sum();
    println!("{lost} numbers lost of {}", runs.last().map_or(0, |last| last.1));
}

/// Without overlap there is a gap: the time of one program's stop and of the other's start.
#[test]
fn without_overlap_there_is_a_gap() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.mission(&spec(&cluster, "c1", "", "replace break_before_make;"));
    let events = here.dca(&["events", "-f", "--json"]);
    let before = pids(&here);
    let replaced = replace(&here);
    assert_eq!(replaced.code, Some(0), "{replaced}");
    assert!(pids(&here)["main/through"] != before["main/through"]);
    let runs = end(&cluster, &here, &mission);
    let events = events.text(Stream::Out);
    let at = |change: &str| {
        let objects = events.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
        let found = objects.filter_map(|object| object.pointer("/report/Process").cloned());
        let mut found = found.filter(|one| one["path"] == "main/through" && one["change"] == change);
        found.next().and_then(|one| one["at"].as_f64())
    };
    let away = at("Replacing").zip(at("Resumed")).map(|(from, to)| (to - from) * 1000.0);
    assert!(runs.len() == 2 && runs[0].1 < runs[1].0, "{runs:?}");
    let lost = runs[1].0 - runs[0].1 - 1;
    println!(
        "break before make: {lost} numbers lost at 1 kHz; from the stop of the one to the start of the other {away:.1?} ms"
    );
}

/// Writes a spec in which numbers pass through two programs on two hosts.
fn chain(cluster: &Cluster, [first, second]: [&str; 2]) -> String {
    let between = format!(
        "through instof Pass(c2{first}) {{ replace overlap; }} second instof Pass(c1{second}) {{ replace overlap; }}"
    );
    let wires = "source, Out -> through, In queue 8000; through, Out -> second, In queue 8000; \
                 second, Out -> sink, In queue 8000;";
    spec_with(cluster, &between, wires, "through, second")
}

/// One host changes first, and then the other one. Each program overlaps with the next. If the second host cannot
/// follow, the first change is also taken back with an overlap. Every number arrives.
#[test]
fn a_canary_overlaps_and_so_does_its_way_back() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = [here.node("c1", &[]), here.node("c2", &[])];
    let mission = here.mission(&chain(&cluster, ["", ""]));
    let pids = || {
        assert!(wait_until(SOON, || here.pids().len() == 4).is_some(), "{:?}", here.pids());
        here.pids()
    };
    let deploy = |file: &str| here.ask(&["deploy", "--probation", "0.3", "--canary", "c2", file]);
    let before = pids();
    let others = |before: &BTreeMap<String, u32>| {
        let now = pids();
        now.into_iter().filter(|(path, pid)| before[path] != *pid).map(|(path, _)| path).collect::<Vec<_>>()
    };
    let good = deploy(&chain(&cluster, [", fails_at = 1000001", ", fails_at = 1000002"]));
    assert!(good.code == Some(0) && good.out.contains("revision 2"), "{good}");
    assert_eq!(others(&before), ["main/second", "main/through"]);
    let before = pids();
    // The next program of the other host cannot begin, so it takes over nothing.
    let bad = deploy(&chain(&cluster, [", fails_at = 1000003", ", fails_at = -1"]));
    assert!(bad.code == Some(1) && bad.err.contains("so the change of the host `c2` is taken back"), "{bad}");
    assert_eq!(others(&before), ["main/through"], "it was changed, and changed back");
    let plan = here.ask(&["plan", &chain(&cluster, [", fails_at = 1000001", ", fails_at = 1000002"])]);
    assert!(plan.code == Some(0) && plan.out.contains("revision 4:\n  keep       4 programs"), "{plan}");
    let runs = end(&cluster, &here, &mission);
    assert_eq!(runs.len(), 1, "numbers were lost or doubled: {runs:?}");
    println!("a canary there, and there and back: {} numbers, none lost", runs[0].1 - runs[0].0 + 1);
}

/// Makes a team of the nodes on two hosts, and starts the nodes. Returns the options with the keys.
fn team(cluster: &Cluster, desk: &Host, hosts: [&Host; 2]) -> (Vec<String>, [Program; 2]) {
    let passphrase = cluster.file("passphrase", "correct horse battery\n");
    fs::set_permissions(&passphrase, Permissions::from_mode(0o600)).expect("a file of ours");
    let keys = cluster.folder().join("keys").display().to_string();
    let keys = ["--keys".to_owned(), keys, "--passphrase".to_owned(), passphrase].to_vec();
    let with = |arguments: &[&str]| {
        let all: Vec<&str> = arguments.iter().copied().chain(keys.iter().map(String::as_str)).collect();
        desk.dca(&all)
    };
    assert_eq!(with(&["team", "init", "acme"]).ended(SOON).code, Some(0));
    for (host, name) in hosts.into_iter().zip(["c1", "c2"]) {
        let invitation = with(&["team", "invite", name]);
        invitation.wait_for(Stream::Out, "\n", SOON);
        let said = invitation.text(Stream::Out);
        let line = said.trim().strip_prefix("dca team join ").expect("it prints what to type");
        let state = host.state().display().to_string();
        assert_eq!(host.ask(&["team", "join", line, "--state", &state]).code, Some(0));
        assert_eq!(invitation.ended(SOON).code, Some(0));
    }
    (keys, [hosts[0].node("c1", &[]), hosts[1].node("c2", &[])])
}

/// In a team, wires are sealed between hosts and within a host. The next program has different keys, and still nothing
/// is lost.
#[test]
fn nothing_is_lost_in_a_team() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (here, there) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let (keys, _nodes) = team(&cluster, &here, [&here, &there]);
    let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
    let found = || here.ask(&["nodes"]).out.lines().any(|line| line.starts_with("c2"));
    assert!(wait_until(SOON, found).is_some(), "{}", here.ask(&["nodes"]));
    let file = chain(&cluster, ["", ""]);
    let mission = here.dca(&[&["deploy", "--no-record", &file], &keys[..]].concat());
    mission.wait_for(Stream::Err, "▸", SOON);
    assert!(wait_until(SOON, || here.pids().len() == 4).is_some(), "{:?}", here.pids());
    let mut before = here.pids();
    for round in 0..rounds(1) {
        let both = ["replace", "count", "through", "second", "--probation", "0.3"];
        let replaced = here.ask(&[&both, &keys[..]].concat());
        assert_eq!(replaced.code, Some(0), "round {round}: {replaced}");
        assert!(wait_until(SOON, || here.pids().len() == 4).is_some(), "{:?}", here.pids());
        let now = here.pids();
        let is_next = |path: &str| now[path] != before[path];
        assert_eq!(now.keys().filter(|path| is_next(path)).collect::<Vec<_>>(), ["main/second", "main/through"]);
        before = now;
    }
    let runs = end_with(&cluster, &here, &mission, &keys);
    assert_eq!(runs.len(), 1, "numbers were lost or doubled: {runs:?}");
    println!("in a team: {} replacements, {} numbers, none lost", 2 * rounds(1), runs[0].1 - runs[0].0 + 1);
}
