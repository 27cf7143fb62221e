//! `kill -9` of any one controller, once for each of the twenty-two. The mission ends according to the rules, reports
//! the reason, and leaves nothing behind.
//!
//! `mission::killing_any_controller_ends_the_mission_with_its_name` kills each of them on virtual time. Here they are
//! real programs: two in the quick tests, the others in the long ones.

use dca_tests::cluster::{Cluster, Ended, Program, SOON, Stream, Trace, Turn, spec, wait_until};
use node::logic::protocol::{Change, Ending, FailureCause};
use rustix::process::Signal;
use std::time::Duration;

const MISSION_MAX: Duration = Duration::from_secs(90);
const SERVO: &str = "▸ (visualserv # distdetect)";
const APPROACH: &str = "▸ ((opengrip, approach) # hit)";

/// Starts the mission. It kills the program of `leaf` once `line` has appeared on standard error `times` times. The
/// first line is at the beginning of a phase, and the next one comes 2 s later.
fn kill(cluster: &Cluster, leaf: &str, line: &str, times: usize) -> Program {
    let mission = cluster.here().dca(&["run", &spec("door_opening")]);
    mission.wait_for_times(Stream::Err, line, times, MISSION_MAX);
    let program = cluster.expect_leaf(leaf);
    program.signal(Signal::KILL);
    mission
}

fn trace(cluster: &Cluster) -> Trace {
    Trace::read(&cluster.folder().join("runs/door_opening-1"))
}

/// Kills `leaf` while it is active.
#[track_caller]
fn check(leaf: &str, line: &str, times: usize) {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let ended = kill(&cluster, leaf, line, times).ended(SOON);
    check_chain(&ended, leaf);
    cluster.expect_nothing_left(Duration::from_secs(2));
    let trace = trace(&cluster);
    let changes = trace.changes(leaf);
    let killed =
        |change: &Change| matches!(change, Change::Ended(Ending::Aborted(why)) if why.cause == FailureCause::Signal(9));
    assert!(changes.iter().any(|change| killed(change)), "{leaf}: {changes:?}");
    assert!(changes.contains(&&Change::Activated), "{leaf} was active: {changes:?}");
}

fn check_chain(ended: &Ended, leaf: &str) {
    let chain = format!("{}: SIGKILL (external) at ", leaf.split('/').collect::<Vec<_>>().join(" ← "));
    assert!(ended.code == Some(1) && ended.out.contains(&chain), "{leaf}: expected `{chain}…`\n{ended}");
}

#[test]
#[ignore = "long: real doors"]
fn while_it_servos() {
    let services = ["world", "dooropensyst/motionctrl/xr4000", "dooropensyst/motionctrl/puma"];
    let tasks = ["visualserv", "distdetect/laser", "distdetect/threshold", "motionctrl/redundancy"];
    for leaf in services.map(str::to_owned).into_iter().chain(tasks.map(|task| format!("dooropensyst/{task}"))) {
        check(&format!("main/{leaf}"), SERVO, 2);
    }
}

#[test]
fn the_sensor_of_a_detector() {
    check("main/dooropensyst/distdetect/laser", SERVO, 2);
}

#[test]
#[ignore = "long: real doors"]
fn while_it_approaches() {
    for leaf in ["approach", "hit/force", "hit/threshold"] {
        check(&format!("main/dooropensyst/{leaf}"), APPROACH, 2);
    }
}

#[test]
#[ignore = "long: real doors"]
fn while_it_grasps() {
    for leaf in ["closegrip/force", "closegrip/compliant", "closegrip/fingers"] {
        check(&format!("main/dooropensyst/{leaf}"), "▸ closegrip", 1);
    }
    check("main/dooropensyst/presshandle", "▸ presshandle", 1);
}

fn opening(leaves: &[&str]) {
    for leaf in leaves {
        check(&format!("main/dooropensyst/dooropen/{leaf}"), "▸ dooropen", 2);
    }
}

#[test]
#[ignore = "long: real doors"]
fn while_its_sensors_open_the_door() {
    opening(&["force", "xr4000", "puma"]);
}

#[test]
#[ignore = "long: real doors"]
fn while_its_laws_open_the_door() {
    opening(&["compliant", "model", "config", "add"]);
}

/// In the last case, the hand does not open. `opengrip , approach` notices this only once `approach` has also ended,
/// and `hit` comes first, so by the rules the mission continues. If the hand was already open, the door opens. If the
/// program was killed before, the grasp reports that it holds nothing.
#[test]
#[ignore = "long: real doors"]
fn while_the_hand_opens() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let leaf = "main/dooropensyst/opengrip";
    let ended = kill(&cluster, leaf, APPROACH, 1).ended(MISSION_MAX);
    let has_nothing = ended.out.contains("the gripper closed on nothing");
    assert_eq!(ended.code, Some(i32::from(has_nothing)), "{ended}");
    assert!(ended.err.contains("! dooropensyst/opengrip aborted: SIGKILL (external)"), "{ended}");
    assert!(ended.out.contains("dooropensyst/opengrip aborted: SIGKILL (external)"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
}

/// The death of a program that is not yet active is noticed only at its turn. Then the mission ends. On a busy machine, a law may give
/// up in an earlier phase. This shows nothing about the rule, so the mission is flown again.
#[test]
#[ignore = "long: a real door"]
fn before_its_turn() {
    let _turn = Turn::take();
    let (leaf, phase) = ("main/dooropensyst/closegrip/fingers", "✓ ((opengrip, approach) # hit)");
    for _ in 0..3 {
        let cluster = Cluster::new();
        let ended = kill(&cluster, leaf, SERVO, 1).ended(MISSION_MAX);
        cluster.expect_nothing_left(Duration::from_secs(2));
        let trace = trace(&cluster);
        let changes = trace.changes(leaf);
        assert!(changes.contains(&&Change::Died(FailureCause::Signal(9))), "{changes:?}");
        if ended.err.contains(phase) {
            return check_chain(&ended, leaf);
        }
        println!("flown again: {ended}");
    }
    panic!("no mission has come to `{phase}`");
}

/// A program is no longer needed after its turn, so the door opens.
#[test]
#[ignore = "long: real doors"]
fn after_its_turn() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let leaf = "main/dooropensyst/visualserv";
    let mission = kill(&cluster, leaf, APPROACH, 2);
    wait_until(SOON, || cluster.leaf(leaf).is_none()).expect("a killed program ends");
    let ended = mission.ended(MISSION_MAX);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.out.starts_with("door_opening: done") && ended.out.contains("SIGKILL"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
}
