//! The traffic between nodes on a quiet network, and the time in which they still notice important changes.

use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Network, Program, SOON, Stream, pass, wait_until};
use rustix::process::Signal;
use std::process::Command;
use std::time::Duration;

/// How many nodes.
const NODES: usize = 6;
/// The time until nodes are quiet after a node has joined or asked: 10 s, and the last questions.
const QUIET_AFTER: Duration = Duration::from_secs(15);
/// The time for almost one question from each node to all others.
const MEASURED: Duration = Duration::from_secs(40);
/// The limit for a node's traffic to each other node, in bytes each second. With 19 others this is 1 kB/s.
const PER_LINK_MAX: f64 = 52.0;
/// The limit for a node's announcements to the network, in bytes each second, for any number of nodes. It announces its
/// address every 3 s, over IPv4 and IPv6.
const TO_ALL_MAX: f64 = 100.0;
/// The time for noticing a cut that affects a mission: 1.9 s, and the delay of a busy machine. On a link at rest, this
/// would take up to 9 s.
const CUT_WITHIN: Duration = Duration::from_millis(4000);
/// The time for noticing a missing node without a mission: a message every 7.5 s, 1.25 s for its arrival, 0.3 s for a
/// question, and the delay of a busy machine.
const MISSED_WITHIN: Duration = Duration::from_secs(14);
/// The same for a suspended node whose system still accepts messages. It includes 15 s of silence instead.
const SUSPENDED_WITHIN: Duration = Duration::from_secs(22);

/// Returns the number of bytes that a host has sent over its cable.
fn sent(network: &Network, number: usize) -> f64 {
    let counter = "/sys/class/net/eth0/statistics/tx_bytes";
    let read = Command::new("ip").args(["netns", "exec", &network.namespace(number), "cat", counter]).output();
    let text = String::from_utf8(read.expect("`ip` is there").stdout).expect("a number is text");
    text.trim().parse().expect("the kernel counts")
}

/// Returns how often a node has noticed a lost link.
fn gone(node: &Program) -> usize {
    node.text(Stream::Err).matches("no link, dialling").count()
}

/// There are six nodes, and two of them have a mission. The others are quiet. A cut of the mission is noticed at once,
/// and a cut of the others soon.
#[test]
fn nodes_without_a_mission_are_quiet_and_a_mission_notices_a_cut_at_once() {
    let Some(network) = Network::new(NODES) else { return };
    let cluster = Cluster::new();
    let hosts: Vec<_> = (1..=NODES).map(|number| cluster.host(&network, number).with_log("info,comms=debug")).collect();
    let nodes: Vec<Program> =
        (1..).zip(&hosts).map(|(number, host)| host.node(&format!("c{number}"), &["--lan"])).collect();
    let sees_all = || hosts[0].statuses(&[]).iter().filter(|node| node.peers.len() == NODES - 1).count() == NODES;
    wait_until(2 * SOON, sees_all).expect("all see each other");
    let spec = "module Idle(host) { exec \"sleep 3600\"; plain; done; }\nprocess main() { host { \"c1\" }\n\
                instantiated_processes { here instof Idle(\"c1\"); there instof Idle(\"c2\"); }\n\
                internal_event_actions { here , there } }\n";
    let mission = hosts[0].dca(&["deploy", "--no-record", &cluster.file("pair.dca", spec)]);
    mission.wait_for(Stream::Err, "2 programs on 2 hosts", SOON);
    pass(QUIET_AFTER);
    let idle: Vec<usize> = (3..=NODES).collect();
    let all_sent = || idle.iter().map(|number| sent(&network, *number)).collect::<Vec<f64>>();
    let (before, began) = (all_sent(), now());
    pass(MEASURED);
    let (after, took) = (all_sent(), now().since(began).as_secs_f64());
    let others = f64::from(u8::try_from(NODES - 1).unwrap());
    for ((number, before), after) in idle.iter().zip(before).zip(after) {
        let rate = (after - before) / took;
        println!("c{number} sends {rate:.0} B/s");
        assert!(rate <= others * PER_LINK_MAX + TO_ALL_MAX, "c{number} sends {rate:.0} B/s");
    }
    // The mission depends on this node.
    let (known, missed) = (gone(&nodes[0]), "the node `c2` is missing");
    network.cut(2);
    let cut = wait_until(SOON, || gone(&nodes[0]) > known).expect("the cut is noticed");
    nodes[0].wait_for(Stream::Err, missed, SOON);
    println!("the cut of c2 is noticed after {cut:?}");
    assert!(cut <= CUT_WITHIN, "{cut:?}");
    network.heal(2);
    // Nothing depends on this node.
    network.cut(6);
    let missing = |who: &str| nodes[2].text(Stream::Err).contains(&format!("the node `{who}` is missing"));
    let cut = wait_until(2 * SOON, || missing("c6")).expect("the cut is noticed");
    println!("the cut of c6 is noticed after {cut:?}");
    assert!(cut <= MISSED_WITHIN, "{cut:?}");
    network.heal(6);
    nodes[4].signal(Signal::STOP);
    let suspended = wait_until(2 * SOON, || missing("c5")).expect("it is noticed");
    println!("that c5 is suspended is noticed after {suspended:?}");
    assert!(suspended <= SUSPENDED_WITHIN, "{suspended:?}");
    nodes[4].signal(Signal::CONT);
    wait_until(2 * SOON, sees_all).expect("all see each other again");
    assert_eq!(hosts[0].ask(&["stop", "pair"]).code, Some(0));
    nodes.iter().for_each(|node| node.signal(Signal::TERM));
}
