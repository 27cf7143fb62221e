//! Hardware in a separate deployment. Missions come and go, and the server of the base stays. In whatever way a pilot
//! ends, the wheels stop 100 ms after its last command.

#![expect(clippy::print_stdout, reason = "a test says how long it took")]
#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock::now;
use comms::logic::time::Time;
use dca_tests::cluster::{Cluster, Host, Network, Process, Program, SOON, Stream, executable, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::time::Duration;

/// How long the wheels continue to turn after the last command.
const WATCHDOG: Duration = Duration::from_millis(100);
/// The interval at which the base checks the wheels.
const PERIOD: Duration = Duration::from_millis(5);

/// The files of the example. A mission that runs until it is stopped has a long way.
struct Example {
    hardware: String,
    mission: String,
    endless: String,
    program: String,
}

impl Example {
    fn new(cluster: &Cluster) -> Self {
        let folder = format!("{}/../examples/hardware", env!("CARGO_MANIFEST_DIR"));
        let read = |name: &str| std::fs::read_to_string(format!("{folder}/{name}.dca")).unwrap();
        let mission = read("mission");
        assert!(mission.contains("distance = 1 m"));
        let endless = mission.replace("distance = 1 m", "distance = 100000 m");
        Self {
            hardware: cluster.file("hardware.dca", &read("hardware")),
            mission: cluster.file("mission.dca", &mission),
            endless: cluster.file("endless.dca", &endless),
            program: executable("dca-examples").display().to_string(),
        }
    }

    fn deploy(&self, host: &Host, file: &str) -> Program {
        let deploy = host.dca(&["deploy", "--no-record", "--controllers", &self.program, file]);
        deploy.wait_for(Stream::Err, "▸", SOON);
        deploy
    }
}

/// Returns the state of the base, under the name that the mission has for it.
fn motion(host: &Host) -> Value {
    let got = host.ask(&["get", "base.motion", "--within", "60"]);
    assert_eq!(got.code, Some(0), "{got}");
    serde_json::from_str(got.out.trim()).unwrap_or_else(|why| panic!("{why}: {got}"))
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

fn number(motion: &Value, name: &str) -> f64 {
    motion[name].as_f64().unwrap_or_else(|| panic!("no `{name}` in {motion}"))
}

fn seconds(time: Time) -> f64 {
    time.since(Time::ZERO).as_secs_f64()
}

#[track_caller]
fn moves(host: &Host) {
    let moves = || number(&motion(host), "speed") > 0.0;
    assert!(wait_until(SOON, moves).is_some(), "it stands: {}", motion(host));
}

/// Disturbs a pilot while it drives. The wheels stop after the time of the watchdog plus at most one check of the last
/// command. A busy machine may delay the loop of the base. The base then checks later, and reports the delay. A command
/// in transit at that moment still counts.
fn stops(what: &str, host: &Host, act: impl FnOnce()) {
    moves(host);
    let before = seconds(now());
    act();
    let mut last = Value::Null;
    let is_over = || {
        last = motion(host);
        number(&last, "speed") == 0.0 && number(&last, "stopped") > before
    };
    assert!(wait_until(SOON, is_over).is_some(), "{what}: it goes on: {last}");
    let since = |from: f64| Duration::from_secs_f64(number(&last, "stopped") - from);
    let (after_it, after_command) = (since(before), since(number(&last, "commanded")));
    let pause = Duration::from_secs_f64(number(&last, "pause"));
    println!(
        "{what}: the wheels stand {after_it:?} after it, {after_command:?} after the last command; looks {pause:?} apart"
    );
    let bound = WATCHDOG + PERIOD.max(pause) + Duration::from_micros(1);
    assert!(after_command <= bound, "{what}: {after_command:?} after the last command, {bound:?} at most: {last}");
}

fn pilot(cluster: &Cluster) -> Process {
    cluster.expect_leaf("main/pilot")
}

/// Missions end, are stopped, and begin again, while the hardware always remains the same program.
#[test]
fn missions_come_and_go_and_the_hardware_stays() {
    let cluster = Cluster::new();
    let (here, example) = (cluster.here(), Example::new(&cluster));
    let _node = here.node("c1", &["--controllers", &example.program]);
    let early = here.ask(&["deploy", "--no-record", "--controllers", &example.program, &example.mission]);
    let why = "host `c1`: `main/base` runs in another deployment: no deployment `hardware` runs there; deploy it first";
    assert!(early.code == Some(1) && early.out.contains(why), "{early}");
    let _hardware = example.deploy(&here, &example.hardware);
    let pid = here.pids()["main/base"];
    // A pilot ends on its own.
    let done =
        here.dca(&["deploy", "--no-record", "--controllers", &example.program, &example.mission]).ended(SOON * 2);
    assert_eq!(done.code, Some(0), "{done}");
    assert!(number(&motion(&here), "travelled") >= 1.0);
    // A pilot is stopped while the next one waits for the lock.
    let endless = example.deploy(&here, &example.endless);
    moves(&here);
    let lock = |name: &str| json(&here.ask(&["lock", name, "--json", "--within", "60"]).out);
    let held = &lock("hardware:main/base")[0];
    assert!(held["name"] == "lock" && held["holder"].is_string() && held["fence"].is_u64(), "{held}");
    let read = json(&here.ask(&["get", "base.lock", "--within", "60"]).out);
    assert_eq!(read["holder"], held["holder"], "{read}");
    let next = example.deploy(&here, &example.mission);
    let before = number(&motion(&here), "travelled");
    let waits = here.dca(&["lock", "base.lock", "--watch", "--json", "--within", "60"]);
    waits.wait_for(Stream::Out, "\"waiting\":[\"", SOON);
    drop(waits);
    let stop = here.ask(&["stop", "endless"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(endless.ended(SOON).code, Some(1), "it was stopped");
    assert_eq!(next.ended(SOON * 2).code, Some(0), "it has the lock, and drives");
    assert!(number(&motion(&here), "travelled") >= before + 1.0 - 1e-9);
    assert_eq!(here.pids()["main/base"], pid, "the hardware was never started again");
    // The hardware ends. A mission that watches it aborts, and reports the reason.
    let last = example.deploy(&here, &example.endless);
    moves(&here);
    let stop = here.ask(&["stop", "hardware"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    let ended = last.ended(SOON);
    assert!(
        ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains("was not there any more"),
        "{ended}"
    );
}

/// One pilot is killed, and another is suspended. The next pilot gets the wheels after the lease. Later commands of the
/// suspended pilot are refused.
#[test]
fn the_wheels_stop_whatever_becomes_of_who_drives() {
    let cluster = Cluster::new();
    let (here, example) = (cluster.here(), Example::new(&cluster));
    let _node = here.node("c1", &["--controllers", &example.program]);
    let _hardware = example.deploy(&here, &example.hardware);
    let killed = example.deploy(&here, &example.endless);
    moves(&here);
    let driver = pilot(&cluster);
    stops("killed with SIGKILL", &here, || driver.signal(Signal::KILL));
    assert_eq!(killed.ended(SOON).code, Some(1));
    let suspended = example.deploy(&here, &example.endless);
    moves(&here);
    let asleep = pilot(&cluster);
    stops("suspended", &here, || asleep.signal(Signal::STOP));
    // The next mission drives while the first pilot sleeps, and is done.
    let next = cluster.file("next.dca", &std::fs::read_to_string(&example.mission).unwrap());
    let done = here.dca(&["deploy", "--no-record", "--controllers", &example.program, &next]).ended(SOON * 2);
    assert_eq!(done.code, Some(0), "{done}");
    asleep.signal(Signal::CONT);
    moves(&here);
    drop(suspended);
}

/// The pilot is on another host, and the link to it is cut.
#[test]
fn the_wheels_stop_when_the_pilot_is_cut_off() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let example = Example::new(&cluster);
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let open = ["--lan", "--controllers", example.program.as_str()];
    let _nodes = [hosts[0].node("c1", &open), hosts[1].node("c2", &open)];
    let _hardware = example.deploy(&hosts[0], &example.hardware);
    let text = std::fs::read_to_string(&example.endless).unwrap().replace("Pilot(c1", "Pilot(c2");
    let _mission = example.deploy(&hosts[0], &cluster.file("far.dca", &text));
    stops("cut off", &hosts[0], || network.cut(2));
}

/// `dca check` compares a mission with the spec of its hardware.
#[test]
fn a_mission_is_checked_against_its_hardware() {
    let cluster = Cluster::new();
    let (here, example) = (cluster.here(), Example::new(&cluster));
    let check =
        |hardware: &str| here.ask(&["check", &example.mission, "--with", hardware, "--controllers", &example.program]);
    let checked = check(&example.hardware);
    assert!(checked.code == Some(0) && checked.out.contains("no errors"), "{checked}");
    let other = std::fs::read_to_string(&example.hardware).unwrap().replace("base", "legs");
    std::fs::write(&example.hardware, other).unwrap();
    let checked = check(&example.hardware);
    let why = "`main/base` runs in another deployment: `hardware` runs no `main/base`";
    assert!(checked.code == Some(1) && checked.err.contains(why), "{checked}");
    let checked = check(&example.endless);
    assert!(checked.code == Some(1) && checked.err.contains("the spec uses no process of `endless`"), "{checked}");
}
