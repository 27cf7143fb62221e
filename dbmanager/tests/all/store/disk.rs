//! Processes that are killed, disks that are full, disks that fail: acknowledged data is kept, failures are reported,
//! and earlier data can be read at any time.

use super::child::{self, Order};
use super::{ENGINE, Folder, Robot, on_each_engine, open};
use dbmanager::io::store::Engine;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

/// Returns the output of a child, line by line.
fn said(mut command: Command) -> Vec<String> {
    let output = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let output = output.wait_with_output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    text.lines().map(str::to_owned).collect()
}

/// Checks the output of a child that met one kind of trouble, which its errors name. The child got the error, could
/// still read, opened its store again with all acknowledged transactions, and continued.
fn check_trouble(lines: &[String], dir: &Path, (trouble, count): (&str, u64)) {
    let number = |line: &str, word: &str| line.strip_prefix(word).map(|number| number.parse::<u64>().unwrap());
    let (mut acked, mut failures) = (0, 0);
    for line in lines {
        if let Some(seq) = number(line, "ack ") {
            assert!(seq > acked);
            acked = seq;
        } else if let Some(seq) = number(line, "open ") {
            assert!(seq >= acked, "{acked} were acknowledged, {seq} are there");
        } else if let Some(keys) = number(line, "readable ") {
            assert!(keys > 0 || acked <= 1);
        } else if let Some(error) = line.strip_prefix("failed ") {
            failures += 1;
            assert!(error.starts_with("store `") && error.contains(trouble), "{error}");
        }
    }
    assert!(failures > 0, "there was no trouble");
    assert!(acked >= count);
    assert!(Robot::open(open(dir).unwrap()).unwrap().committed() >= acked);
}

#[test]
fn killed_at_any_moment() {
    kill(40);
}

#[test]
#[ignore = "long: 200 kills"]
fn killed_again_and_again_at_any_moment() {
    kill(200);
}

fn kill(times: u64) {
    on_each_engine(|| {
        let folder = Folder::new();
        let mut acked = 0;
        for round in 0..times {
            let mut command = child::command(&[], (Order::Commit, &folder.store(), u64::MAX));
            let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
            let mut lines = BufReader::new(child.stdout.take().unwrap());
            let mut heed = |line: &str| {
                if let Some(seq) = line.strip_prefix("open ") {
                    let there: u64 = seq.trim().parse().unwrap();
                    assert!(there >= acked, "round {round}: {acked} were acknowledged, {there} are there");
                }
                if let Some(seq) = line.strip_prefix("ack ") {
                    acked = seq.trim().parse().unwrap();
                }
                line.starts_with("ack ")
            };
            let (mut seen, mut line) = (0, String::new());
            while seen <= round % 23 {
                line.clear();
                assert_ne!(lines.read_line(&mut line).unwrap(), 0, "the child is gone");
                seen += u64::from(heed(&line));
            }
            child.kill().unwrap();
            child.wait().unwrap();
            // The last line before the kill counts if it is complete.
            let mut rest = String::new();
            lines.read_to_string(&mut rest).unwrap();
            for line in rest.split_inclusive('\n').filter(|line| line.ends_with('\n')) {
                heed(line);
            }
        }
        assert!(acked > times);
        assert!(Robot::open(open(&folder.store()).unwrap()).unwrap().committed() >= acked);
    });
}

/// Runs a child with `strace`, which makes some of its system calls fail. `strace` counts the calls of each thread
/// separately.
fn injected(folder: &Folder, inject: &str, count: u64) -> Option<Vec<String>> {
    if Command::new("strace").arg("--version").stdout(Stdio::null()).status().is_err() {
        println!("skipped: needs strace");
        return None;
    }
    let calls = format!("trace={}", inject.split(':').next().unwrap());
    let wrapper = ["strace", "-f", "-qq", "-o", "/dev/null", "-e", &calls, "-e", &format!("inject={inject}")];
    Some(said(child::command(&wrapper, (Order::Commit, &folder.store(), count))))
}

#[test]
fn fsync_eio_once() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let Some(lines) = injected(&folder, "fdatasync:error=EIO:when=30", 60) else { return };
        check_trouble(&lines, &folder.store(), ("Input/output error", 60));
        assert_eq!(lines.iter().filter(|line| line.starts_with("failed ")).count(), 1);
    });
}

#[test]
fn every_write_fails_for_a_while() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let Some(lines) = injected(&folder, "pwrite64:error=EIO:when=40..60", 400) else { return };
        check_trouble(&lines, &folder.store(), ("Input/output error", 400));
    });
}

#[test]
fn disk_full_then_freed() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let Some(lines) = injected(&folder, "pwrite64:error=ENOSPC:when=40..60", 400) else { return };
        check_trouble(&lines, &folder.store(), ("No space left on device", 400));
    });
}

/// A store that could not be created completely does not count as damaged: it is created once there is space.
#[test]
fn disk_full_at_birth() {
    on_each_engine(|| {
        for call in 1..=3 {
            let folder = Folder::quick();
            let Some(lines) = injected(&folder, &format!("pwrite64:error=ENOSPC:when={call}"), 3) else { return };
            let closed: Vec<&String> = lines.iter().filter(|line| line.starts_with("closed ")).collect();
            // Each thread of sled has a call with that number.
            let range = if ENGINE.get() == Engine::Redb { 1..=1 } else { 0..=50 };
            let full = closed.iter().all(|line| line.contains("No space left on device"));
            assert!(range.contains(&closed.len()) && full, "{closed:?}");
            assert!(Robot::open(open(&folder.store()).unwrap()).unwrap().committed() >= 3);
        }
    });
}

/// The same with a disk that is really full, until the child removes the ballast file.
#[test]
fn a_small_disk_runs_full() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let disk = folder.0.to_str().unwrap();
        let mount = format!(
            "mount -t tmpfs -o size=4m tmpfs {disk} && head -c 3800000 /dev/zero >{disk}/ballast && \
         \"$@\" && cp -r {disk}/db {disk}/db.witness \"$RESULT\""
        );
        let result = Folder::quick();
        let unshare = ["unshare", "--mount", "--map-root-user"];
        let may = Command::new(unshare[0]).args(&unshare[1..]).args(["mount", "-t", "tmpfs", "tmpfs", disk]).output();
        if !may.is_ok_and(|output| output.status.success()) {
            println!("skipped: needs root, or namespaces that others may make");
            return;
        }
        let wrapper: Vec<&str> = unshare.into_iter().chain(["sh", "-ec", &mount, "sh"]).collect();
        let mut command = child::command(&wrapper, (Order::Commit, &folder.store(), 6000));
        command.env("RESULT", &result.0);
        check_trouble(&said(command), &result.store(), ("No space left on device", 6000));
    });
}
