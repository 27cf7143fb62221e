//! The record of a run from the view of a viewer: with the official reader, and by the record's own schemas.

use dca_tests::cluster::{Cluster, Ended, Stream, Trace, executable, wait_until};
use dca_tests::hit_detector;
use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;
use std::time::Duration;

/// The hand is not pushed. The output of the sensor goes to the threshold that compares it.
const SPEC: &str = concat!(
    "\n",
    hit_detector!("30 N"),
    r#"
process main(){
    host{c3}
    instantiated_processes{
        world instof DoorWorld(c3, push_at = 3600 s);
        hit instof HitDetector(c3);
    }
    internal_event_actions{
        world # hit # wait(2 s)
    }
}
"#
);

/// The recorded value on a port has the fields that its sender's interface names.
#[test]
fn a_recorded_port_can_be_plotted() {
    let cluster = Cluster::new();
    let file = cluster.file("force.dca", SPEC);
    let ended: Ended = cluster.here().dca(&["run", "--record", "force.Out", &file]).ended(Duration::from_secs(120));
    assert_eq!(ended.code, Some(0), "{ended}");
    let bytes = std::fs::read(cluster.folder().join("runs/force-1/run.mcap")).expect("there is a record");
    let (mut seen, mut schemas) = (0, BTreeSet::new());
    for message in mcap::MessageStream::new(&bytes).expect("it is a record") {
        let message = message.expect("it is whole");
        if !message.channel.topic.starts_with("/ports/") {
            continue;
        }
        let schema = message.channel.schema.as_ref().expect("a topic has a schema");
        assert_eq!(
            (schema.encoding.as_str(), message.channel.topic.as_str()),
            ("jsonschema", "/ports/main/hit/force/Out")
        );
        schemas.insert((schema.name.clone(), String::from_utf8_lossy(&schema.data).into_owned()));
        let data: Value = serde_json::from_slice(&message.data).expect("it is JSON");
        for field in ["force", "torque"] {
            let numbers = data[field].as_array().unwrap_or_else(|| panic!("no `{field}`: {data}"));
            assert!(numbers.len() == 3 && numbers.iter().all(Value::is_number), "{data}");
        }
        assert!(message.log_time > 1_500_000_000_000_000_000, "{} is not a time since 1970", message.log_time);
        seen += 1;
    }
    assert!(seen > 10, "{seen} values of a sensor that sends a hundred each second: {ended}");
    let schema = r#"{"properties":{"force":{"items":{"description":"Force","type":"number"},"type":"array"},"measured":{"description":"Time","type":"number"},"torque":{"items":{"description":"Torque","type":"number"},"type":"array"}},"title":"dca.types.Wrench","type":"object"}"#;
    assert_eq!(schemas.into_iter().collect::<Vec<_>>(), [("dca.types.Wrench".to_owned(), schema.to_owned())]);

    // A full disk leaves no partial page, and the message names the page. A limit of the shell replaces the full disk.
    let script = "trap '' XFSZ; ulimit -f 1; exec \"$0\" report runs/force-1 -o runs/page.html";
    let mut shell = Command::new("sh");
    let told = shell.args(["-c", script]).arg(executable("dca")).current_dir(cluster.folder()).output();
    let told = told.expect("there is a shell");
    let why = String::from_utf8_lossy(&told.stderr);
    assert!(told.status.code() == Some(1) && why.contains("page.html") && why.contains("too large"), "{why}");
    let left = std::fs::read_dir(cluster.folder().join("runs")).expect("runs are there").count();
    assert_eq!(left, 1, "nothing is left of it");
}

/// A controller is killed and restarted. The record contains its values from before and after.
#[test]
fn a_program_that_was_started_again_is_recorded_on() {
    let spec = "process main(){ host{c1} instantiated_processes{ source instof RateSource(c1);
                monitor instof RateMonitor(c1) { restart transient; } }
                internal_connections(source, lbl1){ source, Out -> monitor, In; }
                internal_event_actions{ (source[lbl1], monitor) # wait(8 s) } }";
    let cluster = Cluster::new();
    let file = cluster.file("again.dca", spec);
    let mission = cluster.here().dca(&["run", &file]);
    let shown = |folder: &std::path::Path| Trace::so_far(folder).signal("main/monitor", "received");
    let folder = cluster.folder().join("runs/again-1");
    let soon = Duration::from_secs(60);
    mission.wait_for(Stream::Err, "source", soon);
    wait_until(soon, || folder.join("run.mcap").exists() && !shown(&folder).is_empty()).expect("it shows its signals");
    cluster.expect_leaf("main/monitor").signal(Signal::KILL);
    let killed = Trace::so_far(&folder).signal("main/monitor", "received").last().map(|sample| sample.at);
    let ended = mission.ended(Duration::from_secs(120));
    assert_eq!(ended.code, Some(0), "{ended}");
    let last = shown(&folder).last().map(|sample| sample.at);
    let (killed, last) = (killed.expect("it was seen"), last.expect("it was seen"));
    // On a machine with other work, restarting and dialling takes at most a second.
    assert!(last > killed + Duration::from_millis(1500), "seen until {last:?}, killed after {killed:?}: {ended}");
}

/// A full disk does not end the mission, and does not damage the earlier part of the record. The exit code reports it.
#[test]
fn a_record_that_breaks_off_is_an_error() {
    let cluster = Cluster::new();
    let node = cluster.here().node("c3", &[]);
    // The mission records about 64 kB in a second, and writes them once a second. A limit of 128 kB in the shell replaces
    // the full disk.
    let file = cluster.file("force.dca", &SPEC.replace("wait(2 s)", "wait(4 s)"));
    let script = "trap '' XFSZ; ulimit -f 256; exec \"$0\" deploy --run-dir \"$1\" --record all \"$2\"";
    let told = Command::new("sh")
        .args(["-c", script])
        .arg(executable("dca"))
        .args([cluster.here().run_dir().as_os_str(), file.as_ref()])
        .current_dir(cluster.folder())
        .output()
        .expect("there is a shell");
    let why = String::from_utf8_lossy(&told.stderr);
    assert!(told.status.code() == Some(1), "{why}");
    // The line `the record breaks off here` appears only if the mission continues for long enough.
    assert!(why.contains("the mission is done, but its record or report is not complete"), "{why}");
    let folder = cluster.folder().join("runs/force-1");
    assert!(!Trace::so_far(&folder).is_empty(), "what came before is there");
    drop(node);
}
