//! `dca estop` with real processes: everything on every host ends at once, and nothing begins before the release.
//! Hosts that do not answer are named.

use dca_tests::cluster::{Cluster, Host, Network, SOON, Stream, wait_until};
use dca_tests::made_team::MadeTeam;
use rustix::process::Signal;
use serde_json::{Value, json};

/// A program on each of two hosts. If the event action at the end ran, it would leave a file.
fn endless(mark: &str) -> String {
    format!(
        r#"
module Idle(host: Host) {{ exec "sleep 3600"; plain; done; }}
module Mark(host: Host) {{ exec "touch {mark}"; plain; done; }}
process main() {{
    host {{ c1 }}
    instantiated_processes {{ here instof Idle(c1); there instof Idle(c2); last instof Mark(c1); }}
    internal_event_actions {{ (here , there) finally last }}
}}
"#
    )
}

fn estop_json(host: &Host, arguments: &[&str]) -> (Option<i32>, Value) {
    let ended = host.ask(&[&["estop", "--json"], arguments].concat());
    (ended.code, serde_json::from_str(&ended.out).unwrap_or_else(|why| panic!("{why}: {ended}")))
}

#[test]
fn everything_ends_at_once_and_stays_so_over_a_restart() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let mark = cluster.folder().join("mark");
    let spec = cluster.file("endless.dca", &endless(&mark.display().to_string()));
    let nodes = [here.node("c1", &[]), here.node("c2", &[])];
    let deploy = here.dca(&["deploy", "--no-record", &spec]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    assert_eq!(here.pids().len(), 2);
    let all = here.ask(&["estop", "a person in the cell"]);
    assert_eq!((all.code, all.out.as_str()), (Some(0), "c1: stopped; no program runs\nc2: stopped; no program runs\n"));
    assert!(all.err.contains("no program starts on these hosts before `dca estop --release`"), "{all}");
    assert_eq!(here.pids().len(), 0, "no program is left when it says so");
    let ended = deploy.ended(SOON);
    assert_eq!(ended.code, Some(1), "{ended}");
    assert!(
        ended.out.contains("everything was stopped by ") && ended.out.contains(": a person in the cell"),
        "{ended}"
    );
    assert!(!mark.exists(), "`finally` is not begun");

    let refused = here.ask(&["deploy", "--no-record", &spec]);
    assert_eq!(refused.code, Some(1), "{refused}");
    let why = "`dca estop --release` lets programs begin again";
    assert!(format!("{}{}", refused.out, refused.err).contains(why), "{refused}");
    let status = here.ask(&["status"]);
    assert!(status.out.contains("c1: everything was stopped by ") && status.out.contains(why), "{status}");
    // Both nodes know of the stop when they are restarted: one that ended on request, and one that was killed.
    nodes[0].signal(Signal::TERM);
    nodes[1].signal(Signal::KILL);
    assert!(wait_until(SOON, || nodes.iter().all(|node| !node.is_running())).is_some());
    let _again = [here.node("c1", &[]), here.node("c2", &[])];
    let refused = here.ask(&["deploy", "--no-record", &spec]);
    assert_eq!(refused.code, Some(1), "{refused}");
    assert_eq!(estop_json(&here, &["again"]).0, Some(0));
    let released = here.ask(&["estop", "--release"]);
    let words = "c1: released: programs may begin again\nc2: released: programs may begin again\n";
    assert_eq!((released.code, released.out.as_str()), (Some(0), words));
    let again = here.dca(&["deploy", "--no-record", &spec]);
    again.wait_for(Stream::Err, "▸", SOON);
    assert!(wait_until(SOON, || here.pids().len() == 2).is_some(), "{:?}", here.pids());
    assert_eq!(here.ask(&["stop", "endless"]).code, Some(0));
    assert!(mark.exists(), "an ordinary stop does what the plan says");
}

/// A stop that lasts only until the end of the node is not reliable.
#[test]
fn a_disk_that_does_not_have_it_is_told() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("c1", &[]);
    // A folder in the place of the file has the same effect as a full disk.
    let file = here.state().join("c1").join("estop");
    std::fs::create_dir(&file).expect("the node has made its folder");
    let all = here.ask(&["estop"]);
    assert_eq!(all.code, Some(1), "{all}");
    assert!(all.out.starts_with("c1: stopped; no program runs; its disk could not store this: `"), "{all}");
    assert!(all.err.contains("after a restart, the node would not know that everything is stopped"), "{all}");
    let (code, hosts) = estop_json(&here, &["--release"]);
    assert_eq!((code, hosts["hosts"][0]["unwritten"].is_string()), (Some(1), true), "{hosts:#}");
    std::fs::remove_dir(&file).expect("it is empty");
    assert_eq!(here.ask(&["estop"]).code, Some(0));
    node.signal(Signal::KILL);
    assert!(wait_until(SOON, || !node.is_running()).is_some());
    let _again = here.node("c1", &[]);
    assert!(here.ask(&["status"]).out.contains("c1: everything was stopped by "));
}

/// A suspended node has not answered, so it does not count as stopped.
#[test]
fn who_does_not_answer_is_named() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (_c1, c2) = (here.node("c1", &[]), here.node("c2", &[]));
    c2.signal(Signal::STOP);
    let (code, hosts) = estop_json(&here, &[]);
    assert_eq!(code, Some(3), "{hosts:#}");
    assert_eq!(hosts["hosts"][0], json!({ "host": "c1", "stopped": true, "unended": [], "unwritten": null }));
    assert_eq!(hosts["hosts"][1]["host"], "c2");
    assert!(hosts["hosts"][1]["unknown"].is_string(), "{hosts:#}");
    c2.signal(Signal::CONT);
    assert!(wait_until(SOON, || estop_json(&here, &[]).0 == Some(0)).is_some());
}

/// In a team, every user can stop everything without a key, but only an operator can release it.
#[test]
fn in_a_team_everybody_stops_and_an_operator_releases() {
    let Some(network) = Network::new(1) else { return };
    let (cluster, team) = (Cluster::new(), MadeTeam::default());
    let host = cluster.host(&network, 1);
    team.admit(&host, "c1");
    let _node = host.node("c1", &[]);
    let (code, hosts) = estop_json(&host, &["smoke"]);
    assert_eq!(
        (code, hosts),
        (Some(0), json!({ "hosts": [{ "host": "c1", "stopped": true, "unended": [], "unwritten": null }] }))
    );
    let refused = host.ask(&["estop", "--release"]);
    assert_eq!(refused.code, Some(1), "{refused}");
    let status = host.ask(&["status"]);
    assert!(status.out.contains("everything was stopped by ") && status.out.contains(": smoke"), "{status}");
    let audit = host.ask(&["audit", "c1", "--state", &host.state().display().to_string()]);
    let lines: Vec<&str> = audit.out.lines().filter(|line| line.contains("everything was stopped by")).collect();
    assert!(matches!(&lines[..], [line] if line.contains("(not signed)")), "{audit}");
}
