//! Programs that meet their limits, with the control groups of this host.

use super::{LONG, STARTED, Shim, exited, is_running, limited, signalled, wait_for};
use shim::protocol::{EndReason, LimitKind, Limits, OUTPUT_FILE, ProgramEnd, ShimOrder, ShimReport};
use std::path::Path;
use std::time::Duration;

fn ended(end: ProgramEnd, why: EndReason) -> ShimReport {
    ShimReport::Ended { end, why }
}

/// Each of its processes makes another one, again and again.
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

/// Reads all reports.
fn reports(shim: &mut Shim) -> Vec<ShimReport> {
    std::iter::from_fn(|| shim.next()).collect()
}

/// The reason why this host gives programs no control group for the limit in the reports, if so.
fn missing_group(reports: &[ShimReport], what: &str) -> Option<String> {
    let [ShimReport::ExecFailed { reason }, ShimReport::Gone] = reports else { return None };
    assert!(reason.starts_with(&format!("a limit of {what} is refused: it needs the control group")), "{reason}");
    Some(reason.clone())
}

/// The existing groups of programs.
fn groups() -> Vec<String> {
    let folder = |name: &str| std::fs::read_dir(Path::new("/sys/fs/cgroup").join(name)).into_iter().flatten().flatten();
    let all = ["pids", "memory", "cpu", ""].into_iter().flat_map(folder);
    all.filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name.starts_with("dca-program-"))
        .collect()
}

#[test]
fn who_has_too_much_memory_is_told_as_such() {
    let bytes = 30_000_000;
    let with = Limits { memory: Some(bytes), ..Limits::default() };
    let mut shim = limited(with.clone(), "exec tail /dev/zero");
    let killed = ended(ProgramEnd::Signal(9), EndReason::OutOfMemory(bytes));
    match &reports(&mut shim)[..] {
        // Without a group its own allocation fails.
        [STARTED, ShimReport::Exited { code: 1 }, ShimReport::Gone] => {
            println!("skipped: no control group for memory");
            return;
        }
        all => assert_eq!(all, [STARTED, killed, ShimReport::Gone]),
    }
    // If one of its processes is killed and the program fails, that is the reason; a program that then ends well is
    // done.
    let failed = ended(ProgramEnd::Exit(3), EndReason::OutOfMemory(bytes));
    limited(with.clone(), "tail /dev/zero; exit 3").expect(&[STARTED, failed, ShimReport::Gone]);
    limited(with, "tail /dev/zero; exit 0").expect(&[STARTED, exited(0), ShimReport::Gone]);
}

