//! Hanging programs: in a calculation, in `Init`, at their start, or as a whole while suspended.

use dca_tests::cluster::{Busy, Cluster, Host, Program, SOON, Stream, executable, pass, wait_until};
use node::logic::protocol::{Change, ProcessStatus};
use rustix::process::Signal;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::collections::BTreeMap;
use std::time::Duration;

/// Returns a spec with these instances. Their controllers hang in the named place.
fn spec(cluster: &Cluster, instances: &[(&str, &str, &str)], expression: &str) -> String {
    let program = executable("dca-hanging").display().to_string();
    let instance = |(name, place, policy): &(&str, &str, &str)| {
        format!("{name} instof Hanging(c1, place = \"{place}\") {{ {policy} }}\n")
    };
    let instances: String = instances.iter().map(instance).collect();
    let text = format!(
        "module Hanging(host: Host, place: Text) {{ exec \"'{program}' Hanging\"; service; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ {instances} }}
            internal_event_actions {{ {expression} }}
        }}"
    );
    cluster.file("hanging.dca", &text)
}

fn states(host: &Host) -> BTreeMap<String, ProcessStatus> {
    host.processes(&[]).into_iter().map(|(_, process)| (process.path.clone(), process)).collect()
}

fn are_running(host: &Host, count: usize) -> bool {
    states(host).values().filter(|process| process.pid.is_some() && process.state == "running").count() == count
}

fn end(cluster: &Cluster, node: Program) {
    node.signal(Signal::TERM);
    let ended = node.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
}

#[test]
fn a_loop_that_hangs_is_a_fault_that_says_so() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let policies = [
        ("main_calc", "watchdog 300 ms;", "its loop has not come round for 0.3 s"),
        ("main_calc", "", "its loop has not come round for 5 s"),
        ("init", "ready within 2 s;", "it was not ready within 2 s"),
        ("init", "watchdog none; ready within 2 s;", "it was not ready within 2 s"),
    ];
    for (place, policy, why) in policies {
        let ended = here.ask(&["run", &spec(&cluster, &[("a", place, policy)], "a")]);
        assert!(ended.code == Some(1) && ended.out.contains(&format!("main ← a: {why} at ")), "{policy}: {ended}");
        cluster.expect_nothing_left(Duration::from_secs(2));
    }
    let ended = here.ask(&["run", &spec(&cluster, &[("a", "new", "ready within 1 s;")], "a")]);
    let why = "`main/a` cannot take part on `c1`: it was not ready within 1 s";
    assert!(ended.code == Some(1) && ended.out.contains(why), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
}

/// A program is suspended for longer than the default bound. Then its `restart` is followed as after any other death, and the record
/// shows this.
#[test]
fn a_suspended_program_is_found_and_started_again() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let instances = [("a", "none", "restart transient;"), ("b", "none", ""), ("c", "none", "watchdog none;")];
    let node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", &spec(&cluster, &instances, "a, b, c")]);
    wait_until(SOON, || are_running(&here, 3)).expect("they run");
    let before = states(&here);
    for leaf in ["main/a", "main/c"] {
        cluster.expect_leaf(leaf).signal(Signal::STOP);
    }
    mission.wait_for(Stream::Err, "its loop has not come round for 5 s", SOON);
    wait_until(SOON, || are_running(&here, 3)).expect("it is started again");
    let after = states(&here);
    assert!(after["main/a"].pid != before["main/a"].pid);
    for leaf in ["main/b", "main/c"] {
        assert_eq!(after[leaf].pid, before[leaf].pid, "{leaf} is left alone");
    }
    cluster.expect_leaf("main/b").signal(Signal::STOP);
    mission.wait_for(Stream::Err, "b aborted: its loop has not come round for 5 s", SOON);
    cluster.expect_leaf("main/c").signal(Signal::CONT);
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.contains("main ← b: its loop has not come round for 5 s"), "{ended}");
    let trace = dca_tests::cluster::Trace::read(&cluster.folder().join("runs/hanging-1"));
    let restarted = trace.changes("main/a");
    let told = |change: &&Change| matches!(change, Change::Restarting { cause, .. } if cause.to_string().contains("come round"));
    assert_eq!(restarted.iter().filter(|change| told(change)).count(), 1, "{restarted:?}");
    end(&cluster, node);
}

