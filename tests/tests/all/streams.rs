//! Streams of answers that break off: a node is killed in the middle of a stream, and the caller is told that the
//! rest is missing.

use comms::io::session::Session;
use comms::logic::{codec, key};
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::Write as Change;
use dbmanager::logic::view::value::Datum;
use dca_tests::cluster::{Cluster, Ended, Host, Program, SOON, wait_until};
use node::logic::database::question::{AckLevel, Commit, Question};
use node::logic::protocol::Request;
use rustix::fs::{FlockOperation, flock};
use rustix::process::Signal;
use std::fs::File;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// One program that writes 900 kB and then stays.
const TALKER: &str = "
module Talker(host) { exec \"sh -c 'yes | head -c 900000; sleep 3600'\"; plain; }
process main() { host { r1 } instantiated_processes { talker instof Talker(r1); } internal_event_actions { talker } }
";

/// A relay to a node. It kills the node after a number of bytes.
struct Passage {
    host: Host,
    _lock: File,
}

impl Passage {
    /// Opens a relay to the node `r1` of a host. It passes this many bytes, which is more than one answer and less
    /// than all.
    fn open(cluster: &Cluster, node: Program, passed: usize) -> Self {
        let folder = cluster.folder().join("p/r1");
        std::fs::create_dir_all(&folder).expect("a test can write in its own folder");
        let lock = File::create(folder.join("lock")).expect("a test can write in its own folder");
        flock(&lock, FlockOperation::LockExclusive).expect("nobody else has it");
        let listener = UnixListener::bind(folder.join("node.sock")).expect("nobody else has it");
        let socket = cluster.here().run_dir().join("r1/node.sock");
        std::thread::spawn(move || pass_on(&listener, &socket, (node, passed)));
        Self { host: cluster.here().with_run_dir(cluster.folder().join("p")), _lock: lock }
    }

    fn ask(&self, arguments: &[&str]) -> Ended {
        self.host.ask(arguments)
    }
}

/// Relays the traffic of every connection, until the node has sent this number of bytes.
fn pass_on(listener: &UnixListener, socket: &PathBuf, (node, passed): (Program, usize)) {
    let left = Arc::new(Mutex::new((passed, Some(node))));
    for caller in listener.incoming().map_while(Result::ok) {
        // Once the node has gone, every connection fails.
        let Ok(there) = UnixStream::connect(socket) else { continue };
        let both = || Some((caller.try_clone().ok()?, there.try_clone().ok()?));
        let (Some((mut to_caller, mut from_node)), Some((mut from_caller, mut to_node))) = (both(), both()) else {
            return;
        };
        std::thread::spawn(move || std::io::copy(&mut from_caller, &mut to_node));
        let left = Arc::clone(&left);
        std::thread::spawn(move || {
            let mut chunk = [0; 4096];
            while let Ok(size @ 1..) = from_node.read(&mut chunk) {
                let mut left = left.lock().expect("nothing in here panics");
                left.0 = left.0.saturating_sub(size);
                if left.0 == 0 {
                    left.1.take().inspect(|node| node.signal(Signal::KILL));
                    break;
                }
                drop(left);
                if to_caller.write_all(&chunk[..size]).is_err() {
                    break;
                }
            }
            // If the caller has already gone, it needs no notice.
            drop(to_caller.shutdown(Shutdown::Both));
        });
    }
}

/// Writes 4 MiB of keys.
fn fill(host: &Host) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
    runtime.expect("the machine has threads").block_on(async {
        let session = Session::open_client(&host.run_dir().join("r1/node.sock")).await.expect("the node is ready");
        let value = Datum::Text("x".repeat(60 << 10)).encode().expect("it is short enough");
        for part in 0..22 {
            let key = |number| Key::new(format!("team/{part}/{number}")).expect("it is plain");
            let writes = (0..3).map(|number| Change { key: key(number), value: Some(value.clone()) }).collect();
            let (reason, requires, level, within) = (String::new(), vec![], AckLevel::Local, SOON);
            let commit = Request::Database(Question::Commit(Commit { reason, requires, writes, level, within }));
            let bytes = codec::encode(&commit).expect("it is short enough");
            let mut replies = session.call_stream(&key::rpc("r1", "request"), bytes, SOON).expect("it is open");
            while let Some(reply) = replies.next().await {
                drop(reply.expect("the node is there"));
            }
        }
        session.close().await;
    });
}

