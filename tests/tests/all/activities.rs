//! Activities with real processes: a lost host, and orders from people.

use dca_tests::cluster::{Cluster, Network, SOON, Stream, wait_until};
use rustix::process::Signal;

const GUARD: &str = "
    module Sleeper(host) { exec \"sleep 600\"; plain; done; }
    activity Guard(here: Host, far: Host) {
        host{here}
        away instof Sleeper(far);
        back instof Sleeper(here);
        initial state out { run away; on host far lost -> home; on done -> done; }
        state home { run back; on done -> done; }
        suspended state paused { on resume -> resume; }
        on suspend -> paused;
    }
    process main() {
        host{c1}
        instantiated_processes { guard instof Guard(c1, c2); }
        internal_event_actions { guard }
    }";

/// The robot of an activity is cut off while the activity works there. The activity goes home, is suspended there,
/// and continues.
#[test]
fn a_lost_host_sends_an_activity_home() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let nodes = [hosts[0].node("c1", &["--lan"]), hosts[1].node("c2", &["--lan"])];
    let mission = hosts[0].dca(&["deploy", &cluster.file("guard.dca", GUARD)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let runs = |path: &str, is_there: bool| {
        let seen = wait_until(SOON, || cluster.leaf(path).is_some() == is_there);
        assert!(seen.is_some(), "{path}: {}\n{}", hosts[0].ask(&["status"]), mission.text(Stream::Err));
    };
    runs("main/guard/away", true);
    network.cut(2);
    runs("main/guard/back", true);
    runs("main/guard/away", false);
    let told = hosts[0].ask(&["ctl", "guard", "guard", "suspend"]);
    assert_eq!((told.code, told.out.trim()), (Some(0), "`main/guard` has taken the order to suspend"), "{told}");
    runs("main/guard/back", false);
    assert_eq!(hosts[0].ask(&["ctl", "guard", "guard", "resume"]).code, Some(0));
    runs("main/guard/back", true);
    let stopped = hosts[0].ask(&["stop", "guard"]);
    assert!(stopped.code == Some(3) && stopped.err.contains("`c2` has not confirmed"), "{stopped}");
    let ended = mission.ended(SOON);
    assert_eq!(ended.code, Some(1), "{ended}");
    network.heal(2);
    for node in nodes {
        node.signal(Signal::TERM);
        assert_eq!(node.ended(SOON).code, Some(0));
    }
    cluster.expect_nothing_left(SOON);
}