/// The shim measures, so it also finds a hang without a node. It never reports a healthy program.
#[test]
fn a_hang_is_found_while_the_node_is_away() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let instances = [("well", "none", "watchdog 500 ms; restart transient;"), ("hangs", "none", "watchdog 500 ms;")];
    let node = here.node("c1", &[]);
    let deployed = here.dca(&["deploy", &spec(&cluster, &instances, "well, hangs else skip")]);
    wait_until(SOON, || are_running(&here, 2)).expect("they run");
    let before = states(&here)["main/well"].pid;
    node.signal(Signal::KILL);
    drop(node.ended(SOON));
    cluster.expect_leaf("main/hangs").signal(Signal::STOP);
    wait_until(SOON, || cluster.leaf("main/hangs").is_none()).expect("its shim ends it");
    pass(Duration::from_secs(2));
    let node = here.node("c1", &[]);
    let hung = "dead: its loop has not come round for 0.5 s";
    let told = || states(&here).get("main/hangs").is_some_and(|process| process.state == hung);
    wait_until(SOON, told).unwrap_or_else(|| panic!("{:?}", states(&here)));
    assert_eq!(states(&here)["main/well"].pid, before);
    // `dca deploy` gives up a node that is away for too long. On a busy machine this may happen here.
    let mission = here.dca(&["attach", "hanging"]);
    mission.wait_for(Stream::Err, "hangs aborted", SOON);
    let stop = here.ask(&["stop", "hanging"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    let ended = mission.ended(SOON);
    assert!(ended.err.contains("hangs aborted: its loop has not come round for 0.5 s"), "{ended}");
    assert!(!ended.err.contains("well died"), "{ended}");
    drop(deployed.ended(SOON));
    end(&cluster, node);
}

/// A program may be ended because its own agent is gone. The report contains this reason instead of its exit code.
#[test]
fn a_stop_by_the_loss_of_the_node_is_told_as_such() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let instances = [("goes", "none", "on_agent_loss stop within 2 s;"), ("stays", "none", "")];
    let node = here.node("c1", &[]);
    let deployed = here.dca(&["deploy", &spec(&cluster, &instances, "goes, stays")]);
    wait_until(SOON, || are_running(&here, 2)).expect("they run");
    node.signal(Signal::KILL);
    drop(node.ended(SOON));
    wait_until(SOON, || cluster.leaf("main/goes").is_none()).expect("its shim ends it");
    let node = here.node("c1", &[]);
    // `dca deploy` gives up a node that is away for too long. The node tells its events to all who ask.
    let why = "was stopped because its node was gone (`on_agent_loss`)";
    let told = || here.ask(&["events", "hanging"]);
    wait_until(SOON, || told().out.lines().any(|line| line.contains("main/goes") && line.contains(why)))
        .unwrap_or_else(|| panic!("{}", told()));
    drop(deployed.ended(SOON));
    end(&cluster, node);
}

/// Restricts this thread, and the processes that it starts, to one processor. The other processors stay free for the tests that run
/// at the same time.
fn use_one_processor() {
    let allowed = sched_getaffinity(None).expect("a thread may ask for its own processors");
    let first = (0..CpuSet::MAX_CPU).find(|processor| allowed.is_set(*processor)).expect("it runs on one");
    let mut one = CpuSet::new();
    one.set(first);
    sched_setaffinity(None, &one).expect("a thread may give up processors");
}

#[test]
fn a_starved_machine_raises_no_alarm() {
    use_one_processor();
    let cluster = Cluster::new();
    let here = cluster.here();
    let names: Vec<String> = (0..20).map(|number| format!("p{number}")).collect();
    let instances: Vec<(&str, &str, &str)> = names.iter().map(|name| (name.as_str(), "none", "")).collect();
    let node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", &spec(&cluster, &instances, &names.join(", "))]);
    wait_until(2 * SOON, || are_running(&here, 20)).expect("they run");
    let before = states(&here);
    let load = Busy::start(20, 0);
    // Three times the usual bound.
    pass(Duration::from_secs(15));
    drop(load);
    let after = states(&here);
    for (path, process) in before {
        assert_eq!((process.pid, process.state.as_str()), (after[&path].pid, after[&path].state.as_str()), "{path}");
    }
    assert!(mission.is_running());
    let stop = here.ask(&["stop", "hanging"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    end(&cluster, node);
}
