//! Networks as they are: IPv6 alone, interfaces that come up late, addresses that change.

use dca_tests::cluster::{Cluster, Ended, Host, Network, SOON, Stream, wait_until};
use rustix::process::Signal;

/// Returns whether the nodes of `host` that answer see each of `names`.
fn sees(host: &Host, names: &[&str]) -> bool {
    let Ended { out, .. } = host.ask(&["nodes"]);
    names.iter().all(|name| out.lines().filter(|line| line.contains(name)).count() >= names.len())
}

#[test]
fn a_node_listens_on_what_comes_up_and_leaves_what_goes() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (first, second) = (cluster.host(&network, 1), cluster.host(&network, 2));
    network.set(1, "link set eth0 down");
    let c1 = first.start_node("c1", &["--lan"]);
    let c2 = second.node("c2", &["--lan"]);
    c1.wait_for(Stream::Err, "no network interface is up", SOON);
    assert!(!c1.text(Stream::Out).contains("is ready"), "nobody can reach it");
    // The interface comes up.
    network.set(1, "link set eth0 up");
    c1.wait_for(Stream::Out, "node `c1` is ready", SOON);
    c1.wait_for(Stream::Err, "the node `c2` is there", SOON);
    // It gets another address, and loses the one that it had.
    network.set(1, "address add 10.77.0.101/24 dev eth0");
    c1.wait_for(Stream::Err, "listening on 10.77.0.101 (eth0)", SOON);
    network.set(1, "address del 10.77.0.1/24 dev eth0");
    c1.wait_for(Stream::Err, "no longer listening on 10.77.0.1 (eth0)", SOON);
    assert!(wait_until(SOON, || sees(&second, &["c1", "c2"])).is_some());
    for node in [c1, c2] {
        node.signal(Signal::TERM);
        assert_eq!(node.ended(SOON).code, Some(0));
    }
}

#[test]
fn nodes_find_each_other_over_ipv6_alone() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let hosts = [cluster.host(&network, 1), cluster.host(&network, 2)];
    for number in [1, 2] {
        network.set(number, &format!("address del 10.77.0.{number}/24 dev eth0"));
    }
    let nodes = [hosts[0].start_node("c1", &["--lan"]), hosts[1].start_node("c2", &["--lan"])];
    for (node, other) in nodes.iter().zip(["c2", "c1"]) {
        node.wait_for(Stream::Out, "is ready", SOON);
        node.wait_for(Stream::Err, &format!("the node `{other}` is there"), SOON);
    }
    assert!(sees(&hosts[0], &["c1", "c2"]));
    for node in nodes {
        node.signal(Signal::TERM);
        assert_eq!(node.ended(SOON).code, Some(0));
    }
}

/// What is dialled and not there is told with the reason.
#[test]
fn a_link_that_is_not_made_is_told() {
    let Some(network) = Network::new(1) else { return };
    let cluster = Cluster::new();
    let host = cluster.host(&network, 1);
    let _node = host.node("c1", &["--lan", "--peer", "tcp/10.77.0.1:9"]);
    let told =
        || host.ask(&["nodes"]).err.contains("`c1` is not linked to tcp/10.77.0.1:9: 10.77.0.1:9: connection refused");
    assert!(wait_until(SOON, told).is_some());
}
