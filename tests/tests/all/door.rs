//! The mission on one machine, with real processes and real time.

use dca_tests::cluster::{Cluster, Sample, Trace, Turn, executable, peak, spec};
use node::logic::protocol::Ending;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

const MISSION_MAX: Duration = Duration::from_secs(90);
const WORLD: &str = "main/world";

/// The door opens to 60 degrees or more. The hand hits with at most 30 N, opens with at most 60 N, and is at most 10
/// mm beside the handle. The exit code is 0, nothing is left, and there are a record and a page.
#[test]
fn the_door_opens() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let ended = cluster.here().dca(&["run", &spec("door_opening")]).ended(MISSION_MAX);
    assert_eq!(ended.code, Some(0), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));

    let trace = Trace::read(&cluster.folder().join("runs/door_opening-1"));
    assert!(trace.has_page());
    let (ending, took) = trace.finished();
    assert!(matches!(ending, Ending::Done(_)), "{ending:?}");
    let angle_deg = last(&trace.signal(WORLD, "door angle"));
    let beside = trace.signal(WORLD, "hand beside handle");
    let servo_end = trace.phase("visualserv").end.expect("it is over");
    let beside_mm = last(&beside.into_iter().filter(|sample| sample.at <= servo_end).collect::<Vec<_>>());
    let force = trace.signal(WORLD, "contact force");
    // The hand is at rest when it begins to open the door. The peak may come after `hit` has noticed the contact.
    let (hit, open) = (trace.phase("# hit"), trace.phase("dooropen"));
    let hit_peak = peak(&force, hit.begin, trace.phase("presshandle").begin);
    let open_peak = peak(&force, open.begin, open.end.expect("it is over"));
    println!("{angle_deg:.1} deg, {took:.1?}, hit {hit_peak:.1} N, open {open_peak:.1} N, beside {beside_mm:.1} mm");
    // A test on virtual time checks the duration of the mission. Here it depends on the load of the machine.
    assert!(angle_deg >= 60.0, "{angle_deg} deg after {took:?}");
    assert!(hit_peak <= 30.0 && open_peak <= 60.0, "hit {hit_peak} N, opening {open_peak} N");
    assert!(beside_mm <= 10.0, "{beside_mm} mm");
}

/// A locked door makes the mission abort with its reason and exit code 1. The arm is at rest and without load.
#[test]
fn a_locked_door_aborts() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let ended = cluster.here().dca(&["run", &spec("door_locked")]).ended(MISSION_MAX);
    assert_eq!(ended.code, Some(1), "{ended}");
    assert!(ended.out.contains("main ← dooropensyst ← dooropen ← model: locked"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));

    let trace = Trace::read(&cluster.folder().join("runs/door_locked-1"));
    let joints = (1..=6).map(|joint| format!("joint {joint} speed"));
    for name in joints.chain(["base speed".to_owned(), "base yaw rate".to_owned()]) {
        let speed = last(&trace.signal(WORLD, &name));
        println!("{name}: {speed:.4}");
        assert!(speed.abs() < 0.02, "{name} is {speed} at the end");
    }
    let axes = ["force x", "force y", "force z"].map(|axis| last(&trace.signal(WORLD, axis)));
    let force = axes.iter().map(|force| force.powi(2)).sum::<f64>().sqrt();
    println!("force at the end: {force:.1} N");
    // On a busy machine, the spring of a lever that is not quite up remains. It pushes back with less than this
    // force.
    assert!(force < 20.0, "the hand presses on with {force} N");
    let angle_deg = last(&trace.signal(WORLD, "door angle"));
    assert!(angle_deg.abs() < 0.5, "the door is at {angle_deg} deg");
}

fn last(samples: &[Sample]) -> f64 {
    samples.last().expect("the world publishes it").value
}

/// `language` checks and draws the door without starting programs, so it has a copy of the programs' interfaces.
#[test]
fn the_copy_of_the_interfaces_is_true() {
    let asked = Command::new(executable("dca-controller")).arg("--dca-interface").output().expect("it starts");
    let copy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../language/tests/graph/door_opening.interface");
    let copied = std::fs::read(copy).expect("it is there");
    assert!(
        asked.status.success() && asked.stdout == copied,
        "`dca-controller --dca-interface > language/tests/graph/door_opening.interface`, then UPDATE_EXPECT=1 for the tests \
         `graph` and `manual` of `language`"
    );
}
