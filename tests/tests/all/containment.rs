//! After a stop, nothing of a program is left. The tests cover every level of containment that this machine has: with
//! and without a control group around the node, and with and without one for the program.

use dca_tests::cluster::{Cluster, Host, SOON, wait_until};
use node::logic::protocol::Containment;
use rustix::process::Signal;
use std::time::Duration;

/// The mount points of control groups, of version 2 and of the process controller of version 1.
const UNIFIED: [&str; 2] = ["/sys/fs/cgroup/unified", "/sys/fs/cgroup"];
const PIDS: &str = "/sys/fs/cgroup/pids";

/// Makes 20 daemons.
const DAEMONS: &str = "
import os, signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
for _ in range(20):
    if os.fork() == 0:
        os.setsid()
        if os.fork() != 0:
            os._exit(0)
        break
while True:
    signal.pause()
";
/// Each of its processes repeatedly makes another one.
const BOMB: &str = "
import os, signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
while True:
    try:
        if os.fork() == 0:
            os.setsid()
    except OSError:
        time.sleep(0.01)
";

/// Starts 20 daemons that ignore SIGTERM, and a fork bomb if a limit contains it.
fn run(on: impl FnOnce(Host) -> Host, policy: &str) -> Containment {
    let cluster = Cluster::new();
    let host = on(cluster.here());
    let node = host.node("c1", &[]);
    let daemons = cluster.file("daemons.py", DAEMONS);
    // Without a limit, a fork bomb would bring this machine down.
    let first = if policy.is_empty() { daemons.clone() } else { cluster.file("bomb.py", BOMB) };
    let text = format!(
        "module First(host) {{ exec \"python3 {first}\"; plain; service; stop within 200 ms; }}
        module Second(host) {{ exec \"python3 {daemons}\"; plain; service; stop within 200 ms; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ first instof First(c1) {{ {policy} }} second instof Second(c1); }}
            internal_event_actions {{ first, second }}
        }}",
    );
    let mission = host.dca(&["deploy", &cluster.file("bomb.dca", &text)]);
    let running = || {
        let is_part = |command: &[String]| command.first().is_some_and(|name| name.contains("python3"));
        cluster.left().into_iter().filter(|process| is_part(&process.command)).count()
    };
    let most = if policy.is_empty() { 42 } else { 60 + 21 };
    wait_until(SOON, || running() == most).unwrap_or_else(|| panic!("{policy}: {} of {most}", running()));
    let containment = host.statuses(&[])[0].containment;
    // A node writes down the name of its group.
    let has_group = host.run_dir().join("c1/cgroup").is_file();
    assert_eq!(containment == Containment::ControlGroup, has_group);
    let shown = host.ask(&["status"]).out;
    assert!(shown.ends_with(&format!("c1  held by {containment}\n")), "{shown}");
    let stop = host.ask(&["stop", "bomb"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(running(), 0, "{containment:?} {policy}");
    drop(mission.ended(SOON));
    node.signal(Signal::TERM);
    let ended = node.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(2));
    containment
}

#[test]
fn nothing_is_left_on_any_rung() {
    let is_mounted = |at: &str, kind: &str| {
        let mounts = std::fs::read_to_string("/proc/self/mounts").unwrap_or_default();
        mounts.lines().any(|line| line.split(' ').skip(1).take(2).eq([at, kind]))
    };
    let has_pids = is_mounted(PIDS, "cgroup") && rustix::process::getuid().is_root();
    let limited = if has_pids { "pids 60;" } else { "" };
    let unified = UNIFIED.into_iter().find(|at| is_mounted(at, "cgroup2"));
    let rung = run(|host| host, limited);
    println!("as it is, with `{limited}`: {rung}");
    if !rustix::process::getuid().is_root() {
        println!("skipped: the other rungs need a mount namespace");
        return;
    }
    let hidden: Vec<&str> = unified.into_iter().collect();
    let rung = run(|host| host.without_mounts(&hidden), limited);
    println!("without version 2, with `{limited}`: {rung}");
    assert_eq!(rung, Containment::Subreaper);
    let hidden: Vec<&str> = unified.into_iter().chain(has_pids.then_some(PIDS)).collect();
    assert_eq!(run(|host| host.without_mounts(&hidden), ""), Containment::Subreaper);
    refuses(&hidden);
}

/// A host that cannot enforce a limit reports this, and starts nothing.
fn refuses(hidden: &[&str]) {
    let cluster = Cluster::new();
    let bare = cluster.here().without_mounts(hidden);
    let text = "module Any(host) { exec \"true\"; plain; }
        process main() { host { c1 } instantiated_processes { a instof Any(c1) { pids 8; } } internal_event_actions { a } }";
    let node = bare.node("c1", &[]);
    let refused = bare.ask(&["deploy", &cluster.file("any.dca", text)]);
    let why = "a limit of 8 processes is refused: it needs the control group `pids`, and this host has none";
    assert!(refused.code == Some(1) && refused.out.contains(why), "{refused}");
    node.signal(Signal::TERM);
    drop(node.ended(SOON));
    cluster.expect_nothing_left(Duration::from_secs(2));
}
