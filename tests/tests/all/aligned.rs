//! `dca deploy --aligned`: programs on several hosts begin at the same moment. Each host is a network namespace whose
//! boot-time clock began at a different time, as on separate machines. The test knows this difference, so it can
//! compare the times that the programs write.
//!
//! `DCA_TEST_ROUNDS=100 cargo test --test all aligned::` deploys 100 times, with and without the option.

use dca_tests::cluster::{Cluster, Host, NAMES, Network, Program, SOON, Stream, executable, rounds, wait_until};
use std::time::Duration;

/// The number of seconds by which the clock of each host is ahead.
const AHEAD: [u64; 3] = [0, 100_000, 7];

/// Writes a spec with a program on each host that writes down its start. Each program has its own supervisor on another
/// host.
fn spec(cluster: &Cluster) -> String {
    let (program, folder) = (executable("dca-counting").display().to_string(), cluster.folder().display().to_string());
    let text = format!(
        "module Heart(host: Host, file: Text) {{ exec \"'{program}' Heart\"; out Out: Beat; service; }}
        process Side(own: Host, other: Host, file: Text) {{
            host {{ own }}
            instantiated_processes {{ heart instof Heart(other, file = file); }}
            internal_event_actions {{ heart , wait(1 h) }}
        }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{
                one instof Side(c2, c1, \"{folder}/c1\");
                two instof Side(c3, c2, \"{folder}/c2\");
                three instof Side(c1, c3, \"{folder}/c3\");
            }}
            internal_event_actions {{ one , two , three }}
        }}"
    );
    cluster.file("start.dca", &text)
}

/// Returns the time of each host's first calculation, on the clock of the first host. Returns nothing until all hosts
/// have one.
fn begun(cluster: &Cluster) -> Option<Vec<Duration>> {
    let of = |(host, ahead): (&str, u64)| {
        let text = std::fs::read_to_string(cluster.folder().join(host)).ok()?;
        let line = text.lines().nth(1).filter(|_| text.ends_with('\n'))?;
        let nanos = line.split_whitespace().next()?.parse().ok()?;
        Some(Duration::from_nanos(nanos).saturating_sub(Duration::from_secs(ahead)))
    };
    NAMES.into_iter().zip(AHEAD).map(of).collect()
}

/// Deploys and stops again. Returns the difference between the starts of the programs, and the output of the command.
fn start(cluster: &Cluster, here: &Host, options: &[&str]) -> (Duration, String) {
    NAMES.iter().for_each(|host| drop(std::fs::remove_file(cluster.folder().join(host))));
    let mission = here.dca(&[&["deploy", "--no-record", &spec(cluster)], options].concat());
    assert!(wait_until(SOON, || begun(cluster).is_some()).is_some(), "{}", mission.text(Stream::Err));
    let begun = begun(cluster).expect("all have begun");
    let stop = here.ask(&["stop", "start"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    let said = mission.text(Stream::Err);
    assert!(wait_until(SOON, || !mission.is_running()).is_some());
    let (first, last) = (begun.iter().min(), begun.iter().max());
    (*last.expect("three") - *first.expect("three"), said)
}

#[test]
fn programs_on_three_hosts_begin_at_one_moment_whatever_their_clocks_show() {
    let Some(network) = Network::new(NAMES.len()) else { return };
    let cluster = Cluster::new();
    let host = |number: usize| cluster.host(&network, number).with_clock_ahead(AHEAD[number - 1]);
    let hosts: Vec<Host> = (1..=NAMES.len()).map(host).collect();
    let _nodes: Vec<Program> =
        hosts.iter().zip(NAMES).map(|(host, name)| host.node(name, &["--insecure-lan"])).collect();
    let here = &hosts[0];
    let are_there = || NAMES.iter().all(|name| here.ask(&["nodes"]).out.lines().any(|line| line.starts_with(name)));
    assert!(wait_until(SOON, are_there).is_some(), "{}", here.ask(&["nodes"]));
    let mut spans = [Vec::new(), Vec::new()];
    for round in 0..rounds(5) {
        let (span, said) = start(&cluster, here, &["--aligned"]);
        let within = said.split("aligned to within ").nth(1).and_then(|rest| rest.lines().next());
        println!("round {round}: {span:.2?} apart, aligned to within {}", within.unwrap_or("nothing"));
        assert!(within.is_some(), "{said}");
        spans[0].push(span);
        let (span, said) = start(&cluster, here, &[]);
        assert!(!said.contains("aligned"), "{said}");
        spans[1].push(span);
    }
    spans.iter_mut().for_each(|spans| spans.sort_unstable());
    let [aligned, at_once] = spans.map(|spans| (spans[0], spans[spans.len() / 2], spans[spans.len() - 1]));
    println!("least, median, most: aligned {aligned:.2?}, at once {at_once:.2?}");
    // The time for which a program waits for a core is not part of the test.
    assert!(aligned.0 < Duration::from_millis(10), "{aligned:?}");
}
