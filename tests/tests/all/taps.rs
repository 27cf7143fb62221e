//! The values of outputs while programs run: `dca echo` and `dca hz`.

use dca_tests::cluster::{Cluster, Host, SOON, Stream};
use rustix::process::Signal;
use serde_json::Value;

/// A source of 100 values each second, without a reader while the wire is closed, and a source that never runs.
const BEATS: &str = "
process main() {
    host { \"c1\" }
    instantiated_processes {
        beat instof RateSource(\"c1\") { restart permanent; }
        quiet instof RateSource(\"c1\");
        monitor instof RateMonitor(\"c1\");
    }
    internal_connections(beat, on) { beat, Out -> monitor, In; }
    internal_connections(quiet, on) { quiet, Out -> monitor, In; }
    internal_event_actions { beat , monitor ; quiet }
}
";

fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {line}"))).collect()
}

fn deployed(cluster: &Cluster) -> (Host, [dca_tests::cluster::Program; 2]) {
    let here = cluster.here();
    let node = here.node("c1", &[]);
    let deploy = here.dca(&["deploy", "--no-record", &cluster.file("beats.dca", BEATS)]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    (here, [node, deploy])
}

/// Every value is shown with its number and its time, in order. The last line marks the end.
#[test]
fn values_are_echoed_with_their_numbers() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let echoed = here.ask(&["echo", "beat.Out", "-n", "20", "--json"]);
    assert_eq!(echoed.code, Some(0), "{echoed}");
    let lines = lines(&echoed.out);
    let (end, values) = lines.split_last().unwrap();
    assert_eq!((values.len(), end["end"].as_str()), (20, Some("enough")), "{echoed}");
    for pair in values.windows(2) {
        let [one, next] = pair else { continue };
        let (number, lost) = (next["number"].as_u64().unwrap(), next["lost"].as_u64().unwrap());
        assert_eq!(number, one["number"].as_u64().unwrap() + 1 + lost, "{echoed}");
        assert!(next["stamp"].as_f64() > one["stamp"].as_f64(), "{echoed}");
    }
    assert!(values.iter().all(|value| value["output"] == "main/beat.Out" && value["type"] == "Beat"), "{echoed}");
}

/// The program's own clock measures a rate, so the rate does not depend on the load of this machine. A silent output
/// is reported as silent.
#[test]
fn a_rate_is_that_of_the_program() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let counted = here.ask(&["hz", "beat.Out", "--for", "4", "--json"]);
    assert_eq!(counted.code, Some(0), "{counted}");
    let lines = lines(&counted.out);
    let all = lines.iter().find(|line| line["of"] == "all").unwrap_or_else(|| panic!("{counted}"));
    // Deadlines that a busy machine misses are left out, so the program may be slower, but never faster.
    let hertz = all["rate"]["hertz"].as_f64().unwrap();
    assert!((5.0..=101.0).contains(&hertz), "{counted}");
    assert_eq!(lines.last().unwrap()["end"], "enough", "{counted}");

    let silent = here.ask(&["hz", "quiet.Out", "--for", "1"]);
    assert_eq!(silent.code, Some(1), "{silent}");
    assert!(silent.err.contains("no value has left `main/quiet.Out` in that time"), "{silent}");
    let unknown = here.ask(&["echo", "beat.Nope"]);
    assert_eq!(unknown.code, Some(1), "{unknown}");
    assert!(
        unknown.err.contains("no matching process has an output `beat.Nope`; the outputs are `main/beat.Out`"),
        "{unknown}"
    );
    let nobody = here.ask(&["echo", "nobody.Out"]);
    assert_eq!(nobody.code, Some(1), "{nobody}");
}

/// A program that dies and is restarted is heard again, and its listener is informed. When everything is over, the
/// listener ends.
#[test]
fn an_echo_outlives_its_program_and_ends_with_the_deployment() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let echo = here.dca(&["echo", "beat.Out", "--json"]);
    echo.wait_for(Stream::Out, "\"number\"", SOON);
    cluster.expect_leaf("main/beat").signal(Signal::KILL);
    echo.wait_for(Stream::Out, "\"restarted\":true", SOON);
    assert_eq!(here.ask(&["stop", "beats"]).code, Some(0));
    let ended = echo.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(lines(&ended.out).last().unwrap()["end"], "finished", "{ended}");
}

/// A listener that stops reading does not slow the program down.
#[test]
fn a_listener_that_hangs_delays_nobody() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let hangs = here.dca(&["echo", "beat.Out", "--json"]);
    hangs.wait_for(Stream::Out, "\"number\"", SOON);
    hangs.signal(Signal::STOP);
    let echoed = here.ask(&["echo", "beat.Out", "-n", "50", "--json"]);
    assert_eq!(echoed.code, Some(0), "{echoed}");
    assert_eq!(lines(&echoed.out).len(), 51, "{echoed}");
    hangs.signal(Signal::CONT);
    hangs.signal(Signal::INT);
    assert_eq!(hangs.ended(SOON).code, Some(0));
}

/// The node of the home is killed and adopts its programs. Later events of its deployment are heard as before.
#[test]
fn an_echo_outlives_its_home() {
    let cluster = Cluster::new();
    let (here, [node, _deploy]) = deployed(&cluster);
    let echo = here.dca(&["echo", "beat.Out", "--json"]);
    echo.wait_for(Stream::Out, "\"number\"", SOON);
    node.kill();
    echo.wait_for(Stream::Err, "the end of the mission will be reported when the node is back", SOON);
    let _node = here.node("c1", &[]);
    cluster.expect_leaf("main/beat").signal(Signal::KILL);
    echo.wait_for(Stream::Out, "\"restarted\":true", SOON);
    assert_eq!(here.ask(&["stop", "beats"]).code, Some(0));
    let ended = echo.ended(SOON);
    assert_eq!((ended.code, lines(&ended.out).last().unwrap()["end"].as_str()), (Some(0), Some("finished")), "{ended}");
}
