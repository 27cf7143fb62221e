//! The door on two levels, with real processes: its hardware is a separate deployment. In whatever way a mission ends,
//! the wheels stop, and the next mission can use them.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Ended, Host, Program, SOON, Stream, Turn, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::time::Duration;

/// The time for a mission. It includes waiting for a busy machine.
const MISSION: Duration = Duration::from_secs(150);
/// How long a command counts.
const WATCHDOG: Duration = Duration::from_millis(100);
/// The interval at which the plant checks its drives.
const PERIOD: Duration = Duration::from_millis(4);
/// The program of a mission that moves the base.
const DRIVER: &str = "main/dooropensyst/motionctrl/xr4000";

/// One node with the specs of the example. All hosts are this one.
struct Door {
    cluster: Cluster,
    host: Host,
    _node: Program,
    _turn: Turn,
}

impl Door {
    fn new() -> Self {
        let turn = Turn::take();
        let cluster = Cluster::new();
        let host = cluster.here();
        let node = host.node("c1", &[]);
        Self { cluster, host, _node: node, _turn: turn }
    }

    /// Returns a changed spec of the example under another name.
    fn spec(&self, example: &str, name: &str, change: impl FnOnce(String) -> String) -> String {
        let path = format!("{}/../examples/door/{example}.dca", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).unwrap().replace("\"c2\"", "\"c1\"").replace("\"c3\"", "\"c1\"");
        self.cluster.file(&format!("{name}.dca"), &change(text))
    }

    fn mission(&self, name: &str) -> String {
        self.spec("door_mission", name, |text| text)
    }

    /// Deploys a spec, and returns once it runs.
    fn deploy(&self, file: &str) -> Program {
        let deploy = self.host.dca(&["deploy", "--no-record", file]);
        deploy.wait_for(Stream::Err, "▸", SOON);
        deploy
    }

    fn hardware(&self) -> Program {
        self.deploy(&self.spec("door_hardware", "door_hardware", |text| text))
    }

    fn run(&self, file: &str) -> Ended {
        self.host.dca(&["deploy", "--no-record", file]).ended(MISSION)
    }

    fn base(&self) -> Value {
        let got = self.host.ask(&["get", "door_hardware:main/robot.base", "--within", "60"]);
        assert_eq!(got.code, Some(0), "{got}");
        serde_json::from_str(got.out.trim()).unwrap_or_else(|why| panic!("{why}: {got}"))
    }

    /// Waits until the base moves.
    #[track_caller]
    fn moves(&self) {
        assert!(wait_until(SOON, || speed(&self.base()) > 0.02).is_some(), "it stands: {}", self.base());
    }
}

/// Returns the speed of the base along the floor (m/s).
fn speed(base: &Value) -> f64 {
    let along = |axis: usize| base["velocity"][axis].as_f64().unwrap_or_else(|| panic!("no velocity in {base}"));
    along(0).hypot(along(1))
}

fn number(base: &Value, name: &str) -> f64 {
    base[name].as_f64().unwrap_or_else(|| panic!("no `{name}` in {base}"))
}

/// Two missions, one after the other, open the door with the same hardware. The hardware is not restarted. Between the
/// missions, a person shuts the door.
#[test]
#[ignore = "long: two doors"]
fn the_hardware_outlives_missions_that_open_the_door() {
    let door = Door::new();
    let mission = door.mission("door_mission");
    let early = door.run(&mission);
    let why = "`main/robot` runs in another deployment: no deployment `door_hardware` runs there; deploy it first";
    assert!(early.code == Some(1) && early.out.contains(why), "{early}");
    let _hardware = door.hardware();
    let pid = door.host.pids()["main/robot"];
    for number_of in 1..=2 {
        let done = door.run(&mission);
        assert_eq!(done.code, Some(0), "{number_of}: {done}");
        let base = door.base();
        println!("mission {number_of}: {base}");
        // On a busy machine, the last command of a mission, for rest, may arrive after the mission has released the lock.
        assert!(number(&base, "refused") < f64::from(number_of) + 0.5, "a mission's commands are refused: {base}");
        let reset = || door.host.ask(&["call", "door_hardware:main/robot.Reset", "--within", "60"]).code == Some(0);
        assert!(wait_until(SOON, reset).is_some(), "the devices are free again: {}", door.base());
    }
    assert_eq!(door.host.pids()["main/robot"], pid, "the hardware was never started again");
}

