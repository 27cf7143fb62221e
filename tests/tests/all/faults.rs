//! Cases from the table in `docs/src/faults.md` that no other test file has: files run out, links flap, two nodes
//! claim one name.

use dca_tests::cluster::{
    Cluster, Freezer, Hosts, Network, Program, SOON, Stream, descriptors, executable, memory, rounds, wait_until,
};
use node::logic::nameserver::LOST_AFTER;
use rustix::fs::{CWD, FileType, mknodat};
use rustix::process::Signal;
use std::process::{Command, Stdio};
use std::time::Duration;

/// The limit of open files of the node that runs out of files. Only few programs fit.
const FILES: u32 = 160;
/// More programs than fit into this limit.
const CROWD: usize = 200;
/// How long a flapping link is up, and how long it is down.
const FLAP: Duration = Duration::from_millis(200);
/// The number of cuts after which a message has to arrive.
const HEARD_EVERY: usize = 2;
/// The largest growth of a node while a link flaps, in bytes.
const GROWTH_MAX: u64 = 20 << 20;
/// The longest time until a node has its links again.
const SETTLE: Duration = Duration::from_secs(20);

/// Returns a spec of waiting programs.
fn crowd(host: &str, count: usize) -> String {
    let leaves: Vec<String> = (1..=count).map(|leaf| format!("idle{leaf}")).collect();
    let declared: String = leaves.iter().map(|leaf| format!("{leaf} instof Idle(\"{host}\"); ")).collect();
    format!(
        "module Idle(host) {{ exec \"sleep 3600\"; plain; done; }}\nprocess main() {{\n  host {{ \"{host}\" }}\n  \
         instantiated_processes {{ {declared}}}\n  internal_event_actions {{ {} }}\n}}",
        leaves.join(" , ")
    )
}

/// A node without free file descriptors refuses further deployments with a message, and continues. Running
/// deployments can be stopped.
#[test]
fn a_node_without_free_files_refuses_and_goes_on() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let limited = format!("ulimit -n {FILES}; exec \"$@\"");
    let mut command = Command::new("sh");
    command.args(["-c", &limited, "sh"]).arg(executable("dca-node")).args(["--name", "c1", "--run-dir"]);
    command.arg(here.run_dir()).arg("--state").arg(here.state()).current_dir(cluster.folder());
    // The shell becomes the node, and the cluster ends it.
    let mut node = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("there is a shell");
    let is_ready = || here.ask(&["nodes"]).code == Some(0);
    wait_until(SOON, is_ready).expect("the node starts");
    let few = here.dca(&["deploy", "--no-record", &cluster.file("few.dca", &crowd("c1", 2))]);
    few.wait_for(Stream::Err, "2 programs on 1 host, started in", SOON);
    let many = here.dca(&["deploy", "--no-record", &cluster.file("many.dca", &crowd("c1", CROWD))]).ended(2 * SOON);
    assert_eq!(many.code, Some(1), "{many}");
    assert!(many.out.contains("many: refused") && many.out.contains("oo many open files"), "{many}");
    // Running programs continue, and can be stopped. This frees descriptors again.
    assert_eq!(here.pids().len(), 2);
    let stop = here.ask(&["stop", "few"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    drop(few.ended(SOON));
    let again = here.dca(&["deploy", "--no-record", &cluster.file("few.dca", &crowd("c1", 2))]);
    again.wait_for(Stream::Err, "2 programs on 1 host, started in", SOON);
    assert_eq!(here.ask(&["stop", "few"]).code, Some(0));
    node.kill().expect("it has not been waited for");
    node.wait().expect("it was started here");
}

/// A program is in an uninterruptible sleep, as with a dead disk. `dca stop` says that it could not be stopped, and
/// no program with its name is started beside it. When it ends at last, its end is reported.
#[test]
fn what_cannot_be_killed_is_told_and_not_started_again() {
    let Some(freezer) = Freezer::new() else { return };
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("c1", &[]);
    let text = crowd("c1", 1).replace("idle1 instof Idle(\"c1\");", "idle1 instof Idle(\"c1\") { restart permanent; }");
    let file = cluster.file("stuck.dca", &text);
    let mission = here.dca(&["deploy", "--no-record", &file]);
    mission.wait_for(Stream::Err, "1 program on 1 host", SOON);
    wait_until(SOON, || here.pids().len() == 1).expect("it runs");
    freezer.freeze(here.pids()["main/idle1"]);
    let stop = here.dca(&["stop", "stuck"]).ended(2 * SOON);
    assert!(stop.code == Some(3) && stop.err.contains("has not confirmed that nothing of it is left"), "{stop}");
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.contains("its stop could not be confirmed"), "{ended}");
    let again = here.ask(&["deploy", "--no-record", &file]);
    assert!(again.code == Some(1) && again.out.contains("could not be ended and may still run"), "{again}");
    let status = here.ask(&["status"]);
    assert!(status.out.contains("stuck@1  unconfirmed on  c1 (it could not end all its programs)"), "{status}");
    drop(freezer);
    wait_until(SOON, || here.ask(&["status"]).out.starts_with("nothing is deployed")).expect("it has ended after all");
    let again = here.dca(&["deploy", "--no-record", &file]);
    again.wait_for(Stream::Err, "1 program on 1 host", SOON);
    node.signal(Signal::TERM);
    assert_eq!(again.ended(SOON).code, Some(1));
    cluster.expect_nothing_left(SOON);
}

