//! Nodes after a reboot of their machine, with real processes: which missions run again. `--boot-id` replaces the boot.
//! The node is killed, and the next one is told that the machine has booted since, so it adopts no programs.

use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, wait_until};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// The longest time for a node to wait before it begins anything again, and then to do so.
const RESUMED: Duration = Duration::from_secs(60);

/// A program on each of two hosts.
fn spec(cluster: &Cluster, on_boot: &str) -> String {
    let text = format!(
        r#"
module Idle(host: Host) {{ exec "sleep 3600"; plain; done; }}
process main() {{
    host {{ c1 }}
    {on_boot}
    instantiated_processes {{ here instof Idle(c1); there instof Idle(c2) {{ on_link_loss keep; }} }}
    internal_event_actions {{ here , there }}
}}
"#
    );
    cluster.file("endless.dca", &text)
}

/// Deploys a spec, waits until it runs, and leaves it to its nodes.
fn deploy(here: &Host, spec: &str) -> BTreeMap<String, u32> {
    let deploy = here.dca(&["deploy", "--no-record", spec]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    let pids = here.pids();
    assert_eq!(pids.len(), 2);
    deploy.signal(Signal::KILL);
    pids
}

/// Waits until the events of the mission contain some words.
fn told(here: &Host, words: &str) {
    let said = || here.ask(&["events", "endless"]).out;
    assert!(wait_until(RESUMED, || said().contains(words)).is_some(), "{}", said());
}

fn kill(node: &Program) {
    node.signal(Signal::KILL);
    assert!(wait_until(SOON, || !node.is_running()).is_some());
}

/// Returns the files of deployments that a reboot would find.
fn kept(here: &Host, node: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(here.state().join(node).join("running")).into_iter().flatten();
    entries.map(|entry| entry.expect("it can be read").path()).collect()
}

fn names(here: &Host) -> Vec<String> {
    let parts = here.statuses(&[]).into_iter().flat_map(|node| node.deployments);
    parts.map(|part| part.deployment.to_string()).collect()
}

#[test]
fn a_mission_that_says_so_is_begun_again_and_a_stop_is_for_good() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (c1, _c2) = (here.node("c1", &["--boot-id", "first"]), here.node("c2", &[]));
    let before = deploy(&here, &spec(&cluster, "on_boot { resume }"));
    // It is still the same boot, so running programs are adopted.
    kill(&c1);
    let c1 = here.node("c1", &["--boot-id", "first"]);
    assert_eq!(here.pids(), before);
    kill(&c1);
    let c1 = here.node("c1", &["--boot-id", "second"]);
    told(&here, "its home was rebooted");
    assert!(wait_until(RESUMED, || here.pids().len() == 2).is_some(), "{:?}", names(&here));
    let after = here.pids();
    assert!(after.iter().all(|(path, pid)| before[path] != *pid), "{before:?} {after:?}");
    assert_eq!(names(&here), ["endless@2", "endless@2"]);
    assert_eq!(here.ask(&["stop", "endless"]).code, Some(0));
    assert!(wait_until(SOON, || kept(&here, "c1").is_empty()).is_some(), "nothing is left to be begun");
    kill(&c1);
    let _c1 = here.node("c1", &["--boot-id", "third"]);
    assert_eq!(names(&here), Vec::<String>::new());
}

/// A deployment that waits to be resumed is listed. A stop ends the waiting, even after another kill of the node.
#[test]
fn what_waits_is_listed_and_a_stop_ends_it() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (c1, _c2) = (here.node("c1", &["--boot-id", "first"]), here.node("c2", &[]));
    deploy(&here, &spec(&cluster, "on_boot { resume }"));
    kill(&c1);
    let c1 = here.node("c1", &["--boot-id", "second"]);
    let listed = || here.ask(&["status"]).out.contains("endless  waits to be resumed, in ");
    assert!(wait_until(SOON, listed).is_some(), "{}", here.ask(&["status"]));
    let refused = here.ask(&["stop", "endless", "--forget"]);
    assert!(refused.out.contains("forgotten") || refused.err.contains("`dca stop endless` ends that"), "{refused}");
    kill(&c1);
    let c1 = here.node("c1", &["--boot-id", "second"]);
    assert!(wait_until(SOON, listed).is_some(), "{}", here.ask(&["status"]));
    let stopped = here.ask(&["stop", "endless"]);
    assert_eq!((stopped.code, stopped.out.as_str()), (Some(0), "`endless` is stopped; nothing of it is left\n"));
    assert_eq!(kept(&here, "c1"), Vec::<PathBuf>::new(), "the disk has it");
    told(&here, "the deployment is not resumed: it was stopped before it ran");
    kill(&c1);
    let _c1 = here.node("c1", &["--boot-id", "third"]);
    let waiting: Vec<_> = here.statuses(&[]).into_iter().flat_map(|node| node.waiting).collect();
    assert_eq!((waiting.len(), here.pids().len()), (0, 0));
}

/// Without `on_boot` in the spec, a reboot ends the mission, and this is reported.
#[test]
fn a_mission_that_says_nothing_is_told_as_over() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (c1, _c2) = (here.node("c1", &["--boot-id", "first"]), here.node("c2", &[]));
    deploy(&here, &spec(&cluster, ""));
    assert_eq!(kept(&here, "c1").len(), 1);
    kill(&c1);
    let _c1 = here.node("c1", &["--boot-id", "second"]);
    told(&here, "its home was rebooted");
    assert!(wait_until(SOON, || kept(&here, "c1").is_empty()).is_some(), "it is forgotten");
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some(), "{:?}", here.pids());
}

/// A user stops a deployment while its home is away. The home hears of the stop from the others, and begins nothing.
#[test]
fn what_was_stopped_while_its_home_was_away_does_not_come_back() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (c1, c2) = (here.node("c1", &["--boot-id", "first"]), here.node("c2", &[]));
    deploy(&here, &spec(&cluster, "on_boot { resume }"));
    let answers = here.ask(&["stop", "endless", "--away", "c1"]);
    assert_eq!(answers.code, Some(1), "{answers}");
    assert!(answers.err.contains("`c1` answers: `dca stop endless` ends it there"), "{answers}");
    kill(&c1);
    let unknown = here.ask(&["stop", "other", "--away", "c1"]);
    assert_eq!(unknown.code, Some(1), "{unknown}");
    assert!(unknown.err.contains("knows of a deployment `other` with its home on `c1`"), "{unknown}");
    let stopped = wait_until(SOON, || here.ask(&["stop", "endless", "--away", "c1"]).code == Some(0));
    assert!(stopped.is_some(), "{}", here.ask(&["stop", "endless", "--away", "c1"]));
    // The holder of the tombstone also keeps it when it restarts.
    kill(&c2);
    let _c2 = here.node("c2", &[]);
    let _c1 = here.node("c1", &["--boot-id", "second"]);
    told(&here, "the deployment is not resumed: it was stopped while `c1` was away, as `c2` says");
    assert!(wait_until(SOON, || kept(&here, "c1").is_empty()).is_some());
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some(), "{:?}", here.pids());
}

#[test]
fn a_name_for_a_boot_is_a_word() {
    let cluster = Cluster::new();
    for bad in ["", "two words", "ä"] {
        let ended = cluster.here().start_node("c1", &["--boot-id", bad]).ended(SOON);
        assert_eq!(ended.code, Some(2), "{ended}");
        assert!(ended.err.contains("it must have 1 to 128 visible ASCII characters"), "{ended}");
    }
}
