//! Each example runs with real processes, as its page describes.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use dca_tests::cluster::{Cluster, Ended, executable};
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// The time for a mission. It includes waiting for a busy machine.
const MISSION: Duration = Duration::from_secs(120);

fn folder(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "..", "examples", name].iter().collect()
}

/// Runs a changed spec of an example in the test's own folder. The files beside the spec are copied.
fn run(name: &str, change: impl FnOnce(String, &Cluster) -> String) -> Ended {
    let cluster = Cluster::new();
    for entry in std::fs::read_dir(folder(name)).unwrap() {
        let file = entry.unwrap().path();
        std::fs::copy(&file, cluster.folder().join(file.file_name().unwrap())).unwrap();
    }
    let spec = format!("{name}.dca");
    let text = std::fs::read_to_string(cluster.folder().join(&spec)).unwrap();
    cluster.file(&spec, &change(text, &cluster));
    let program = executable("dca-examples").display().to_string();
    let ended = cluster.here().dca(&["run", "--controllers", &program, &spec]).ended(MISSION);
    cluster.expect_nothing_left(Duration::from_secs(30));
    ended
}

#[track_caller]
fn check_done(ended: &Ended, name: &str) {
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.out.contains(&format!("{name}: done")), "{ended}");
    assert!(!ended.err.contains("error["), "{ended}");
}

/// The old text must occur. Otherwise, the test would test something else.
#[track_caller]
fn changed(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "no `{from}` in\n{text}");
    text.replace(from, to)
}

#[test]
fn a_pid_loop_brings_a_motor_to_its_speeds() {
    check_done(&run("pid", |text, _| text), "pid");
    // Without gain, the motor does not move, and the deadline reports this.
    let stands = run("pid", |text, _| {
        let text = changed(&text, "kp = 0.05, ki = 0.5", "kp = 0, ki = 0, kd = 0");
        changed(&text, "slow[goal] within 10 s", "slow[goal] within 1 s")
    });
    assert_eq!(stands.code, Some(1), "{stands}");
}

/// Each question gets its own answer, or a reason why it has none, with real processes.
#[test]
fn questions_have_their_answers() {
    check_done(&run("requests", |text, _| text), "requests");
    let slow = run("requests", |text, _| {
        let text = changed(&text, "pace = 10 ms", "pace = 100 s");
        changed(&text, "count = 5);", "count = 5, patience = 0.5 s);")
    });
    assert!(slow.code == Some(1) && slow.err.contains("no answer came in time"), "{slow}");
    let unheard = run("requests", |text, _| {
        let text = changed(&text, "        planner, Answers -> ann, Answers;\n", "");
        changed(&text, "count = 5);", "count = 5, patience = 0.5 s);")
    });
    assert!(unheard.code == Some(1) && unheard.err.contains("no answer came in time"), "{unheard}");
    let unasked = run("requests", |text, _| changed(&text, "        ann, Questions -> planner, Questions;\n", ""));
    assert!(unasked.code == Some(1) && unasked.err.contains("there is no queue"), "{unasked}");
}

/// The queue is smaller than the number of orders. Rejected orders are sent again, and each order is carried out once.
#[test]
fn orders_wait_in_a_queue() {
    check_done(&run("post", |text, _| text), "post");
}

/// A guest hears an answer to each word, and the bell gets a receipt from the activity. Without a wire for the answers, the guest
/// waits.
#[test]
fn programs_talk_to_an_activity() {
    check_done(&run("talk", |text, _| text), "talk");
    let unheard = run("talk", |text, _| {
        let text = changed(&text, "        shop.say -> guest.Heard;\n", "");
        changed(&text, "(guest ; bell)", "(guest within 1 s else bell)")
    });
    check_done(&unheard, "talk");
}

/// A program built on the exports of another program takes its place. Other programs notice only the speed.
#[test]
fn a_guard_takes_the_place_of_the_wheels() {
    check_done(&run("levels", |text, _| text), "levels");
    check_done(
        &run("levels", |text, _| changed(&text, "base instof GuardedBase();", "base instof Wheels(c1);")),
        "levels",
    );
    let refused = run("levels", |text, _| {
        changed(
            &changed(&text, "speed = 2 m/s", "speed = 20 m/s"),
            "base instof GuardedBase();",
            "base instof Wheels(c1);",
        )
    });
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(refused.out.contains("20 m/s is not a speed of these wheels"), "{refused}");
}

#[test]
fn what_jams_is_cleared_and_tried_again() {
    check_done(&run("machines", |text, _| text), "machines");
    // This makes one attempt and four repetitions. The sixth attempt would have succeeded.
    let jammed = run("machines", |text, _| changed(&text, "jams = 2", "jams = 5"));
    assert_eq!(jammed.code, Some(1), "{jammed}");
    assert!(jammed.out.contains("it was jammed"), "{jammed}");
}

#[test]
fn programs_of_other_languages_take_part() {
    if !Command::new("python3").arg("--version").output().is_ok_and(|version| version.status.success()) {
        println!("skipped: there is no python3");
        return;
    }
    check_done(&run("python", |text, _| text), "python");
    let failed = run("python", |text, _| changed(&text, "failures = 2", "failures = 4"));
    assert_eq!(failed.code, Some(1), "{failed}");
}

#[test]
fn a_driver_reads_a_serial_port() {
    let own = |text: String, cluster: &Cluster| {
        changed(&text, "/tmp/dca-example-thermometer", &cluster.folder().join("tty").display().to_string())
    };
    check_done(&run("serial", own), "serial");
    // No device is plugged in.
    let empty = run("serial", |text, cluster| changed(&own(text, cluster), "device, thermometer", "thermometer"));
    assert_eq!(empty.code, Some(1), "{empty}");
    assert!(empty.out.contains("cannot open the serial port"), "{empty}");
}

#[test]
fn a_base_patrols_until_its_battery_is_low() {
    let ended = run("patrol", |text, _| text);
    check_done(&ended, "patrol");
    // The robot went farther than the first place and came back. The last row of the summary is the way to the dock.
    let flat = run("patrol", |text, _| changed(&text, "threshold = 55", "threshold = 1"));
    assert_eq!(flat.code, Some(1), "{flat}");
    assert!(flat.out.contains("the battery is empty"), "{flat}");
}

/// Each example has a page, and the manual lists the page.
#[test]
fn the_manual_lists_every_example() {
    let manual = include_str!("../../../docs/src/examples.md");
    for entry in std::fs::read_dir(folder(".")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if folder(&name).join(format!("{name}.dca")).is_file() {
            assert!(folder(&name).join("README.md").is_file(), "examples/{name} has no page");
            assert!(manual.contains(&format!("examples/{name}")), "docs/src/examples.md does not name {name}");
        }
    }
}
