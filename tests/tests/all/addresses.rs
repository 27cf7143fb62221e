//! Realistic networks: only IPv6, late interfaces, changing addresses, long delays, crowds.

use comms::io::clock::{Wakeup, now};
use comms::io::descriptors;
use dca_tests::cluster::{Cluster, Ended, Host, Network, SOON, Stream, pass, wait_until};
use rustix::process::Signal;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// More connections than zenoh itself lets wait, which is 100.
const SILENT: usize = 700;

/// Returns whether the answering nodes of `host` see each of `names`.
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
    // The host gets another address, and loses its old one.
    network.set(1, "address add 10.77.0.101/25 dev eth0");
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

/// A link to a peer that does not exist is reported with the reason.
#[test]
fn a_link_that_is_not_made_is_told() {
    let Some(network) = Network::new(1) else { return };
    let cluster = Cluster::new();
    let host = cluster.host(&network, 1);
    let _node = host.node("c1", &["--lan", "--peer", "tcp/10.77.0.1:9", "--peer", "tcp/nobody.invalid:9"]);
    let told = || {
        let told = host.ask(&["nodes"]).err;
        told.contains("`c1` is not linked to tcp/10.77.0.1:9: 10.77.0.1:9: connection refused")
            && told.contains("the name in `nobody.invalid:9` cannot be resolved")
    };
    assert!(wait_until(SOON, told).is_some(), "{}", host.ask(&["nodes"]));
}

/// Relays each connection to another place and back, with a delay for every byte. Its threads end with the test.
fn relay(listener: &TcpListener, to: SocketAddr, delay: Duration) {
    for near in listener.incoming().map_while(Result::ok) {
        let Ok(far) = TcpStream::connect(to) else { continue };
        let [near_too, far_too] = [&near, &far].map(|stream| stream.try_clone().expect("a socket can have two names"));
        carry(near, far, delay);
        carry(far_too, near_too, delay);
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, delay: Duration) {
    let (sender, receiver) = sync_channel(4096);
    std::thread::spawn(move || {
        loop {
            let mut bytes = vec![0; 65_536];
            let size = from.read(&mut bytes).unwrap_or(0);
            bytes.truncate(size);
            if sender.send((now() + delay, bytes)).is_err() || size == 0 {
                return;
            }
        }
    });
    std::thread::spawn(move || {
        for (due, bytes) in receiver {
            Wakeup::default().wait(Some(due));
            if bytes.is_empty() || to.write_all(&bytes).is_err() {
                drop(to.shutdown(std::net::Shutdown::Both));
                return;
            }
        }
    });
}

/// Two nodes that reach each other only over a satellite see each other permanently.
#[test]
fn nodes_3_s_of_round_trip_apart_see_each_other() {
    let Some(network) = Network::new(3) else { return };
    let cluster = Cluster::new();
    let (first, second) = (cluster.host(&network, 1), cluster.host(&network, 2));
    network.keep_apart(&[1, 2]);
    let far = second.node("c2", &["--lan", "--port", "7000"]);
    let near = first.node("c1", &["--lan", "--peer", "tcp/10.77.0.3:7000"]);
    network.inside(3, || {
        let to = "10.77.0.2:7000".parse().expect("it is an address");
        let listener = TcpListener::bind("10.77.0.3:7000").expect("the namespace is the test's own");
        relay(&listener, to, Duration::from_millis(1450));
    });
    let began = now();
    near.wait_for(Stream::Err, "the node `c2` is there", SOON);
    far.wait_for(Stream::Err, "the node `c1` is there", SOON);
    println!("they see each other after {:?}", now() - began);
    // This time is longer than a lease, and longer than the longest allowed silence.
    pass(Duration::from_secs(6));
    for node in [&near, &far] {
        assert!(!node.text(Stream::Err).contains("is missing"), "{}", node.text(Stream::Err));
    }
    let ended = first.ask(&["nodes"]);
    assert!(ended.code == Some(0) && ended.out.lines().any(|line| line.starts_with("c2 ")), "{ended}");
    assert!(!ended.err.contains("is not linked"), "{ended}");
}

/// Makes connections that send nothing. Until `over` is set, it replaces each closed one.
fn crowd(to: SocketAddr, made: &AtomicUsize, over: &AtomicBool) {
    let mut streams: Vec<Option<TcpStream>> = (0..SILENT).map(|_| None).collect();
    while !over.load(Ordering::Relaxed) {
        for stream in &mut streams {
            let is_open = stream.as_mut().is_some_and(
                |stream| matches!(stream.read(&mut [0; 8]), Err(error) if error.kind() == ErrorKind::WouldBlock),
            );
            if !is_open {
                *stream = TcpStream::connect(to).ok();
                stream
                    .iter()
                    .for_each(|stream| stream.set_nonblocking(true).expect("a socket can be told not to wait"));
                made.fetch_add(usize::from(stream.is_some()), Ordering::Relaxed);
            }
        }
        std::thread::yield_now();
    }
}

/// Connections from a scanner, or from a robot with a hanging network, leave the TCP port open for the next caller.
#[test]
fn seven_hundred_silent_connections_from_the_network_do_not_shut_a_newcomer_out() {
    let Some(network) = Network::new(3) else { return };
    let cluster = Cluster::new();
    let (first, third) = (cluster.host(&network, 1), cluster.host(&network, 3));
    let _first = first.node("c1", &["--lan", "--port", "7000"]);
    descriptors::raise();
    let (made, over) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
    let crowding = network.inside(2, {
        let (made, over) = (Arc::clone(&made), Arc::clone(&over));
        move || crowd("10.77.0.1:7000".parse().expect("it is an address"), &made, &over)
    });
    assert!(wait_until(SOON, || made.load(Ordering::Relaxed) >= SILENT).is_some(), "{made:?} connections");
    let newcomer = third.node("c3", &["--lan"]);
    let began = now();
    newcomer.wait_for(Stream::Err, "the node `c1` is there", SOON);
    println!("the newcomer is taken after {:?}, {made:?} connections made", now() - began);
    let nodes = third.ask(&["nodes"]);
    over.store(true, Ordering::Relaxed);
    crowding.join().expect("the crowd does not panic");
    assert!(nodes.code == Some(0) && nodes.out.lines().any(|line| line.starts_with("c1 ")), "{nodes}");
}
