//! Three hosts on a network: namespaces on a bridge, with one node each, found by scouting.

use comms::io::clock::{Wakeup, now};
use comms::logic::random::Random;
use comms::logic::time::Time;
use dca_tests::cluster::{Hosts, NAMES, SOON, Sample, Stream, Turn, Window, pass, rate, spec, wait_until, window};
use node::logic::protocol::Ending;
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::Signal;
use std::time::Duration;

const MISSION_MAX: Duration = Duration::from_secs(120);
/// How long the agents are suspended.
const AGENTS_STOPPED: Duration = Duration::from_secs(2);
/// The time between two beats of a `RateSource`, in milliseconds.
const PERIOD_MS: f64 = 10.0;

/// Starts three hosts with a node each, and a fourth host without a node.
fn four_hosts() -> Option<Hosts> {
    Hosts::start(4, None)
}

/// The mission on three hosts, deployed from one of them. Every node sees the others, and a fourth host sees all three.
#[test]
#[ignore = "long: a real door"]
fn the_door_opens_across_hosts() {
    let _turn = Turn::take();
    let Some(hosts) = four_hosts() else { return };
    let (c1, fourth) = (hosts.host(1), hosts.host(4));
    for (host, arguments) in [(&c1, &["nodes"][..]), (&hosts.host(2), &["nodes"]), (&fourth, &["nodes", "--lan"])] {
        let ended = host.ask(arguments);
        let all_there = NAMES.iter().all(|name| ended.out.lines().any(|line| line.starts_with(name)));
        assert!(ended.code == Some(0) && all_there, "{ended}");
    }

    let mission = c1.dca(&["deploy", &spec("door_opening")]);
    mission.wait_for_times(Stream::Err, "▸ (visualserv # distdetect)", 2, SOON);
    let status = fourth.ask(&["status", "--lan"]);
    let programs: Vec<&str> = status.out.lines().filter(|line| line.contains(" pid ")).collect();
    assert_eq!(programs.len(), 22, "{status}");
    for (host, count) in [("c1", 1), ("c2", 4), ("c3", 17)] {
        assert_eq!(programs.iter().filter(|line| line.contains(&format!(" {host} "))).count(), count, "{status}");
    }
    for (name, state) in [("visualserv: VisualServoing", "running"), ("fingers: GripperControl", "idle")] {
        assert!(programs.iter().any(|line| line.contains(name) && line.contains(state)), "{name} {state}\n{status}");
    }

    let ended = mission.ended(MISSION_MAX);
    assert_eq!(ended.code, Some(0), "{ended}");
    let trace = hosts.trace("door_opening-1");
    let angle_deg = trace.signal("main/world", "door angle").last().expect("the world publishes it").value;
    println!("{angle_deg:.1} deg after {:.1?}", trace.finished().1);
    assert!(angle_deg >= 60.0 && trace.has_page());
    assert_eq!(hosts.shims(), 0, "{:?}", hosts.cluster.left());
    hosts.end();
}

