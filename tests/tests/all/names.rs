//! The holders of names: `dca names`, and the result if two programs want the same name or if a name has no holder.

use comms::logic::key::HostName;
use dca_tests::cluster::{Cluster, Host, SOON, Stream, Turn, wait_until};
use serde_json::Value;
use std::time::Duration;

/// How long a host may be silent before the others count it as lost, plus some time for checking.
const LEASE: Duration = Duration::from_secs(6 + 6);

/// A program on each of two hosts. The second program holds an arm.
const ARM: &str = "
module Hold(host) { exec \"sleep 600\"; plain; done; claims arm; }
module Wait(host) { exec \"sleep 600\"; plain; done; }
process main() {
    host { \"c1\" }
    instantiated_processes { here instof Wait(\"c1\"); there instof Hold(\"c2\"); }
    internal_event_actions { here , there }
}
";

fn names(host: &Host) -> Value {
    let ended = host.ask(&["names", "--json"]);
    assert_eq!(ended.code, Some(0), "{ended}");
    serde_json::from_str(&ended.out).unwrap_or_else(|why| panic!("{why}: {ended}"))
}

/// Returns one field of each entry in a list. There must be only one partition.
fn all<'a>(names: &'a Value, list: &str, field: &str) -> Vec<&'a str> {
    assert_eq!(names.as_array().map(Vec::len), Some(1), "{names:#}");
    names[0][list].as_array().into_iter().flatten().filter_map(|one| one[field].as_str()).collect()
}

/// A spec accepts the same host names as a node, and refuses others for the same reason.
#[test]
fn specs_and_nodes_take_the_same_names() {
    let long = ["a".repeat(63), "a".repeat(64)];
    let names = ["c1", "192.168.0.7", "arm-left_2", "", "a/b", "*", "-a", ".a", "_a", "a@b", "a b", "\u{e9}", "a\n"];
    for name in names.into_iter().chain(long.iter().map(String::as_str)) {
        let by_node = HostName::parse(name).err().map(|error| error.to_string());
        let by_spec = language::host_name_problem(name);
        assert_eq!(by_spec.is_some(), by_node.is_some(), "{name:?}");
        assert!(by_node.unwrap_or_default().contains(by_spec.unwrap_or_default()), "{name:?}");
    }
}

/// The second deployment wants the arm that the first one holds, on the same host. It is refused, and the holder is
/// named.
#[test]
fn a_device_has_one_holder_across_deployments() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = [here.node("c1", &[]), here.node("c2", &[])];
    let first = here.dca(&["deploy", "--no-record", &cluster.file("first.dca", ARM)]);
    first.wait_for(Stream::Err, "▸", SOON);
    let known = names(&here);
    assert_eq!((all(&known, "devices", "device"), all(&known, "devices", "path")), (vec!["arm"], vec!["main/there"]));
    assert_eq!(all(&known, "devices", "host"), ["c2"]);
    let second = here.ask(&["deploy", "--no-record", &cluster.file("second.dca", ARM)]);
    assert_eq!(second.code, Some(1), "{second}");
    let held = "host `c2`: `arm` is held by `main/there` of `first@1`; `dca stop first` ends that";
    assert!(format!("{}{}", second.out, second.err).contains(held), "{second}");
    // After the stop, the arm is free.
    assert_eq!(here.ask(&["stop", "first"]).code, Some(0));
    assert_eq!(all(&names(&here), "devices", "device"), [""; 0]);
    let third = here.dca(&["deploy", "--no-record", &cluster.file("second.dca", ARM)]);
    third.wait_for(Stream::Err, "▸", SOON);
    assert_eq!(here.ask(&["stop", "second"]).code, Some(0));
}

/// A node dies. Its names are no longer given out, and its host disappears from the lists of the others within a
/// lease.
#[test]
fn names_of_a_host_that_is_gone_leave_within_a_lease() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (_c1, c2) = (here.node("c1", &[]), here.node("c2", &[]));
    let deploy = here.dca(&["deploy", "--no-record", &cluster.file("first.dca", ARM)]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    let known = names(&here);
    assert_eq!(all(&known, "hosts", "host"), ["c1", "c2"]);
    assert_eq!(all(&known, "processes", "path"), ["main", "main/here", "main/there"]);
    assert_eq!(all(&known, "deployments", "home"), ["c1"]);
    let text = here.ask(&["names"]);
    assert!(text.out.lines().any(|line| line.starts_with("device      arm ")), "{text}");
    c2.kill();
    let is_gone = || {
        let known = names(&here);
        let sees = known[0]["hosts"][0]["sees"].as_array().is_some_and(Vec::is_empty);
        sees && all(&known, "hosts", "host") == ["c1"] && all(&known, "devices", "device").is_empty()
    };
    assert!(wait_until(LEASE, is_gone).is_some(), "{:#}", names(&here));
    let warned = here.ask(&["names"]);
    assert!(warned.err.contains("warning: `c2` "), "{warned}");
}

/// The ports at both ends of a wire have names, and the types that the programs declare.
#[test]
fn ports_have_types() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let here = cluster.here();
    let spec = dca_tests::cluster::spec("door_opening");
    let run = here.dca(&["run", "--no-record", &spec]);
    run.wait_for(Stream::Err, "▸", SOON);
    let known = names(&here);
    let ports = known[0]["ports"].as_array().unwrap_or_else(|| panic!("{known:#}"));
    assert!(ports.len() > 20, "{ports:?}");
    assert!(ports.iter().all(|port| port["kind"].is_string()), "{ports:?}");
    assert!(ports.iter().any(|port| port["is_output"] == true) && ports.iter().any(|port| port["is_output"] == false));
    run.signal(rustix::process::Signal::INT);
    run.ended(SOON);
}

/// A program inside a group. It prints a line.
const PATROL: &str = "
module Say(host) { exec \"sh -c 'echo here I am; exec sleep 600'\"; plain; }
process Round() { instantiated_processes { base instof Say(\"c1\"); } internal_event_actions { base } }
process main() { host { \"c1\" } instantiated_processes { low instof Round(); } internal_event_actions { low } }
";

/// Every verb accepts the names that other verbs print. An unknown name is refused, together with the most similar
/// one.
#[test]
fn every_verb_takes_the_names_that_others_print() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("patrol.dca", PATROL)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    let check = |arguments: &[&str], code: i32, text: &str| {
        let ended = here.ask(arguments);
        let is_told = ended.out.contains(text) || ended.err.contains(text);
        assert!(ended.code == Some(code) && is_told, "{arguments:?}: {ended}");
    };
    for name in ["base", "low/base", "main/low/base", "patrol:base", "patrol@1:main/low/base", "patrol/low/base"] {
        check(&["logs", name], 0, "here I am");
    }
    for name in ["patrol", "patrol@1"] {
        check(&["status", name], 0, "base: Say");
        check(&["events", name], 0, "main/low/base");
    }
    check(&["logs", "patrol@2:base"], 1, "no process `patrol@2:base` is running; did you mean `patrol@1:base`?");
    check(&["logs", "bas"], 1, "did you mean `base`?");
    check(&["stop", "patrol@2"], 1, "no deployment `patrol@2` is running; did you mean `patrol@1`?");
    check(&["status", "patrl"], 2, "no node knows a deployment `patrl`; did you mean `patrol`?");
    check(&["events", "patrl"], 2, "no node knows a deployment `patrl`; did you mean `patrol`?");
    check(&["replace", "patrol", "base.Out"], 2, "`base.Out` is a port; its process is `base`");
    check(&["switch", "patrol", "gate:base[x]"], 2, "`gate:base` is not a process of `patrol@1`");
    check(&["stop", "patrol@1"], 0, "`patrol@1` is stopped");
    mission.ended(SOON);
    check(&["status", "patrol"], 0, "`patrol` is over; `dca events patrol` says how it ended");
    check(&["events", "patrol@1"], 0, "main/low/base");
    check(&["status", "patrol@9"], 2, "did you mean `patrol@1`?");
}
