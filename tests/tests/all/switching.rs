//! Connection sets are switched while a source counts at 1 kHz. No number is lost, doubled or late.
//!
//! `DCA_TEST_ROUNDS=10000 cargo test --test all switching::` switches 10,000 times in each test, which takes some
//! minutes.

#![expect(clippy::print_stdout, reason = "a test says how long its switches took")]

use dca_tests::cluster::{Cluster, Host, Network, SOON, Stream, executable, pass, rounds, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::time::Duration;

/// The longest round of the event actions on a busy machine.
const ROUND: Duration = Duration::from_millis(100);

/// Writes a spec of a source, two sinks, and a pulse. The sets of the pulse lead from one input or sink to another.
fn spec(cluster: &Cluster, sinks: &str, expression: &str) -> String {
    let program = executable("dca-counting").display().to_string();
    let file = |name: &str| cluster.folder().join(name).display().to_string();
    let (one, other) = (file("one"), file("other"));
    let text = format!(
        "module Source(host: Host) {{ exec \"'{program}' Source\"; out Out: Numbers; service; }}
        module Sink(host: Host, file: Text) {{ exec \"'{program}' Sink\"; in In: Numbers; in Other: Numbers; service; }}
        module Pulse(host: Host) {{ exec \"'{program}' Pulse\"; done; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{
                source instof Source(c1);
                one instof Sink({sinks}, file = \"{one}\");
                other instof Sink({sinks}, file = \"{other}\");
                pulse instof Pulse(c1);
                gate instof Source(c1);
            }}
            internal_connections(pulse, a) {{ source, Out -> one, In queue 8000; }}
            internal_connections(pulse, b) {{ source, Out -> one, Other queue 8000; }}
            internal_connections(gate, a) {{ source, Out -> one, In queue 8000; }}
            internal_connections(gate, b) {{ source, Out -> one, Other queue 8000; }}
            internal_connections(gate, c) {{ source, Out -> other, In queue 8000; }}
            internal_event_actions {{ {expression} }}
        }}"
    );
    cluster.file("count.dca", &text)
}

/// Prints the percentiles of times in milliseconds.
fn print(what: &str, mut times: Vec<f64>) {
    times.sort_by(f64::total_cmp);
    let at = |percent: usize| times[(times.len() - 1) * percent / 100];
    println!("{what}: {} switches, p50 {:.2} ms, p99 {:.2} ms, max {:.2} ms", times.len(), at(50), at(99), at(100));
}

/// Returns the events of switches.
fn told(events: &str) -> Vec<Value> {
    let objects = events.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let switched = objects.filter_map(|object| {
        let found = object.to_string().contains("\"Switched\"");
        found.then(|| object.pointer("/report/Process/change/Switched").cloned().unwrap_or(object))
    });
    switched.collect()
}

/// Switches between labels as fast as the event actions allow. It calls `meanwhile` once they have begun.
fn in_turn(cluster: &Cluster, here: &Host, (sinks, what): (&str, &str), meanwhile: impl FnOnce()) {
    let count = rounds(300);
    let file = spec(cluster, sinks, "source, one, other, gate, (pulse[a] ;; pulse[b])");
    let events = here.dca(&["events", "-f", "--json"]);
    let mission = here.mission(&file);
    assert!(wait_until(SOON, || !told(&events.text(Stream::Out)).is_empty()).is_some());
    meanwhile();
    let within = SOON + ROUND * u32::try_from(count).expect("it is small");
    let is_enough = || told(&events.text(Stream::Out)).len() >= count;
    assert!(wait_until(within, is_enough).is_some(), "{}", events.text(Stream::Out));
    let stop = here.ask(&["stop", "count"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(mission.ended(SOON).code, Some(1));
    let switched = told(&events.text(Stream::Out));
    let zero = |one: &&Value| one["lost"] == 0 && one["late"] == 0;
    let rough: Vec<&Value> = switched.iter().filter(|one| !zero(one)).collect();
    assert!(rough.is_empty(), "{rough:?}");
    print(what, switched.iter().map(|one| one["took"].as_f64().expect("it is a time") * 1000.0).collect());
    let runs = cluster.counted("one");
    assert_eq!(runs.len(), 1, "numbers were lost, doubled or late: {runs:?}");
    println!("{what}: {} numbers, all in order", runs[0].1 - runs[0].0 + 1);
}

#[test]
fn sets_in_turn_lose_nothing_on_one_host() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    in_turn(&cluster, &here, ("c1", "on one host"), || ());
}

#[test]
fn sets_in_turn_lose_nothing_between_two_hosts() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (here, there) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let _nodes = [here.node("c1", &["--insecure-lan"]), there.node("c2", &["--insecure-lan"])];
    in_turn(&cluster, &here, ("c2", "between two hosts"), || ());
}

/// A consumer that is suspended for a short time receives everything later, in order.
#[test]
fn a_consumer_that_is_suspended_loses_nothing() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    in_turn(&cluster, &here, ("c1", "consumer suspended for 0.4 s, five times"), || {
        let sink = cluster.expect_leaf("main/one");
        for _ in 0..5 {
            sink.signal(Signal::STOP);
            pass(Duration::from_millis(400));
            sink.signal(Signal::CONT);
            pass(Duration::from_millis(200));
        }
    });
}

/// If a link is cut for a short time, values sent in the meantime arrive in order once it is repaired.
#[test]
fn a_link_that_is_cut_and_healed_loses_nothing() {
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (here, there) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let _nodes = [here.node("c1", &["--insecure-lan"]), there.node("c2", &["--insecure-lan"])];
    in_turn(&cluster, &here, ("c2", "link cut for 0.5 s, three times"), || {
        for _ in 0..3 {
            network.cut(2);
            pass(Duration::from_millis(500));
            network.heal(2);
            pass(Duration::from_secs(2));
        }
    });
}

/// `dca switch`, from input to input and from sink to sink.
#[test]
fn a_person_switches_what_runs() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.mission(&spec(&cluster, "c1", "source, one, other, gate[a]"));
    let mut times = Vec::new();
    for round in 0..20 {
        let label = ["gate[b]", "gate[c]", "main/gate[a]"][round % 3];
        let switched = here.ask(&["switch", "count", label, "--json"]);
        assert_eq!(switched.code, Some(0), "{switched}");
        let json: Value = serde_json::from_str(&switched.out).expect("it is JSON");
        assert!(json["lost"] == 0 && json["late"] == 0, "{json}");
        times.push(json["took"].as_f64().expect("it is a time") * 1000.0);
    }
    print("dca switch", times);
    let plain = here.ask(&["switch", "count", "gate[b]"]);
    let lines = [
        "disconnect main/source, Out -> main/other, In",
        "connect    main/source, Out -> main/one, Other",
        "connections switched from main/gate[c] to main/gate[b] in ",
    ];
    assert!(plain.code == Some(0) && lines.iter().all(|line| plain.out.contains(line)), "{plain}");
    let same = here.ask(&["switch", "count", "gate[b]"]);
    assert!(same.code == Some(0) && same.out.contains("nothing changes"), "{same}");
    for (process, why) in [
        ("gate[z]", "has no connection set `z`; it has `a`, `b`, `c`"),
        ("pulse[a]", "`main/pulse` does not run at this moment"),
        ("gates[a]", "`count` has no process `gates`"),
    ] {
        let refused = here.ask(&["switch", "count", process]);
        assert!(refused.code == Some(1) && refused.err.contains(why), "{refused}");
    }
    assert_eq!(here.ask(&["switch", "count", "gate"]).code, Some(2));
    assert_eq!(here.ask(&["stop", "count"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    let mut all = cluster.counted("one");
    all.extend(cluster.counted("other"));
    all.sort_unstable();
    assert!(all.windows(2).all(|pair| pair[1].0 == pair[0].1 + 1), "numbers were lost or doubled: {all:?}");
}

/// A producer does not carry out its part of a switch. The switch is not confirmed, and the command names the
/// producer.
#[test]
fn a_switch_that_somebody_does_not_confirm_has_exit_code_3() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let file = spec(&cluster, "c1", "source, one, other, gate[a]");
    // A program that is suspended for longer than the home waits is not reported as hanging.
    let text = std::fs::read_to_string(&file).expect("it was just written");
    let declared = text.lines().find(|line| line.contains("source instof Source")).expect("it is there").to_owned();
    let unwatched = declared.replace(';', " { watchdog none; }");
    let mission = here.mission(&cluster.file("count.dca", &text.replace(&declared, &unwatched)));
    let source = cluster.expect_leaf("main/source");
    source.signal(Signal::STOP);
    let switched = here.ask(&["switch", "count", "gate[b]", "--json"]);
    assert_eq!(switched.code, Some(3), "{switched}");
    assert!(switched.err.contains("`main/source` did not confirm the switch in time"), "{switched}");
    let json: Value = serde_json::from_str(&switched.out).expect("it is JSON");
    assert_eq!(json["unconfirmed"], serde_json::json!(["main/source"]), "{json}");
    source.signal(Signal::CONT);
    let back = here.ask(&["switch", "count", "gate[a]"]);
    assert_eq!(back.code, Some(0), "it goes on: {back}");
    assert_eq!(here.ask(&["stop", "count"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
}
