//! `dca replay`: a record replaces the processes whose values it contains.

use dca_tests::cluster::{Cluster, executable};
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

const SOON: Duration = Duration::from_secs(120);

/// Returns a spec of a source, a controller, and a sink that writes down the received values.
fn spec(file: &Path, end: &str) -> String {
    format!(
        "process main() {{
            host {{ c1 }}
            instantiated_processes {{
                source instof Source(c1);
                pass instof Pass(c1, fails_at = 0);
                sink instof Sink(c1, file = \"{}\");
            }}
            internal_connections {{ source, Out -> pass, In queue 5000; pass, Out -> sink, In queue 5000; }}
            internal_event_actions {{ {end} }}
        }}",
        file.display()
    )
}

/// Returns the recorded numbers of an output as runs: `1-70 72-80`.
fn recorded(record: &Path, topic: &str) -> String {
    let bytes = std::fs::read(record).expect("there is a record");
    let mut runs: Vec<(u64, u64)> = Vec::new();
    for message in mcap::MessageStream::new(&bytes).expect("it is a record") {
        let message = message.expect("it is whole");
        if message.channel.topic != topic {
            continue;
        }
        let data: Value = serde_json::from_slice(&message.data).expect("it is JSON");
        for number in numbers(data["bytes"].as_str().expect("its type is not known")) {
            match runs.last_mut() {
                Some((_, last)) if *last + 1 == number => *last = number,
                _ => runs.push((number, number)),
            }
        }
    }
    let runs: Vec<String> = runs.iter().map(|(first, last)| format!("{first}-{last}")).collect();
    runs.join(" ")
}

/// Reads a list of numbers from the text in a record.
fn numbers(text: &str) -> Vec<u64> {
    const DIGITS: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let digits = text.chars().filter_map(|sign| DIGITS.find(sign));
    let bits = digits.fold(String::new(), |mut bits, digit| {
        write!(bits, "{digit:06b}").expect("a text takes all");
        bits
    });
    let octets = (0..bits.len() / 8).map(|at| u8::from_str_radix(&bits[8 * at..8 * at + 8], 2).expect("eight bits"));
    postcard::from_bytes(&octets.collect::<Vec<u8>>()).expect("a list of numbers")
}

#[test]
fn a_controller_gets_the_recorded_values_again() {
    let cluster = Cluster::new();
    let controllers = executable("dca-counting").display().to_string();
    let folder = cluster.folder();
    let (first, second) = (folder.join("first"), folder.join("second"));
    let file = cluster.file("count.dca", &spec(&first, "(source, pass, sink) # wait(2 s)"));
    let recording = ["run", "--controllers", &controllers, "--record", "all", &file];
    let ended = cluster.here().dca(&recording).ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    let heard = std::fs::read_to_string(&first).expect("it was stopped");
    assert!(heard.starts_with("1-"), "no value is lost at a common start: {heard}");
    let record = folder.join("runs/count-1/run.mcap");
    let sent = recorded(&record, "/ports/main/source/Out");
    assert!(sent.contains('-'), "{sent}: {ended}");

    // The spec has no end of its own. The record determines the end.
    let file = cluster.file("again.dca", &spec(&second, "source, pass, sink"));
    let replaying = ["replay", "--controllers", &controllers, "--rate", "2", "runs/count-1", &file];
    let ended = cluster.here().dca(&replaying).ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(std::fs::read_to_string(&second).expect("it was stopped"), sent, "{ended}");
    assert!(
        ended.err.contains("plays main/source.Out: ") && ended.err.contains("does not play main/pass.Out: "),
        "{ended}"
    );
    cluster.expect_nothing_left(Duration::from_secs(5));

    // A record that was cut off is reported, and its whole part is played.
    let bytes = std::fs::read(&record).expect("there is a record");
    let cut = cluster.folder().join("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() * 3 / 4]).expect("the folder is the test's own");
    let replaying = ["replay", "--controllers", &controllers, "--rate", "10", "--ports", "pass.Out", "cut.mcap", &file];
    let ended = cluster.here().dca(&replaying).ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.err.contains("cut.mcap` is not whole") && ended.err.contains("plays main/pass.Out: "), "{ended}");
    assert!(ended.err.contains("does not play main/source.Out: "), "{ended}");

    for (words, why) in [
        (&["--ports", "sink.Out"][..], "the record has no values of an output `sink.Out` of this spec"),
        (&["--rate", "0"], "it is from 0.01 to 100"),
    ] {
        let refused =
            cluster.here().dca(&[&["replay", "--controllers", &controllers, "runs/count-1", &file], words].concat());
        let ended = refused.ended(SOON);
        assert!(ended.code != Some(0) && ended.err.contains(why), "{ended}");
    }
}
