//! The presence of nodes through all changes of links, nodes and machines, and beside other nodes with the same name.

use comms::io::clock::{now, sleep_until, unix_time};
use comms::io::session::Session;
use comms::logic::random::Random;
use comms::logic::{codec, key};
use dca_tests::cluster::{Busy, Hosts, NAMES, Program, SOON, Stream, alone, pass, rounds, wait_until};
use node::logic::protocol::{NodeStatus, Ping};
use rustix::process::Signal;
use std::time::Duration;

/// The longest time from when a node first hears another until it lists it.
const LISTED_WITHIN: Duration = Duration::from_secs(2);
/// The number of rounds of disturbances. `DCA_TEST_ROUNDS` can set a larger one.
const ROUNDS: u64 = 4;
/// The number of processes that ask for the whole machine. Their niceness is the highest.
const BUSY: usize = 60;
/// The log filter of the nodes. It also shows which nodes they hear.
const LOG: &str = "info,zenoh=error,node::logic::nameserver=debug";
/// The longest time between two disturbances of a host, in milliseconds.
const PAUSE_MAX_MS: u64 = 900;

/// Starts this number of hosts. The first three have a node that logs which nodes it hears.
fn start(hosts: usize) -> Option<Hosts> {
    Hosts::start(hosts, Some(LOG))
}

fn carry_out(hosts: &mut Hosts, host: usize, act: Act) {
    match act {
        Act::Cut => hosts.network.cut(host + 1),
        Act::Heal => hosts.network.heal(host + 1),
        Act::Down => hosts.network.set(host + 1, "link set eth0 down"),
        Act::Up => hosts.network.set(host + 1, "link set eth0 up"),
        Act::Apart => hosts.network.keep_apart(&[host + 1]),
        Act::Together => hosts.network.let_meet(host + 1),
        Act::Kill => hosts.nodes[host].kill(),
        Act::Start => hosts.nodes[host] = hosts.host(host + 1).with_log(LOG).start_node(NAMES[host], &["--lan"]),
        Act::Stop => hosts.nodes[host].signal(Signal::STOP),
        Act::Go => hosts.nodes[host].signal(Signal::CONT),
    }
}

/// Asks at each host, and returns whether each node is there and sees all others.
fn all_see(hosts: &Hosts) -> bool {
    let sees = |number| {
        let ended = hosts.host(number).ask(&["status", "--json"]);
        let Ok(nodes) = serde_json::from_str::<Vec<NodeStatus>>(&ended.out) else { return false };
        nodes.len() == NAMES.len() && nodes.iter().all(|node| node.peers.len() == NAMES.len() - 1)
    };
    (1..=NAMES.len()).all(sees)
}

/// Returns for the time after `since` how long each node heard another node before it listed it.
fn delays(hosts: &Hosts, since: Duration) -> Vec<(String, Duration)> {
    let mut delays = Vec::new();
    for (own, node) in NAMES.iter().zip(&hosts.nodes) {
        let log = node.text(Stream::Err);
        for other in NAMES.iter().filter(|other| *other != own) {
            let heard = first(&log, since, |line| line.contains("is heard") && line.contains(&format!("`{other}`")));
            let Some(heard) = heard else { continue };
            // This includes a node that is reached through the third node.
            let listed = first(&log, heard, |line| {
                ["is there:", "was started again:", "does not answer directly;"]
                    .iter()
                    .any(|what| line.contains(&format!("`{other}` {what}")))
            });
            delays.push((format!("{own} of {other}"), listed.map_or(Duration::MAX, |listed| listed - heard)));
        }
    }
    delays
}

/// A disturbance of a host, or the end of one.
#[derive(Clone, Copy, Debug)]
enum Act {
    Cut,
    Heal,
    Down,
    Up,
    /// The host cannot reach the others that are kept apart.
    Apart,
    Together,
    Kill,
    Start,
    Stop,
    Go,
}

/// Returns when a log first had a `wanted` line, at `since` or later, as the time of that day.
fn first(log: &str, since: Duration, wanted: impl Fn(&str) -> bool) -> Option<Duration> {
    log.lines().filter(|line| wanted(line)).filter_map(stamp).find(|at| *at >= since)
}