#[track_caller]
fn check_broken(ended: &Ended) {
    assert_eq!(ended.code, Some(3), "{ended}");
    let said: Vec<&str> = ended.err.lines().filter(|line| line.starts_with("error: ")).collect();
    assert!(said.len() == 1 && said[0].contains("are not complete"), "{ended}");
}

/// If a node is killed in the middle of an export, the export leaves no file that looks complete, and none under the
/// requested name.
#[test]
fn a_broken_export_is_no_export() {
    let cluster = Cluster::new();
    let (host, node) = (cluster.here(), cluster.here().node("r1", &[]));
    fill(&host);
    let whole = host.ask(&["db", "export", "team/", "--output", "whole.toml"]);
    assert_eq!(whole.code, Some(0), "{whole}");
    let written = std::fs::read_to_string(cluster.folder().join("whole.toml")).expect("it is written");
    assert_eq!(written.lines().filter(|line| line.starts_with("\"team/")).count(), 66);
    let ended = Passage::open(&cluster, node, 2_000_000).ask(&["db", "export", "team/", "--output", "broken.toml"]);
    check_broken(&ended);
    let names = std::fs::read_dir(cluster.folder()).expect("it is there").flatten().map(|entry| entry.file_name());
    let left: Vec<_> = names.filter(|name| name.to_string_lossy().starts_with("broken")).collect();
    assert!(left.is_empty(), "{left:?}");
}

/// A part of a list is also never printed as if it were complete.
#[test]
fn a_broken_list_is_no_list() {
    let cluster = Cluster::new();
    let (host, node) = (cluster.here(), cluster.here().node("r1", &[]));
    fill(&host);
    let ended = Passage::open(&cluster, node, 2_000_000).ask(&["db", "get", "team/"]);
    check_broken(&ended);
    assert_eq!(ended.out, "");
}

/// If the output of a program breaks off, it is marked as incomplete.
#[test]
fn a_broken_log_is_told() {
    let cluster = Cluster::new();
    let (host, node) = (cluster.here(), cluster.here().node("r1", &[]));
    let _deploying = host.dca(&["deploy", &cluster.file("talker.dca", TALKER), "--no-record"]);
    let all = wait_until(SOON, || host.ask(&["logs", "talker"]).out.len() == 900_000);
    assert!(all.is_some(), "{}", host.ask(&["logs", "talker"]));
    let ended = Passage::open(&cluster, node, 300_000).ask(&["logs", "talker"]);
    check_broken(&ended);
}

/// If the disk does not accept a result, this counts as a failure.
#[test]
fn a_result_that_cannot_be_written_is_a_failure() {
    for (program, arguments) in [
        ("dca", &["explain", "E0101"][..]),
        ("dca", &["--help"]),
        ("dca", &["run", "--help"]),
        ("dca-node", &["--version"]),
    ] {
        let full = File::options().write(true).open("/dev/full").expect("Linux has it");
        let mut command = std::process::Command::new(dca_tests::cluster::executable(program));
        let ended = command.args(arguments).stdout(full).output().expect("it can be started");
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        let is_told = said.contains("standard output: No space left");
        assert!(ended.status.code() == Some(1) && is_told, "{program} {arguments:?}: {said}");
    }
}

