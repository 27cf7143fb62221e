//! Activities with real processes: a lost host, orders from people, and a script that never ends by itself.

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

const SCRIPTS: &str = "
    activity Again(here: Host) {
        host{here}
        var n: opaque Number = ();
        initial state turning { on after 20 ms -> done { n = script { loop {} }; } }
    }
    activity Count(here: Host) {
        host{here}
        var n: 0..15 = 0;
        initial state counting {
            on every 20 ms when n < 15 { n += 1; log(\"count \" + n); }
            on always when n == 15 -> done;
        }
    }
    process main() {
        host{c1}
        instantiated_processes { again instof Again(c1); count instof Count(c1); }
        internal_event_actions { count , (retry(10) (again) else match { script_budget => skip }) }
    }";

/// A script that would loop for ever aborts its activity, again and again. The other activity of the node counts on, and
/// misses nothing. `dca run` shows only the first lines, so there are few.
#[test]
fn a_looping_script_disturbs_no_other_activity() {
    let cluster = Cluster::new();
    let ended = cluster.here().ask(&["run", &cluster.file("scripts.dca", SCRIPTS)]);
    assert_eq!(ended.code, Some(0), "{ended}");
    let why = "a script has used up its budget: line 1 of the script: more than 2000 operations";
    assert!(ended.err.matches(why).count() >= 10, "{ended}");
    let counts = ended.err.lines().filter_map(|line| line.split_once("says: count ")?.1.trim().parse().ok());
    assert_eq!(counts.collect::<Vec<u32>>(), (1..=15).collect::<Vec<u32>>(), "{ended}");
}