/// The program that moves the base is killed or suspended. The watchdog stops the wheels, and the base is free after
/// the lease.
#[test]
fn the_wheels_stop_when_a_mission_is_killed_in_the_middle() {
    let door = Door::new();
    let _hardware = door.hardware();
    let mission = door.mission("door_mission");
    for (what, signal) in [("killed", Signal::KILL), ("suspended", Signal::STOP)] {
        let running = door.deploy(&mission);
        door.moves();
        let driver = door.cluster.expect_leaf(DRIVER);
        let (before, began) = (number(&door.base(), "stopped"), now());
        driver.signal(signal);
        let mut base = Value::Null;
        let stopped = wait_until(SOON, || {
            base = door.base();
            number(&base, "stopped") > before
        });
        assert!(stopped.is_some(), "{what}: it goes on: {base}");
        let after = Duration::from_secs_f64(number(&base, "stopped") - number(&base, "commanded"));
        assert!(after <= WATCHDOG + PERIOD, "{what}: {after:?} after the last command: {base}");
        assert!(wait_until(SOON, || speed(&door.base()) < 1e-3).is_some(), "{what}: it rolls on: {}", door.base());
        let free = wait_until(SOON, || door.base()["holder"] == "");
        assert!(free.is_some(), "{what}: somebody holds it: {}", door.base());
        println!("{what}: the wheels are stopped {after:?} after the last command, free {:?} later", now() - began);
        driver.signal(Signal::CONT);
        door.host.ask(&["stop", "door_mission"]);
        assert_eq!(running.ended(SOON).code, Some(1), "{what}");
        let reset = || door.host.ask(&["call", "door_hardware:main/robot.Reset", "--within", "60"]).code == Some(0);
        assert!(wait_until(SOON, reset).is_some(), "{what}: the devices are free again: {}", door.base());
    }
}

/// A second mission is told who holds the robot. A mission with a greater priority takes the robot, and the first
/// mission says why it ends.
#[test]
fn a_second_mission_is_refused_and_one_with_a_greater_priority_is_not() {
    let door = Door::new();
    let _hardware = door.hardware();
    let pid = door.host.pids()["main/robot"];
    let first = door.deploy(&door.mission("door_mission"));
    door.moves();
    let second = door.run(&door.mission("other"));
    let held = "is held by `door_mission:main/dooropensyst/motionctrl/";
    assert!(second.code == Some(1) && second.out.contains(held), "{second}");
    assert!(first.is_running(), "{}", first.text(Stream::Err));
    let reset = door.host.ask(&["call", "door_hardware:main/robot.Reset", "--within", "60"]);
    assert!(reset.code == Some(1) && reset.err.contains(&format!("the base {held}")), "{reset}");
    let rescue = door.spec("door_mission", "rescue", |text| {
        assert!(text.contains("XR4000Ctrl(host2)") && text.contains("Puma560Ctrl(host1)"));
        text.replace("XR4000Ctrl(host2)", "XR4000Ctrl(host2, priority = 5)")
            .replace("Puma560Ctrl(host1)", "Puma560Ctrl(host1, priority = 5)")
    });
    let rescue = door.deploy(&rescue);
    let ended = first.ended(SOON);
    let why = "a client with a higher priority has taken the lock";
    assert!(ended.code == Some(1) && ended.out.contains(why), "{ended}");
    let holds = || door.base()["holder"] == format!("rescue:{DRIVER}");
    assert!(wait_until(SOON, holds).is_some(), "{}", door.base());
    let stop = door.host.ask(&["stop", "rescue"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(rescue.ended(SOON).code, Some(1));
    assert!(wait_until(SOON, || door.base()["holder"] == "").is_some(), "{}", door.base());
    assert_eq!(door.host.pids()["main/robot"], pid);
}