/// If standard output is closed or read-only, a result is lost, whatever the runtime opens in its place.
#[test]
fn a_result_for_a_closed_standard_output_is_a_failure() {
    let cluster = Cluster::new();
    let (host, _node) = (cluster.here(), cluster.here().node("c1", &[]));
    let spec = cluster.file("idle.dca", "process main() { host { c1 } }\n");
    let folder = host.run_dir().display().to_string();
    let program = |name: &str| dca_tests::cluster::executable(name).display().to_string();
    let (dca, node) = (program("dca"), program("dca-node"));
    let ended = |redirection: &str, arguments: &[&str]| {
        let script = format!("exec \"$@\" {redirection}");
        let mut command = std::process::Command::new("sh");
        command.args(["-c", &script, "sh"]).args(arguments).current_dir(cluster.folder());
        let ended = command.stdin(std::process::Stdio::null()).output().expect("there is a shell");
        (ended.status.code(), String::from_utf8_lossy(&ended.stderr).into_owned())
    };
    for arguments in [
        &[&dca, "explain", "E0101"][..],
        &[&dca, "--help"],
        &[&dca, "completions", "bash"],
        &[&dca, "check", &spec],
        &[&dca, "fmt", "-"],
        &[&dca, "graph", &spec],
        &[&dca, "sim", &spec],
        &[&dca, "run", "--no-record", &spec],
        &[&dca, "deploy", "--no-record", "--run-dir", &folder, &spec],
        &[&dca, "nodes", "--run-dir", &folder],
        &[&dca, "status", "--json", "--run-dir", &folder],
        &[&dca, "db", "status", "--run-dir", &folder],
        &[&dca, "db", "put", "team/a", "1", "--run-dir", &folder],
        &[&dca, "db", "export", "team/", "--run-dir", &folder],
        &[&node, "--version"],
    ] {
        for closed in [">&-", "1</dev/null"] {
            let (code, said) = ended(closed, arguments);
            let is_told = said.contains("standard output");
            assert!(code == Some(1) && is_told, "{arguments:?} {closed}: {code:?}, {said}");
        }
    }
    // If a caller intentionally discards an output, this is not a failure: a shell, Python's `subprocess.DEVNULL`.
    // The other streams do not matter either.
    for open in [">/dev/null", "1<>/dev/null", "2>&-", "<&-"] {
        let (code, said) = ended(open, &[&dca, "explain", "E0101"]);
        assert_eq!((code, said.as_str()), (Some(0), ""), "{open}");
    }
    let (code, said) = ended(">&-", &[&dca, "fmt", &spec]);
    assert_eq!((code, said.as_str()), (Some(0), ""), "a verb without a result loses none");
}

/// The export of a database can be imported. With 100,000 keys, it needs several messages and several transactions.
#[test]
fn what_can_be_exported_can_be_imported() {
    let cluster = Cluster::new();
    let (host, _node) = (cluster.here(), cluster.here().node("r1", &[]));
    let mut file = String::from("# A database of DCA, one key a line.\nformat = 1\nbelow = \"team/\"\n\n[values]\n");
    for number in 0..100_000 {
        file.push_str(&format!("\"team/key/{number:06}\" = \"{number:0100}\"\n"));
    }
    file.push_str("# end\n");
    let path = cluster.file("many.toml", &file);
    let refused = host.ask(&["db", "import", &path, "--atomic"]);
    assert!(refused.code == Some(1) && refused.err.contains("nothing was written"), "{}", refused.err);
    let imported = host.dca(&["db", "import", &path]).ended(4 * SOON);
    assert_eq!(imported.code, Some(0), "{}", imported.err);
    assert!(imported.out.ends_with('\n') && imported.out.contains("100000 keys written in"), "{}", imported.err);
    let exported = host.dca(&["db", "export", "team/", "-o", "again.toml"]).ended(4 * SOON);
    assert_eq!(exported.code, Some(0), "{exported}");
    let again = std::fs::read_to_string(cluster.folder().join("again.toml")).expect("it is written");
    assert!(again == file, "what was imported is exported");
    let nothing = host.dca(&["db", "import", "again.toml", "--delete"]).ended(4 * SOON);
    assert!(nothing.code == Some(0) && nothing.err.contains("nothing differs"), "{}", nothing.err);
    let small = cluster.file("small.toml", "format = 1\nbelow = \"team/\"\n[values]\n\"team/a\" = 1\n\"team/b\" = 2\n");
    let atomic = host.ask(&["db", "import", &small, "--atomic", "--json"]);
    let told: serde_json::Value = serde_json::from_str(&atomic.out).expect("it is JSON");
    assert_eq!((atomic.code, told["transactions"].as_array().map(Vec::len)), (Some(0), Some(1)), "{atomic}");
    let cut_off = host.ask(&["db", "import", &small, "--delete"]);
    assert!(cut_off.code == Some(1) && cut_off.err.contains("cut off"), "{cut_off}");
}