/// The same happens while its mission continues. A program that wants its resources waits, and people are told why
/// and what to do. The waiting program continues once the other has ended.
#[test]
fn what_cannot_be_killed_keeps_what_it_has_taken() {
    let Some(freezer) = Freezer::new() else { return };
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("c1", &[]);
    let text = "module Idle(host) { exec \"sleep 3600\"; plain; done; }
process main() {
    host { \"c1\" }
    resource zone;
    instantiated_processes { a instof Idle(\"c1\"); c instof Idle(\"c1\"); }
    internal_event_actions { (using(zone) (a within 3 s))? , (wait(1 s) ; using(zone) c) }
}";
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("zone.dca", text)]);
    mission.wait_for(Stream::Err, "2 programs on 1 host", SOON);
    wait_until(SOON, || here.pids().contains_key("main/a")).expect("it runs");
    let frozen = here.pids()["main/a"];
    freezer.freeze(frozen);
    let waits = "the stop of `main/a` on `c1` could not be confirmed, and `main/a` may still use this";
    let is_told = || here.ask(&["status"]).out.contains(waits);
    wait_until(2 * SOON, is_told).unwrap_or_else(|| panic!("{}", here.ask(&["status"])));
    let status = here.ask(&["status"]);
    assert!(
        status.out.contains(&format!("end process {frozen} there, and then the resources of the process are free")),
        "{status}"
    );
    let events = here.ask(&["events"]);
    assert!(events.out.contains(waits) && !here.pids().contains_key("main/c"), "{events}");
    drop(freezer);
    wait_until(SOON, || here.pids().contains_key("main/c")).expect("the zone is free");
    assert_eq!(here.ask(&["stop", "zone"]).code, Some(0));
    drop(mission.ended(SOON));
    node.signal(Signal::TERM);
    cluster.expect_nothing_left(SOON);
}

/// A node starts at once whatever its folders contain, and reports any damage.
#[test]
fn pipes_and_damage_in_its_folders_do_not_keep_a_node_from_starting() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let first = here.node("c1", &[]);
    let text = crowd("c1", 1);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("few.dca", &text)]);
    mission.wait_for(Stream::Err, "1 program on 1 host", SOON);
    assert_eq!(here.ask(&["stop", "few"]).code, Some(0));
    drop(mission.ended(SOON));
    first.signal(Signal::TERM);
    drop(first.ended(SOON));
    let (run, state) = (here.run_dir().join("c1"), here.state().join("c1"));
    std::fs::create_dir_all(run.join("few.1/0")).expect("it is the test's own");
    let pipes =
        ["inputs", "inputs.new", "lock", "proof", "team", "few.1/0/processes", "few.1/0/exit", "few.1/0/out.log"];
    let paths = pipes.iter().map(|pipe| run.join(pipe)).chain([state.join("journal"), state.join("journal.new")]);
    for path in paths {
        drop(std::fs::remove_file(&path));
        mknodat(CWD, &path, FileType::Fifo, 0o600.into(), 0).unwrap_or_else(|error| panic!("{path:?}: {error}"));
    }
    std::fs::remove_file(run.join("lock")).expect("a lock that is a pipe is refused, with words: see below");
    let second = here.node("c1", &[]);
    second.wait_for(Stream::Err, "the journal is damaged and was put aside", SOON);
    let again = here.dca(&["deploy", "--no-record", &cluster.file("few.dca", &text)]);
    again.wait_for(Stream::Err, "1 program on 1 host", SOON);
    let status = here.ask(&["status"]);
    assert!(!status.out.contains("few@1 ") && !status.out.contains("few@2 "), "no epoch is given twice: {status}");
    // An overwritten record also ends nothing, since the program's shim still runs.
    wait_until(SOON, || here.pids().len() == 1).expect("it runs");
    let before = here.pids();
    second.kill();
    drop(second.ended(SOON));
    let folder = std::fs::read_dir(&run).expect("it is the test's own").flatten().map(|entry| entry.path());
    let folder = folder.filter(|path| path.join("0/processes").is_file()).last().expect("the program has a record");
    std::fs::write(folder.join("0/processes"), [0xff, 0, b'x']).expect("it is the test's own");
    let third = here.node("c1", &[]);
    wait_until(SOON, || here.pids() == before).unwrap_or_else(|| panic!("{before:?}, then {:?}", here.pids()));
    assert!(again.is_running());
    assert_eq!(here.ask(&["stop", "few"]).code, Some(0));
    drop(again.ended(SOON));
    third.signal(Signal::TERM);
    cluster.expect_nothing_left(SOON);
}

