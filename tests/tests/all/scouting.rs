//! Programs of Zenoh find nodes by their own scouting.

use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Host, Network, SOON, alone};
use std::collections::BTreeSet;
use std::io::Write as _;
use std::process::Command;
use std::time::Duration;
use zenoh::Wait;
use zenoh::config::WhatAmI;

/// The multicast group of the nodes, in the form of Zenoh's configuration.
const GROUP: &str = "\"224.0.0.231:7999\"";
/// How long a program scouts. It asks at once, and each node answers.
const SCOUTED: Duration = Duration::from_secs(2);
/// Scouts like the Zenoh package from PyPI, and prints the locators. It polls, since version 1.10.2 fails with `Already borrowed`
/// if another thread stops a scout during its iteration.
const PYTHON: &str = "import time, zenoh
config = zenoh.Config()
config.insert_json5('scouting/multicast/address', '\"224.0.0.231:7999\"')
scout = zenoh.scout(what='peer|router', config=config)
end = time.monotonic() + 3
while time.monotonic() < end:
    hello = scout.try_recv()
    if hello is None:
        time.sleep(0.05)
    else:
        print(*hello.locators)
scout.stop()
";

/// Starts nodes on hosts 1 and 2.
fn nodes(cluster: &Cluster, network: &Network) -> Vec<(Host, dca_tests::cluster::Program)> {
    let node = |number| {
        let host = cluster.host(network, number);
        let node = host.node(&format!("c{number}"), &["--lan"]);
        (host, node)
    };
    [1, 2].map(node).into()
}

#[test]
fn a_program_of_zenoh_lists_the_nodes() {
    if !alone("scouting::a_program_of_zenoh_lists_the_nodes") {
        return;
    }
    let Some(network) = Network::new(3) else { return };
    let cluster = Cluster::new();
    let _nodes = nodes(&cluster, &network);
    let scouting = network.inside(3, || {
        let mut config = zenoh::Config::default();
        config.insert_json5("scouting/multicast/address", GROUP).unwrap();
        let heard = zenoh::scout(WhatAmI::Peer, config).wait().unwrap();
        let (began, mut found) = (now(), BTreeSet::new());
        while found.len() < 2 && now() - began < SOON {
            if let Ok(Some(hello)) = heard.recv_timeout(SCOUTED) {
                found.extend(hello.locators().first().map(ToString::to_string));
            }
        }
        found
    });
    let found = scouting.join().unwrap();
    let is_node = |number: usize| {
        let (place, name) = (format!("tcp/10.77.0.{number}:"), format!("?dca=c{number}"));
        found.iter().any(|locator| locator.starts_with(&place) && locator.ends_with(&name))
    };
    assert!(is_node(1) && is_node(2), "{found:?}");
}

#[test]
#[ignore = "long: needs the package eclipse-zenoh of PyPI"]
fn the_python_package_of_zenoh_lists_the_nodes() {
    let Some(network) = Network::new(3) else { return };
    let python = |arguments: &[&str]| {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &network.namespace(3), "python3"]).args(arguments).output()
    };
    if !python(&["-c", "import zenoh"]).is_ok_and(|output| output.status.success()) {
        writeln!(std::io::stderr(), "skipped: needs the Python package eclipse-zenoh").unwrap_or_default();
        return;
    }
    let cluster = Cluster::new();
    let _nodes = nodes(&cluster, &network);
    let output = python(&["-c", PYTHON]).unwrap();
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    for number in [1, 2] {
        let place = format!("tcp/10.77.0.{number}:");
        assert!(text.contains(&place) && text.contains(&format!("dca=c{number}")), "{text}{output:?}");
    }
}