/// Neither the bomb nor its group is left, and nothing outside of it is touched.
#[test]
fn a_fork_bomb_stays_within_its_limit_and_leaves_nothing() {
    let with = Limits { pids: Some(40), ..Limits::default() };
    let mut shim = limited(with, &format!("echo up > up; exec python3 -c '{BOMB}'"));
    let first = shim.next();
    if let Some(refused @ ShimReport::ExecFailed { .. }) = &first {
        let reason = missing_group(&[refused.clone(), ShimReport::Gone], "40 processes");
        println!("skipped: {}", reason.unwrap());
        return;
    }
    assert_eq!(first, Some(STARTED));
    wait_for(&shim.dir, "up");
    let name = format!("dca-program-{}-", shim.child.id());
    let own = || groups().into_iter().find(|group| group.starts_with(&name));
    let group = own().expect("the shim has made a group");
    let members = || {
        let text = std::fs::read_to_string(format!("/sys/fs/cgroup/pids/{group}/cgroup.procs")).unwrap_or_default();
        text.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let full = (0..1_000_000).map(|_| members()).find(|members| members.len() == 40);
    let bombs = full.expect("the bomb fills its group");
    shim.order(&ShimOrder::Stop { grace: Duration::from_millis(50) });
    shim.expect(&[signalled(9), ShimReport::Gone]);
    assert_eq!(own(), None);
    assert!(!bombs.iter().any(|pid| is_running(pid)));
}

#[test]
fn who_fails_for_want_of_a_process_is_told_as_such() {
    let with = Limits { pids: Some(8), ..Limits::default() };
    let mut shim = limited(with, "for i in 1 2 3 4 5 6 7 8 9; do sleep 1000 & done; exit 0");
    let all = reports(&mut shim);
    if let Some(reason) = missing_group(&all, "8 processes") {
        println!("skipped: {reason}");
        return;
    }
    let [STARTED, ShimReport::Ended { end: ProgramEnd::Exit(_), why }, ShimReport::Gone] = &all[..] else {
        panic!("{all:?}");
    };
    assert_eq!(*why, EndReason::Limit(LimitKind::Pids, 8));
}

#[test]
fn who_uses_up_its_time_or_writes_too_much_is_told_as_such() {
    let with = Limits { cpu: Some(Duration::from_secs(1)), ..Limits::default() };
    let why = EndReason::Limit(LimitKind::Cpu, 1);
    for (script, signal) in [("while :; do :; done", 24), ("trap '' XCPU; while :; do :; done", 9)] {
        let end = ended(ProgramEnd::Signal(signal), why);
        limited(with.clone(), script).expect(&[STARTED, end, ShimReport::Gone]);
    }
    let with = Limits { file_size: Some(4096), ..Limits::default() };
    let end = ended(ProgramEnd::Signal(25), EndReason::Limit(LimitKind::FileSize, 4096));
    let over = limited(with, "exec head -c 100000 /dev/zero > big").expect(&[STARTED, end, ShimReport::Gone]);
    assert_eq!(over.read("big").len(), 4096);
}

#[test]
fn a_share_of_the_processors_is_that_of_its_group() {
    let with = Limits { cpu_share: Some(250), ..Limits::default() };
    let script =
        "grep -o ':cpu[^:]*:.*dca-program-.*' /proc/$$/cgroup; cat /sys/fs/cgroup/cpu/dca-program-*/cpu.cfs_quota_us";
    let mut shim = limited(with, script);
    let all = reports(&mut shim);
    if let Some(reason) = missing_group(&all, "0.25 processors") {
        println!("skipped: {reason}");
        return;
    }
    assert_eq!(all.first(), Some(&STARTED));
    let output = std::fs::read_to_string(shim.dir.join(OUTPUT_FILE)).unwrap();
    assert!(output.contains("dca-program-") || Path::new("/sys/fs/cgroup/cgroup.controllers").is_file(), "{output}");
    assert!(output.lines().any(|line| line == "25000"), "{output}");
}

/// In a mount namespace without the hierarchy of `pids`.
#[test]
fn what_a_host_cannot_hold_is_refused_before_anything_runs() {
    let hide = "umount -l /sys/fs/cgroup/pids /sys/fs/cgroup/unified && exec \"$@\"";
    let probe = std::process::Command::new("unshare").args(["--mount", "sh", "-c", hide, "sh", "true"]).status();
    if !probe.is_ok_and(|status| status.success()) {
        println!("skipped: no mount namespace, or no hierarchy of version 1");
        return;
    }
    let shim = Shim::start_below(&["unshare", "--mount", "sh", "-c", hide, "sh"], |start| {
        start.limits.pids = Some(8);
        start.gate = shim::protocol::Gate::Exec;
        start.agent_loss_grace = Some(LONG);
        start.command = vec!["true".to_owned()];
    });
    let reason =
        "a limit of 8 processes is refused: it needs the control group `pids`, and this host has none".to_owned();
    shim.expect(&[ShimReport::ExecFailed { reason }, ShimReport::Gone]);
}

/// A program that waits at a gate is refused there, not at its turn in the middle of a mission.
#[test]
fn what_the_kernel_refuses_is_refused_at_the_gate() {
    let files = 99_999_999_999;
    let mut shim = Shim::start_with(|start| {
        start.limits.files = Some(files);
        start.gate = shim::protocol::Gate::Exec;
        start.command = vec!["true".to_owned()];
    });
    let all = reports(&mut shim);
    let [ShimReport::ExecFailed { reason }, ShimReport::Gone] = &all[..] else { panic!("{all:?}") };
    assert!(reason.starts_with(&format!("a limit of {files} open files is refused: ")), "{reason}");
}

/// A real-time priority that the kernel does not have beside a share of the processors is refused in words, or done
/// without.
#[test]
fn a_priority_beside_a_share_of_the_processors_is_had_or_refused_in_words() {
    for is_optional in [true, false] {
        let mut shim = Shim::start_with(|start| {
            start.limits.realtime = Some(shim::protocol::Realtime { priority: 10, is_optional });
            start.limits.cpu_share = Some(500);
            start.command = vec!["true".to_owned()];
        });
        let all = reports(&mut shim);
        match &all[..] {
            [STARTED, ShimReport::Exited { code: 0 }, ShimReport::Gone] => {}
            [ShimReport::ExecFailed { reason }, ShimReport::Gone]
            | [STARTED, ShimReport::ExecFailed { reason }, ShimReport::Gone] => {
                let is_group = reason.starts_with("a limit of 0.5 processors is refused");
                let is_priority = !is_optional && reason.starts_with("real-time priority 10 is refused: ");
                assert!(is_group || is_priority, "{reason}");
            }
            _ => panic!("{all:?}"),
        }
    }
}