/// A node that could not run within its limits reports this, and does not begin.
#[test]
fn a_node_refuses_limits_that_it_could_not_live_with() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let start = |limit: &str| {
        let limited = format!("ulimit {limit}; exec \"$@\"");
        let mut command = Command::new("sh");
        command.args(["-c", &limited, "sh"]).arg(executable("dca-node")).args(["--name", "c1", "--run-dir"]);
        command.arg(here.run_dir()).arg("--state").arg(here.state()).current_dir(cluster.folder());
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    };
    for (limit, said) in [
        ("-n 24", "a node needs 64 open files at once, but its limit is 24: raise the limit"),
        ("-v 400000", "a node reserves 1024 MB of addresses, but its limit is 390 MB: raise the limit"),
    ] {
        let output = start(limit).output().expect("there is a shell");
        let err = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && err.contains(said), "{limit}: {:?} {err}", output.status);
    }
}

/// A link between two hosts is cut, in one or both directions, while a third host reaches both. No host is lost,
/// programs continue, and a stop ends them on both hosts.
#[test]
fn two_hosts_that_a_third_reaches_are_not_lost() {
    for both_ways in [false, true] {
        let Some(hosts) = Hosts::start(3, None) else { return };
        let home = hosts.host(1);
        let text = crowd("c1", 3).replace("idle3 instof Idle(\"c1\")", "idle3 instof Idle(\"c2\")");
        let mission = home.dca(&["deploy", "--no-record", &hosts.cluster.file("pair.dca", &text)]);
        mission.wait_for(Stream::Err, "3 programs on 2 hosts", SOON);
        wait_until(SOON, || home.pids().len() == 3).expect("all run");
        let sees_all = || home.statuses(&[]).iter().all(|node| node.peers.len() == 2);
        wait_until(SOON, sees_all).expect("all see each other");
        let before = home.pids();
        if both_ways {
            hosts.network.keep_apart(&[1, 2]);
        } else {
            // Otherwise the nodes could link by IPv6.
            hosts.network.set(1, "-6 addr flush dev eth0");
            hosts.network.set(1, "route add blackhole 10.77.0.2/32");
        }
        for (node, other) in [(0, "c2"), (1, "c1")] {
            let told = format!("the node `{other}` does not answer directly; `c3` reaches it and passes messages on");
            hosts.nodes[node].wait_for(Stream::Err, &told, SOON);
        }
        dca_tests::cluster::pass(2 * LOST_AFTER);
        let stop = home.ask(&["stop", "pair"]);
        assert_eq!(stop.code, Some(0), "{stop}");
        assert_eq!(mission.ended(SOON).code, Some(1));
        for node in &hosts.nodes {
            assert!(!node.text(Stream::Err).contains("is lost"), "{}", node.text(Stream::Err));
        }
        assert_eq!(before.len(), 3);
        hosts.end();
    }
}

