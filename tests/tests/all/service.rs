//! A node as a service of a machine: its messages to the service manager, the unit that installs it, and the report of
//! `dca doctor`.

use dca_tests::cluster::{Cluster, SOON, executable, wait_until};
use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::UnixDatagram;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

/// Returns the next notice to the manager of a service, or none if no notice comes in time.
fn told(manager: &UnixDatagram, within: Duration) -> Option<String> {
    manager.set_read_timeout(Some(within)).expect("a socket has a timeout");
    let mut bytes = [0; 256];
    let size = manager.recv(&mut bytes).ok()?;
    Some(String::from_utf8_lossy(&bytes[..size]).into_owned())
}

fn run(program: &str, arguments: &[&str]) -> Output {
    Command::new(executable(program)).args(arguments).output().expect("it can be started")
}

/// The manager learns when the node is ready, that its loop runs, that the loop has stopped, and that the node leaves.
#[test]
fn a_service_manager_hears_how_a_node_is() {
    let cluster = Cluster::new();
    let socket = cluster.folder().join("notify");
    let manager = UnixDatagram::bind(&socket).expect("the folder is the test's own");
    let mut command = Command::new(executable("dca-node"));
    command.args(["--name", "c1", "--run-dir"]).arg(cluster.folder().join("n"));
    command.arg("--state").arg(cluster.folder().join("s")).stdout(Stdio::null()).stderr(Stdio::null());
    command.env("NOTIFY_SOCKET", &socket).env("WATCHDOG_USEC", "900000").current_dir(cluster.folder());
    let mut node = command.spawn().expect("it can be started");
    let pid = Pid::from_child(&node);
    let signal = |signal| kill_process(pid, signal).expect("it has not been waited for");
    let wait_for = |wanted: &str| {
        let heard = wait_until(SOON, || told(&manager, SOON).is_some_and(|text| text.starts_with(wanted)));
        assert!(heard.is_some(), "the manager was not told `{wanted}`");
    };
    wait_for("READY=1\nSTATUS=the node `c1` is ready");
    (0..3).for_each(|_| wait_for("WATCHDOG=1"));
    // Once its earlier messages are read, a stopped node sends nothing.
    signal(Signal::STOP);
    assert!(wait_until(SOON, || told(&manager, Duration::from_secs(2)).is_none()).is_some());
    signal(Signal::CONT);
    wait_for("WATCHDOG=1");
    signal(Signal::TERM);
    wait_for("STOPPING=1");
    let status = node.wait().expect("it was started here");
    assert!(status.success(), "{status}");
}

#[test]
fn the_unit_of_a_node_is_one_that_systemd_takes() {
    let cluster = Cluster::new();
    let shown = run("dca-node", &["install", "--print", "--name", "c1", "--lan", "--peer", "tcp/10.0.0.7:7000"]);
    let unit = String::from_utf8_lossy(&shown.stdout).into_owned();
    assert!(shown.status.success() && shown.stderr.is_empty(), "{shown:?}");
    let node = executable("dca-node");
    let command = format!("\nExecStart={} --name c1 --peer tcp/10.0.0.7:7000 --insecure-lan\n", node.display());
    assert!(unit.contains(&command), "{unit}");
    let file = cluster.file("dca-node.service", &unit);
    // A node needs a name.
    assert_eq!(run("dca-node", &["install", "--print"]).status.code(), Some(2));
    for user in ["", "no body"] {
        assert_eq!(run("dca-node", &["install", "--print", "--name", "c1", "--user", user]).status.code(), Some(1));
    }
    assert_eq!(run("dca-node", &[]).status.code(), Some(2));
    let mut odd = Command::new(executable("dca-node"));
    odd.args(["install", "--print", "--name", "c1", "--state"]).arg(OsStr::from_bytes(b"/var/lib/\xff"));
    let refused = odd.output().expect("it can be started");
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() == Some(1) && said.contains("is not UTF-8 text"), "{refused:?}");
    let Ok(verified) = Command::new("systemd-analyze").args(["verify", &file]).output() else { return };
    let said = String::from_utf8_lossy(&verified.stderr);
    let about_it: Vec<&str> =
        said.lines().filter(|line| line.contains("dca-node.service") && !line.contains("man ")).collect();
    assert!(about_it.is_empty(), "{about_it:#?}");
}

#[test]
fn a_doctor_says_what_is_wrong_and_ends_accordingly() {
    let cluster = Cluster::new();
    let folder = cluster.folder().join("n").display().to_string();
    let look = |state: &str| {
        let shown = run("dca", &["doctor", "--json", "--run-dir", &folder, "--state", state]);
        let checks: Vec<serde_json::Value> =
            serde_json::from_slice(&shown.stdout).unwrap_or_else(|why| panic!("{why}: {shown:?}"));
        let is_failed = checks.iter().any(|check| check["level"] == "failed");
        assert_eq!(shown.status.code(), Some(i32::from(is_failed)), "{checks:#?}");
        assert!(checks.iter().all(|check| check["level"] == "ok" || check["hint"].is_string()), "{checks:#?}");
        checks
    };
    let level = |checks: &[serde_json::Value], name: &str| {
        let check = checks.iter().find(|check| check["name"] == name).unwrap_or_else(|| panic!("{name}: {checks:#?}"));
        check["level"].as_str().unwrap_or_default().to_owned()
    };
    let good = look(&folder);
    for name in ["shim", "controllers", "ports", "sockets", "database", "nodes"] {
        assert_eq!(level(&good, name), "ok", "{good:#?}");
    }
    // This folder is never writable.
    assert_eq!(level(&look("/proc/1/dca"), "database"), "failed");
    let text = run("dca", &["doctor", "--run-dir", &folder, "--state", "/proc/1/dca"]);
    let lines = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(lines.contains("FAILED   database") && lines.contains("ok       shim"), "{lines}");
}