/// Reads `2026-11-22T10:16:50.123456Z`.
fn stamp(line: &str) -> Option<Duration> {
    let time = line.split_once('T')?.1.split_once('Z')?.0;
    let mut parts = time.split(':').map(|part| part.parse::<f64>().ok());
    let seconds = parts.try_fold(0.0, |sum, part| Some(sum * 60.0 + part?))?;
    Some(Duration::from_secs_f64(seconds))
}

/// Returns the time of day in the form of logs.
fn time_of_day() -> Duration {
    let time = unix_time();
    Duration::new(time.as_secs() % 86_400, time.subsec_nanos())
}

/// Returns the disturbances of each host with their times, in milliseconds. At the end, each host is as before.
fn disturbances(random: &mut Random) -> Vec<(u64, usize, Act)> {
    let mut all = Vec::new();
    for host in 0..NAMES.len() {
        let kinds = [
            (Act::Cut, Act::Heal, 4),
            (Act::Down, Act::Up, 4),
            (Act::Apart, Act::Together, 3),
            (Act::Stop, Act::Go, 4),
            (Act::Kill, Act::Start, 2),
        ];
        for (begin, end, times_max) in kinds {
            let mut at = random.below(PAUSE_MAX_MS);
            for _ in 0..random.below(times_max) {
                // Half of the disturbances are short. The others may last longer than the time for noticing them.
                let longest = [200, 3000][usize::from(random.below(2) == 0)];
                let time = 50 + random.below(longest);
                all.extend([(at, host, begin), (at + time, host, end)]);
                at += time + random.below(PAUSE_MAX_MS);
            }
        }
    }
    all.sort_by_key(|(at, ..)| *at);
    all
}

/// Links and interfaces come and go, hosts reach only some others, and nodes are suspended or killed, in a random order
/// on a busy machine. Once everything is well again, each node lists each other node that it hears within 2 s, and each
/// node answers calls.
#[test]
fn a_node_that_is_heard_is_listed_within_2_s() {
    let Some(mut hosts) = start(NAMES.len()) else { return };
    let _busy = Busy::start(BUSY, 19);
    for seed in 0..rounds(ROUNDS) {
        let disturbances = disturbances(&mut Random::new(seed));
        let mut now = 0;
        for (at, host, act) in &disturbances {
            pass(Duration::from_millis(at - now));
            now = *at;
            carry_out(&mut hosts, *host, *act);
        }
        let calm = time_of_day();
        let took = wait_until(SOON, || all_see(&hosts));
        let logs = || hosts.nodes.iter().map(|node| node.text(Stream::Err)).collect::<Vec<_>>().join("---\n");
        let delays = delays(&hosts, calm);
        println!(
            "seed {seed}: all see each other {took:?} after {now} ms of disturbances; heard to listed: {delays:?}"
        );
        assert!(took.is_some(), "seed {seed}, {disturbances:?}: {}\n{}", hosts.host(1).ask(&["status"]), logs());
        let late = delays.iter().find(|(_, delay)| *delay > LISTED_WITHIN);
        assert!(late.is_none(), "seed {seed}, {disturbances:?}, calm at {calm:?}: {late:?}\n{}", logs());
    }
}

/// An endless mission on `c1` and `c2`.
const TWICE: &str = "
process main() {
    host { c1 }
    instantiated_processes { source instof RateSource(c1, 1 kB); monitor instof RateMonitor(c2); }
    internal_connections(source, lbl1) { source, Out -> monitor, In; }
    internal_event_actions { source[lbl1], monitor }
}
";

