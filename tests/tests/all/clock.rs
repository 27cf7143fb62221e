//! `dca clock` on real nodes. All of them read the clock of one machine, so the true difference is zero. This makes it possible to
//! check the bound.

use dca_tests::cluster::{Cluster, Ended, Host, Hosts, NAMES, SOON, wait_until};
use rustix::process::Signal;
use serde_json::Value;

fn clocks(ended: &Ended) -> Value {
    serde_json::from_str(&ended.out).unwrap_or_else(|why| panic!("{why}: {ended}"))
}

/// Asks until each of these hosts has answered. Then it checks that each clock is within the reported bound.
#[track_caller]
fn check(host: &Host, expected: &[&str]) {
    let mut last = None;
    let is_complete = || {
        let ended = host.ask(&["clock", "--json"]);
        let told = clocks(&ended);
        let hosts: Vec<&str> =
            told["clocks"].as_array().into_iter().flatten().filter_map(|clock| clock["host"].as_str()).collect();
        let is_complete = hosts == expected && ended.code == Some(0);
        last = Some(ended);
        is_complete
    };
    let found = wait_until(SOON, is_complete);
    let ended = last.expect("it was asked once");
    assert!(found.is_some(), "{ended}");
    for clock in clocks(&ended)["clocks"].as_array().into_iter().flatten() {
        let number = |field: &str| clock[field].as_f64().unwrap_or_else(|| panic!("{clock}"));
        assert!(number("ahead").abs() <= number("error_max") + 1e-6, "{clock}");
        assert!(number("error_max") < 1.0 && clock["steady"] == true, "{clock}");
        assert!(["kept", "unkept"].contains(&clock["keeping"].as_str().unwrap_or_default()), "{clock}");
    }
}

#[test]
fn clocks_are_compared_within_their_bounds_and_a_host_that_does_not_answer_is_told() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (_c1, c2) = (here.node("c1", &[]), here.node("c2", &[]));
    check(&here, &["c1", "c2"]);
    let table = here.ask(&["clock"]);
    assert!(table.code == Some(0) && table.out.starts_with("HOST") && table.out.contains(" ms "), "{table}");
    c2.signal(Signal::STOP);
    let silent = here.ask(&["clock", "--json"]);
    let told = clocks(&silent);
    assert_eq!((silent.code, &told["unreachable"]), (Some(3), &serde_json::json!(["c2"])), "{silent}");
    assert_eq!(told["clocks"][0]["host"], "c1", "{silent}");
    assert!(silent.err.contains("`c2` did not answer"), "{silent}");
    c2.signal(Signal::CONT);
    check(&here, &["c1", "c2"]);
}

#[test]
fn without_a_node_nothing_is_asked() {
    let ended = Cluster::new().here().ask(&["clock"]);
    assert!(ended.code == Some(3) && ended.err.contains("no node runs on this machine"), "{ended}");
}

#[test]
fn clocks_are_compared_over_a_network() {
    let Some(hosts) = Hosts::start(NAMES.len(), None) else { return };
    check(&hosts.host(1), &NAMES);
    hosts.end();
}