/// A mission is deployed from a host without a node, and stopped from another in the middle. It ends on all hosts.
#[test]
fn a_stop_reaches_every_host() {
    let _turn = Turn::take();
    let Some(hosts) = four_hosts() else { return };
    let mission = hosts.host(4).dca(&["deploy", "--lan", &spec("door_opening")]);
    mission.wait_for_times(Stream::Err, "▸ (visualserv # distdetect)", 2, SOON);
    assert_eq!(hosts.shims(), 22);
    let stop = hosts.host(2).ask(&["stop", "door_opening"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(hosts.shims(), 0, "{:?}", hosts.cluster.left());
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.starts_with("door_opening: stopped after"), "{ended}");
    hosts.end();
}

/// `dca logs` follows a process on any host.
#[test]
fn logs_come_from_any_host() {
    let Some(hosts) = four_hosts() else { return };
    let gate = hosts.cluster.folder().join("gate");
    mknodat(CWD, &gate, FileType::Fifo, Mode::RWXU, 0).expect("a test can make a pipe in its own folder");
    let script = "echo first; echo oops >&2; read line < gate; echo second; exec sleep 60";
    let script = hosts.cluster.file("talk.sh", script);
    let text = format!(
        "module Talker(host) {{ exec \"sh {script}\"; plain; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ talker instof Talker(c2); other instof Talker(c3); silent instof RateSource(c3); }}
            internal_event_actions {{ talker, other, silent }}
        }}"
    );
    let deployed = hosts.host(1).dca(&["deploy", &hosts.cluster.file("talk.dca", &text)]);
    deployed.wait_for(Stream::Err, "▸", SOON);
    let follower = hosts.host(1).dca(&["logs", "talker", "-f"]);
    follower.wait_for(Stream::Out, "first\noops\n", SOON);
    let other = hosts.host(2).ask(&["logs", "main/other"]);
    assert_eq!(other.out, "first\noops\n", "{other}");
    let silent = hosts.host(3).ask(&["logs", "silent"]);
    assert!(silent.code == Some(0) && silent.out.is_empty() && silent.err.contains("written nothing"), "{silent}");
    let all = hosts.host(3).ask(&["logs"]);
    assert!(all.code == Some(0) && all.out.contains("main/talker") && all.out.contains("main/silent"), "{all}");
    // Both readers wait for a line. Each line goes to both, since it arrives while they read.
    std::fs::write(&gate, "go\ngo\n").expect("a pipe with readers takes a line");
    follower.wait_for(Stream::Out, "second\n", SOON);
    follower.signal(Signal::INT);
    assert_eq!(follower.ended(SOON).code, Some(0));
    let stop = hosts.host(3).ask(&["stop", "talk"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    drop(deployed.ended(SOON));
    hosts.end();
}

/// While all agents are stopped for 2 s, data from controller to controller keeps its rate, within a host and between hosts. A wire that
/// needed an agent would stop for 2 s. Other tests also use the processors. So a gap may be a quarter of that time longer than the gaps
/// without the stop, or longer than those of a thread of the test during it. The mission continues to its end.
#[test]
fn data_flows_while_the_agents_are_stopped() {
    let Some(hosts) = four_hosts() else { return };
    let deployed = hosts.host(1).dca(&["deploy", &hosts.cluster.file("rates.dca", RATES)]);
    deployed.wait_for(Stream::Err, "▸", SOON);
    // The first second does not count, since links are new and programs are still starting.
    pass(Duration::from_secs(1));
    let mut machine_ms = 0.0;
    let quiet = window(|| machine_ms = beat(AGENTS_STOPPED));
    let stopped = window(|| {
        hosts.signal_nodes(Signal::STOP);
        machine_ms = beat(AGENTS_STOPPED).max(machine_ms);
        hosts.signal_nodes(Signal::CONT);
    });
    println!("the machine's own largest gap {machine_ms:.1} ms");
    pass(Duration::from_millis(500));
    let stop = hosts.host(2).ask(&["stop", "rates"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    drop(deployed.ended(SOON));
    let trace = hosts.trace("rates-1");
    assert_eq!(trace.finished().0, Ending::Stopped);
    for pair in ["near", "far"] {
        let monitor = format!("main/{pair}_monitor");
        let (gaps, lost) = (trace.signal(&monitor, "largest gap"), trace.signal(&monitor, "lost"));
        let [gap_quiet, gap_stopped] = [quiet, stopped].map(|window| largest(&gaps, window));
        let [rate_quiet, rate_stopped] =
            [quiet, stopped].map(|window| rate(&trace.signal(&monitor, "received"), window));
        let lost = lost.last().expect("the monitor publishes it").value;
        println!("{pair}: largest gap {gap_quiet:.1} ms, {rate_quiet:.1} beats/s");
        println!("{pair}, agents stopped: largest gap {gap_stopped:.1} ms, {rate_stopped:.1} beats/s, {lost} lost");
        let gap_max = gap_quiet.max(machine_ms) + AGENTS_STOPPED.as_secs_f64() * 1e3 / 4.0;
        assert!(gap_stopped <= gap_max, "{pair}: {gap_quiet} ms, then {gap_stopped} ms; the machine {machine_ms} ms");
        assert!(rate_stopped > 0.8 * rate_quiet, "{pair}: {rate_quiet} beats/s, then {rate_stopped}");
    }
    hosts.end();
}

/// The agents are suspended for 2 s while the door opens, and the door still opens.
#[test]
#[ignore = "long: a real door"]
fn the_door_opens_although_the_agents_were_stopped() {
    let _turn = Turn::take();
    let Some(hosts) = four_hosts() else { return };
    let mission = hosts.host(1).dca(&["deploy", &spec("door_opening")]);
    mission.wait_for_times(Stream::Err, "▸ dooropen", 2, MISSION_MAX);
    let stopped = window(|| {
        hosts.signal_nodes(Signal::STOP);
        pass(AGENTS_STOPPED);
        hosts.signal_nodes(Signal::CONT);
    });
    let ended = mission.ended(MISSION_MAX);
    assert_eq!(ended.code, Some(0), "{ended}");
    let angle = hosts.trace("door_opening-1").signal("main/world", "door angle");
    let at = |time: Time| angle.iter().find(|sample| sample.stamp >= time).expect("it goes on").value;
    let opened = at(stopped.to) - at(stopped.from);
    println!("the door was opened by {opened:.1} deg while the agents were stopped");
    assert!(opened > 5.0, "{opened} deg");
    hosts.end();
}

/// Links are cut and nodes are suspended in many ways. Once everything is well again, each node soon sees all others, and this remains so.
#[test]
fn whatever_happens_to_links_and_nodes_all_see_each_other_again() {
    let Some(hosts) = four_hosts() else { return };
    let mut random = Random::new(20_261_122);
    let mut below = |bound| random.below(bound);
    let c1 = hosts.host(1);
    let all_see = || {
        let nodes = c1.statuses(&[]);
        nodes.len() == NAMES.len() && nodes.iter().all(|node| node.peers.len() == NAMES.len() - 1)
    };
    for round in 0..3 {
        for _ in 0..4 {
            let index = usize::try_from(below(3)).expect("it is small");
            let time = Duration::from_millis(100 + below(2400));
            match below(3) {
                0 => {
                    hosts.network.cut(index + 1);
                    pass(time);
                    hosts.network.heal(index + 1);
                }
                1 => {
                    hosts.nodes[index].signal(Signal::STOP);
                    pass(time);
                    hosts.nodes[index].signal(Signal::CONT);
                }
                _ => {
                    for _ in 0..3 {
                        hosts.network.cut(index + 1);
                        pass(time / 4);
                        hosts.network.heal(index + 1);
                        pass(time / 8);
                    }
                }
            }
            pass(Duration::from_millis(below(600)));
        }
        let took = wait_until(SOON, all_see);
        println!("round {round}: all see each other after {took:?}");
        let seen = || (1..=NAMES.len()).map(|index| hosts.host(index).ask(&["status"])).collect::<Vec<_>>();
        assert!(took.is_some(), "round {round}: {:#?}", seen());
    }
    hosts.end();
}

const RATES: &str = "
process main() {
    host { c1 }
    instantiated_processes {
        near_source instof RateSource(c3);    near_monitor instof RateMonitor(c3);
        far_source instof RateSource(c1, 1 kB);    far_monitor instof RateMonitor(c2);
    }
    internal_connections(near_source, lbl1) { near_source, Out -> near_monitor, In; }
    internal_connections(far_source, lbl1) { far_source, Out -> far_monitor, In; }
    internal_event_actions { near_source[lbl1], far_source[lbl1], near_monitor, far_monitor }
}
";

/// Wakes up once in each period for this time, like a control loop. Returns the largest gap, in milliseconds.
fn beat(time: Duration) -> f64 {
    let (began, wakeup) = (now(), Wakeup::default());
    let (mut last, mut largest, mut due) = (began, Duration::ZERO, began);
    while last < began + time {
        due = last.max(due + Duration::from_secs_f64(PERIOD_MS / 1e3));
        wakeup.wait(Some(due));
        let woken = now();
        (largest, last) = (largest.max(woken - last), woken);
    }
    largest.as_secs_f64() * 1e3
}

/// Returns the largest value published in a window. The first tenths are left out, since they include the time before it.
fn largest(samples: &[Sample], window: Window) -> f64 {
    let window = Window { from: window.from + Duration::from_millis(200), ..window };
    let within = samples.iter().filter(|sample| window.contains(sample));
    within.map(|sample| sample.value).fold(f64::NAN, f64::max)
}