/// A link fails and returns every 200 ms. With `DCA_TEST_ROUNDS=150`, this lasts 60 s. Nothing is restarted, nothing
/// grows, and afterwards all nodes see each other.
#[test]
fn a_flapping_link_restarts_nothing() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (c1, c2) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let nodes: Vec<Program> =
        [("c1", &c1), ("c2", &c2)].into_iter().map(|(name, host)| host.node(name, &["--lan"])).collect();
    let text = crowd("c1", 3).replace("idle3 instof Idle(\"c1\")", "idle3 instof Idle(\"c2\")");
    let mission = c1.dca(&["deploy", "--no-record", &cluster.file("pair.dca", &text)]);
    mission.wait_for(Stream::Err, "3 programs on 2 hosts", SOON);
    wait_until(SOON, || c1.pids().len() == 3).expect("all run");
    let before = c1.pids();
    let sizes = || nodes.iter().map(|node| (memory(node.pid()), descriptors(node.pid()).len())).collect::<Vec<_>>();
    let first = sizes();
    let answer_both = || {
        let statuses = c1.ask(&["status", "--json"]);
        statuses.code == Some(0) && statuses.out.matches("\"pid\"").count() >= 5
    };
    for round in 1..=rounds(10) {
        network.cut(2);
        dca_tests::cluster::pass(FLAP);
        network.heal(2);
        dca_tests::cluster::pass(FLAP);
        // On a busy machine, possibly no message arrives within 200 ms. A host that is silent for 5 s is rightly
        // lost.
        if round % HEARD_EVERY == 0 {
            wait_until(SOON, answer_both).expect("both nodes answer while the link is there");
        }
    }
    let is_as_before = wait_until(SETTLE, || answer_both() && c1.pids() == before).is_some();
    let told = || format!("{}{}", c1.ask(&["status"]), mission.text(Stream::Err));
    assert!(is_as_before, "{before:?}, then {:?}: {}", c1.pids(), told());
    assert!(mission.is_running(), "the mission goes on");
    let is_small = || {
        let now = sizes();
        first.iter().zip(&now).all(|(before, now)| now.0 < before.0 + GROWTH_MAX && now.1 < before.1 + 20)
    };
    assert!(wait_until(SETTLE, is_small).is_some(), "{first:?}, then {:?}", sizes());
    assert_eq!(c1.ask(&["stop", "pair"]).code, Some(0));
    nodes.iter().for_each(|node| node.signal(Signal::TERM));
}