fn deployed(hosts: &Hosts) -> Program {
    let mission = hosts.host(1).dca(&["deploy", &hosts.cluster.file("twice.dca", TWICE)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    mission
}

/// Stops a mission. It must not have been disturbed.
#[track_caller]
fn undisturbed(hosts: &Hosts, mission: Program) {
    assert!(mission.is_running(), "{}", mission.text(Stream::Err));
    let [c1, c2] = [0, 1].map(|index| hosts.nodes[index].text(Stream::Err));
    assert!(!c1.contains("`c2` is missing") && !c2.contains("`c1` is missing"), "{c1}---\n{c2}");
    let running = hosts.host(3).processes(&[]).into_iter().filter(|(host, _)| host == "c2").count();
    assert_eq!(running, 1, "the monitor is where it was");
    let stop = hosts.host(3).ask(&["stop", "twice"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    let ended = mission.ended(SOON);
    assert!(ended.out.starts_with("twice: stopped after"), "{ended}");
}

/// Two people have a `c2` in one laboratory. The second node is refused and told so, and the earlier nodes are also
/// told. The mission on the first node continues, and can be stopped as usual.
#[test]
fn a_second_node_of_a_name_does_not_disturb_a_mission() {
    let Some(hosts) = start(4) else { return };
    let mission = deployed(&hosts);
    for _ in 0..2 {
        let ended = hosts.host(4).start_node("c2", &["--lan"]).ended(SOON);
        assert!(ended.code == Some(1) && ended.err.contains("another node called `c2` was there first"), "{ended}");
    }
    let told = "ignoring another node that has the name of this node";
    hosts.nodes[1].wait_for(Stream::Err, told, SOON);
    hosts.nodes[0].wait_for(Stream::Err, "a second node called `c2`", SOON);
    // This is longer than the time for losing a node.
    pass(Duration::from_secs(6));
    undisturbed(&hosts, mission);
}

/// The second node comes up while the first is suspended. It does not take the first node's place, and the mission
/// continues with the first.
#[test]
fn a_second_node_takes_no_name_from_one_that_is_away_for_a_moment() {
    let Some(hosts) = start(4) else { return };
    let mission = deployed(&hosts);
    // The node waits for a network, so the other nodes do not yet hear of it.
    hosts.network.set(4, "link set eth0 down");
    let second = hosts.host(4).start_node("c2", &["--lan"]);
    second.wait_for(Stream::Err, "no network interface is up", SOON);
    hosts.nodes[1].signal(Signal::STOP);
    hosts.nodes[0].wait_for(Stream::Err, "the node `c2` is missing", SOON);
    hosts.network.set(4, "link set eth0 up");
    second.wait_for(Stream::Out, "node `c2` is ready", SOON);
    pass(Duration::from_secs(1));
    hosts.nodes[1].signal(Signal::CONT);
    hosts.nodes[0].wait_for(Stream::Err, "a second node called `c2`", SOON);
    let told = hosts.nodes[0].text(Stream::Err);
    assert!(!told.contains("the node `c2` was started again"), "{told}");
    if told.contains("the node `c2` is lost") {
        println!("skipped: this machine is so busy that the first was away for 5 s");
        return;
    }
    assert!(mission.is_running(), "{}\n{told}", mission.text(Stream::Err));
    let ended = second.ended(SOON);
    assert_eq!(ended.code, Some(1), "{ended}");
    let stop = hosts.host(3).ask(&["stop", "twice"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert!(mission.ended(SOON).out.starts_with("twice: stopped after"));
}

/// Any client can make a token, or ask under another name. Neither changes which nodes are reachable, during the
/// attempt and afterwards.
#[test]
fn a_forged_token_does_not_disturb_a_mission() {
    if !alone("presence::a_forged_token_does_not_disturb_a_mission") {
        return;
    }
    let Some(hosts) = start(4) else { return };
    let mission = deployed(&hosts);
    let forging = hosts.network.inside(4, || {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        runtime.expect("a machine has threads").block_on(async {
            let session = Session::open_scout().await.expect("there is a network");
            let token = session.announce(&key::live("c2", 42)).expect("anybody can");
            for round in 0..30 {
                let ping = codec::encode(&Ping { from: "c2".to_owned(), boot: 42, round }).expect("it is short");
                session.put(&key::ping("c2"), ping).expect("anybody can");
                sleep_until(now() + Duration::from_millis(100)).await;
            }
            drop(token);
            session.close().await;
        });
    });
    forging.join().expect("the forger does not panic");
    hosts.nodes[0].wait_for(Stream::Err, "the node `c2` was heard, but is not listed as present", SOON);
    // This is longer than the time for losing a node.
    pass(Duration::from_secs(6));
    undisturbed(&hosts, mission);
}
