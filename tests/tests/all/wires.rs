//! Links of programs over a network: the time until a cut is noticed.

use comms::io::clock::now;
use comms::io::data::{DataSession, Priority};
use comms::io::session::Reach;
use comms::logic::control::Dial;
use dca_tests::cluster::{Cluster, Network, Program, SOON, Stream, wait_until};
use std::path::Path;
use std::time::Duration;

/// A cut of a fast link is noticed after 1.9 s, and not after the lease of 5 s that a long link needs. On a busy
/// machine this takes longer.
const NOTICED_WITHIN: Duration = Duration::from_secs(4);
/// The keys that each end publishes and the other end receives.
const KEYS: [&str; 2] = ["dca/d/wires/1/w/0", "dca/d/wires/1/w/1"];

/// One end of a link, in its own process. It prints its address, and when it is linked or unlinked. As a test, it
/// does nothing.
#[test]
fn one_end() {
    let Ok(socket) = std::env::var("DCA_TEST_SOCKET") else { return };
    let session = DataSession::open(Path::new(&socket), Reach::Lan).expect("the socket is the test's own");
    let place = std::env::var("DCA_TEST_DIAL").ok();
    let [own, other] = if place.is_some() { KEYS } else { [KEYS[1], KEYS[0]] };
    let _hearing = session.on_sample(other, |_| ()).expect("the session is open");
    let publisher = session.publisher(own, Priority::Wire).expect("the session is open");
    let location = session.location();
    let remote = location.remote.iter().find(|locator| locator.contains("10.77.")).expect("it listens on the network");
    println!("location {} {remote} end", location.session);
    if let Some((id, locator)) = place.as_deref().and_then(|place| place.split_once(' ')) {
        let dial = Dial { session: id.to_owned(), locators: vec![locator.to_owned()] };
        session.dial(&dial, SOON).expect("the other end listens");
    }
    assert!(publisher.wait_heard(SOON));
    println!("linked");
    assert!(wait_until(SOON, || !publisher.is_heard()).is_some(), "it still believes in the link");
    println!("alone");
}

/// A producer and a consumer notice a cut wire on their own, without a message from a node.
#[test]
fn a_cut_wire_is_noticed_before_the_lease_is_over() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let start = |number: usize, dial: &[(&str, &str)]| {
        let host = cluster.host(&network, number);
        let socket = cluster.folder().join(format!("end{number}")).display().to_string();
        host.test("wires::one_end", &[&[("DCA_TEST_SOCKET", socket.as_str())], dial].concat())
    };
    let producer = start(1, &[]);
    producer.wait_for(Stream::Out, " end\n", SOON);
    let said = producer.text(Stream::Out);
    let place = said.split_once("location ").and_then(|(_, rest)| rest.split_once(" end")).expect("it says where").0;
    let consumer = start(2, &[("DCA_TEST_DIAL", place)]);
    let ends = [("the producer", producer), ("the consumer", consumer)];
    let wait = |(_, end): &(&str, Program), word: &str| end.wait_for(Stream::Out, word, SOON);
    ends.iter().for_each(|end| wait(end, "linked\n"));
    network.cut(2);
    let began = now();
    for end in &ends {
        wait(end, "alone\n");
        let took = now() - began;
        println!("{} has noticed the cut after {took:.1?}", end.0);
        assert!(took < NOTICED_WITHIN, "{} has noticed the cut after {took:?}", end.0);
    }
}