/// Two nodes with the same name are on two sides of a cut, with one deployment each. When they meet, a deployment
/// continues on one of them, and all hosts are told. Nothing begins under the name while both nodes are there.
#[test]
fn two_nodes_of_one_name_that_meet_after_a_cut() {
    let Some(network) = Network::new(3) else { return };
    let cluster = Cluster::new();
    let [first, other, second] = [1, 2, 3].map(|number| cluster.host(&network, number));
    network.keep_apart(&[1, 3]);
    let [node, namesake] = [&first, &second].map(|host| host.node("c1", &["--lan"]));
    let few = cluster.file("few.dca", &crowd("c1", 2));
    let [more, third] = ["more.dca", "third.dca"].map(|name| cluster.file(name, &crowd("c1", 1)));
    let missions = [&first, &second].map(|host| host.dca(&["deploy", "--no-record", &few]));
    missions.iter().for_each(|mission| mission.wait_for(Stream::Err, "2 programs on 1 host", SOON));
    let kept = second.dca(&["deploy", "--no-record", &more]);
    kept.wait_for(Stream::Err, "1 program on 1 host", SOON);
    [1, 3].iter().for_each(|host| network.let_meet(*host));
    let [goes_on, ended] = missions;
    let ended = ended.ended(SOON);
    assert!(
        ended.code == Some(1) && ended.out.contains("another node of this name goes on with the deployment"),
        "{ended}"
    );
    assert!(goes_on.is_running() && kept.is_running(), "what runs on one of them goes on");
    node.wait_for(Stream::Err, "`few@1` also runs on another node with the name of this node", SOON);
    namesake.wait_for(Stream::Err, "the deployment is ended here", SOON);
    // A third host works with one of them, and knows both.
    let third_node = other.node("c2", &["--lan"]);
    let shown = || other.ask(&["nodes"]);
    wait_until(SOON, || shown().out.contains("second of its name: on `")).unwrap_or_else(|| panic!("{}", shown()));
    let status = other.ask(&["status"]);
    assert!(status.err.contains("warning: two nodes are called `c1`"), "{status}");
    for host in [&first, &second] {
        let refused = host.ask(&["deploy", "--no-record", &third]);
        let said = format!("{}{}", refused.out, refused.err);
        assert!(refused.code == Some(1) && said.contains("node") && said.contains("called `c1`"), "{refused}");
    }
    // Once one has left, the name has only one node again.
    namesake.signal(Signal::TERM);
    drop((kept.ended(SOON), namesake.ended(SOON)));
    let is_free = || !other.ask(&["status"]).err.contains("two nodes are called");
    wait_until(SOON, is_free).expect("the name has one node again");
    assert!(goes_on.is_running(), "{}", goes_on.ended(SOON));
    assert_eq!(first.ask(&["stop", "few"]).code, Some(0));
    drop(goes_on.ended(SOON));
    [node, third_node].iter().for_each(|node| node.signal(Signal::TERM));
}

/// Two users deploy the same name at the same time. With `DCA_TEST_ROUNDS=100`, this happens 100 times. One user
/// wins. The other is told so, or was so late that its deployment changed the running one. The running deployment is
/// one of the two.
#[test]
fn two_users_of_one_name_are_one_winner_and_one_refusal() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = [here.node("c1", &[]), here.node("c2", &[])];
    let (ann, bob) = (cluster.file("ann.dca", &crowd("c1", 1)), cluster.file("bob.dca", &crowd("c1", 2)));
    for folder in ["ann", "bob"] {
        std::fs::create_dir_all(cluster.folder().join(folder)).expect("the folder is the test's own");
        let text = std::fs::read_to_string(if folder == "ann" { &ann } else { &bob }).expect("it was just written");
        cluster.file(&format!("{folder}/arm.dca"), &text);
    }
    let file = |user: &str| cluster.folder().join(user).join("arm.dca").display().to_string();
    for round in 0..rounds(5) {
        let [ann, bob] = ["ann", "bob"].map(|user| here.dca(&["deploy", "--no-record", &file(user)]));
        let has_begun = |user: &Program| user.text(Stream::Err).contains("started in");
        let told = || format!("round {round}: {:?}\n{}{}", here.pids(), ann.text(Stream::Err), bob.text(Stream::Err));
        wait_until(SOON, || {
            [(&ann, &bob), (&bob, &ann)].iter().any(|(winner, loser)| has_begun(winner) && !loser.is_running())
        })
        .unwrap_or_else(|| panic!("{}", told()));
        let is_anns = has_begun(&ann);
        assert!(is_anns != has_begun(&bob), "both have it: {}", told());
        let loser = if is_anns { &bob } else { &ann };
        let has_changed = loser.text(Stream::Out).contains("is changed");
        let running = if is_anns == has_changed { 2 } else { 1 };
        wait_until(SOON, || here.pids().len() == running).unwrap_or_else(|| panic!("{}", told()));
        let stop = here.ask(&["stop", "arm"]);
        assert_eq!(stop.code, Some(0), "round {round}: {stop}");
        let (winner, loser) = if is_anns { (ann, bob) } else { (bob, ann) };
        let (winner, loser) = (winner.ended(SOON), loser.ended(SOON));
        assert_eq!(winner.code, Some(1), "round {round}: {winner}\n{loser}");
        let said = format!("{}{}", loser.out, loser.err);
        let is_told = match loser.code {
            Some(0) => has_changed,
            // The deployment of the winner cannot be changed before it runs.
            code => code == Some(1) && ["is already deployed", "does not run"].iter().any(|why| said.contains(why)),
        };
        assert!(is_told, "round {round}: {loser}");
    }
}
