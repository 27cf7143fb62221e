//! A link between two hosts is cut, and a third host reaches both. The producer counts the values that its consumer cannot
//! get. A consumer that is connected again takes the count over. Otherwise the summary of the mission has it. The record says
//! that it lacks the last values of a program that `dca` does not reach.

use dca_tests::cluster::{Cluster, Hosts, SOON, Stream, executable, wait_until};
use node::logic::protocol::LostValues;

/// Returns the lines of a log of `dca-counting`, without the first one.
fn lines(cluster: &Cluster, name: &str) -> Vec<String> {
    let text = std::fs::read_to_string(cluster.folder().join(name)).unwrap_or_default();
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    whole.lines().skip(1).map(str::to_owned).collect()
}

/// Returns the number of each beat that was heard, and the count of lost beats at that time.
fn heard(cluster: &Cluster, name: &str) -> Vec<(u64, u64)> {
    let beat = |line: &String| {
        let words: Vec<u64> = line.split(' ').skip(3).map(|word| word.parse().expect("it is a number")).collect();
        (words[0], words[1])
    };
    lines(cluster, name).iter().map(beat).collect()
}

#[test]
fn values_that_a_cut_link_does_not_deliver_are_counted_once() {
    let Some(hosts) = Hosts::start(3, None) else { return };
    let (cluster, here) = (&hosts.cluster, hosts.host(1));
    let program = executable("dca-counting").display().to_string();
    let file = |name: &str| cluster.folder().join(name).display().to_string();
    let text = format!(
        "module Heart(host: Host, file: Text) {{ exec \"'{program}' Heart\"; out Out: Beat; service; }}
        module Ear(host: Host, file: Text) {{ exec \"'{program}' Ear\"; in In: Beat; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{
                heart instof Heart(c1, file = \"{}\");
                ear instof Ear(c2, file = \"{}\");
                far instof Heart(c2, file = \"{}\");
                beside instof Ear(c2, file = \"{}\");
            }}
            internal_connections(heart, on) {{ heart, Out -> ear, In queue 8000; }}
            internal_connections(far, on) {{ far, Out -> beside, In queue 8000; }}
            internal_event_actions {{ heart[on], ear, far[on], beside }}
        }}",
        file("heart"),
        file("ear"),
        file("far"),
        file("beside")
    );
    let mission = here.dca(&["deploy", "--record", "far.Out", &cluster.file("cut.dca", &text)]);
    mission.wait_for(Stream::Err, "▸", 2 * SOON);
    let hears_more = || {
        let before = heard(cluster, "ear").len();
        wait_until(2 * SOON, || heard(cluster, "ear").len() > before + 20).expect("the ear hears again");
    };
    let parts = || here.statuses(&[]).into_iter().flat_map(|node| node.deployments);
    let undelivered = || parts().flat_map(|part| part.undelivered).collect::<Vec<_>>();
    let is_cut = || undelivered().iter().any(|one| one.count > 20);
    hears_more();
    assert_eq!(undelivered(), []);

    hosts.network.keep_apart(&[1, 2]);
    wait_until(2 * SOON, is_cut).expect("the producer counts");
    let status = here.ask(&["status"]);
    assert!(status.out.contains("not delivered: the consumer is not connected"), "{status}");
    assert!(parts().all(|part| part.lost.is_empty()), "the consumer does not know of the cut");
    hosts.network.let_meet(1);
    hosts.network.let_meet(2);
    hears_more();
    let taken_over = || {
        let all = heard(cluster, "ear");
        let (Some((first, before)), Some((last, lost))) = (all.first(), all.last()) else { return false };
        let told: u64 = parts().flat_map(|part| part.lost).map(|LostValues { count, .. }| count).sum();
        let missing = last + 1 - first - all.len() as u64;
        undelivered().is_empty() && missing > 20 && missing == lost - before && told == *lost
    };
    wait_until(SOON, taken_over)
        .unwrap_or_else(|| panic!("{:?}, {}", heard(cluster, "ear").last(), here.ask(&["status"])));

    hosts.network.keep_apart(&[1, 2]);
    wait_until(2 * SOON, is_cut).expect("the producer counts again");
    assert_eq!(here.ask(&["stop", "cut"]).code, Some(0));
    let ended = mission.ended(SOON);
    let counted =
        ended.out.lines().find_map(|line| line.trim().strip_prefix("heart: ")?.strip_suffix(" values not delivered"));
    let counted: u64 = counted.and_then(|count| count.parse().ok()).unwrap_or_else(|| panic!("{ended}"));
    let (last, _) = *heard(cluster, "ear").last().expect("it has heard");
    let missing = lines(cluster, "heart").len() as u64 - last;
    // Beats that were sent before the producer noticed the cut may have been on their way.
    assert!((20..=missing).contains(&counted), "{counted} counted of {missing}: {ended}");
    let recorded = "the last values of main/far.Out to main/beside.In may not be in the record";
    assert!(ended.out.contains(recorded) || ended.out.contains("The last ones may be missing too"), "{ended}");
    let log = here.ask(&["logs", "heart"]);
    assert!(log.out.contains("values were sent while their consumers were not connected"), "{log}");
    hosts.end();
}
