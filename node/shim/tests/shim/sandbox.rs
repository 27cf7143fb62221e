//! Programs in a sandbox: what they have left, and what they cannot do any more.

use super::{STARTED, Shim, exited};
use rustix::process::getuid;
use shim::protocol::{Account, Limits, OUTPUT_FILE, Realtime, Sandbox, SandboxLevel, ShimReport, ShimStart};
use std::process::{Command, Stdio};

/// A user without rights, on every Linux.
const NOBODY: u32 = 65534;

/// Runs a script in the standard sandbox, as nobody where this test may do that; returns its output.
fn confined(script: &str, adjust: impl FnOnce(&mut ShimStart)) -> String {
    let user = getuid().is_root().then(|| Account { uid: NOBODY, gid: NOBODY, groups: vec![20] });
    let shim = Shim::start_with(|start| {
        start.sandbox = Sandbox { level: SandboxLevel::Standard, user, own: None };
        start.command = ["sh", "-c", script].map(str::to_owned).to_vec();
        adjust(start);
    });
    shim.expect(&[STARTED, exited(0), ShimReport::Gone]).read(OUTPUT_FILE)
}

/// What /proc says of a process. Source: proc_pid_status(5).
const STATUS: &str =
    "grep -E '^(Uid|Gid|Groups|CapInh|CapPrm|CapEff|CapBnd|CapAmb|NoNewPrivs):' /proc/self/status | tr -s '\t ' ' '";

#[test]
fn a_program_in_a_sandbox_has_no_rights() {
    let output = confined(STATUS, |_| {});
    let has = |line: &str| output.lines().any(|one| one.trim_end() == line);
    for set in ["CapInh", "CapPrm", "CapEff", "CapAmb"] {
        assert!(has(&format!("{set}: 0000000000000000")), "{output}");
    }
    assert!(has("NoNewPrivs: 1"), "{output}");
    if getuid().is_root() {
        assert!(has("CapBnd: 0000000000000000") && has("Groups: 20"), "{output}");
        for ids in ["Uid", "Gid"] {
            assert!(has(&format!("{ids}: {NOBODY} {NOBODY} {NOBODY} {NOBODY}")), "{output}");
        }
    } else {
        println!("skipped: needs root to run as another user");
    }
}

/// Each would work for root.
#[test]
fn a_program_in_a_sandbox_gets_nowhere() {
    if !getuid().is_root() {
        println!("skipped: needs root to run as another user");
        return;
    }
    let attempts = [
        ("head -c1 /etc/shadow", "a file of root is read"),
        ("kill -9 $PPID", "the shim is killed"),
        ("cat /proc/$PPID/environ", "its memory is looked at"),
        ("echo 0 > $DCA_OWN/exit", "the record of its end is written"),
        ("chown 0 /proc/self/fd/1", "it changes an owner"),
    ];
    let attempt = |(command, what): &(&str, &str)| format!("if ({command}) > /dev/null 2>&1; then echo {what}; fi; ");
    let script: String = attempts.iter().map(attempt).collect();
    let output = confined(&script, |start| {
        let own = start.dir.display().to_string();
        start.environment.push(("DCA_OWN".into(), own));
    });
    assert_eq!(output, "");
}

#[test]
fn root_without_capabilities_stays_without_them() {
    if !getuid().is_root() {
        println!("skipped: needs root");
        return;
    }
    let output = confined(STATUS, |start| start.sandbox.user = None);
    assert!(output.contains("Uid: 0 0 0 0") && output.contains("CapEff: 0000000000000000"), "{output}");
    assert!(output.contains("CapBnd: 0000000000000000"), "{output}");
}

/// What this kernel has of the sandbox, as the shim says.
fn levels() -> String {
    let said = Command::new(env!("CARGO_BIN_EXE_dca-shim")).arg("--sandbox-levels").output().unwrap();
    assert!(said.status.success());
    String::from_utf8(said.stdout).unwrap()
}

/// Root without capabilities owns the files of the system all the same, and may make namespaces of users: in the sandbox neither.
#[test]
fn what_the_kernel_offers_is_taken_too() {
    if !getuid().is_root() {
        println!("skipped: needs root");
        return;
    }
    let found = levels();
    let script = "touch $OWN/here && (touch /etc/dca-shim-test) 2> /dev/null && rm /etc/dca-shim-test && echo landlock; \
        unshare --user true 2> /dev/null && echo seccomp; cat /etc/passwd > /dev/null; true";
    let confine = |level| {
        let shim = Shim::start_with(|start| {
            start.sandbox.level = level;
            start.environment.push(("OWN".into(), start.dir.display().to_string()));
            start.command = ["sh", "-c", script].map(str::to_owned).to_vec();
        });
        let over = shim.expect(&[STARTED, exited(0), ShimReport::Gone]);
        assert!(over.dir.join("here").exists(), "in its own folder it writes");
        over.read(OUTPUT_FILE)
    };
    let free = confine(SandboxLevel::None);
    let confined = confine(SandboxLevel::Standard);
    for (word, what) in [("landlock", "a file of the system is made"), ("seccomp", "a namespace is made")] {
        if found.contains(word) && free.contains(word) {
            assert!(!confined.contains(word), "{what}: {confined}");
        } else {
            println!("skipped: no {word} here, or nothing that it takes: {found}; {free}");
        }
    }
}

/// The class is the 41st field. Source: proc_pid_stat(5).
#[test]
fn a_program_in_a_sandbox_keeps_its_class_and_its_limits() {
    let probe = Command::new("chrt").args(["--fifo", "5", "true"]).stderr(Stdio::null()).status();
    if !probe.is_ok_and(|status| status.success()) {
        println!("skipped: this host gives no real-time priority");
        return;
    }
    let output = confined("cut -d' ' -f41 /proc/self/stat; ulimit -n; id -u", |start| {
        let realtime = Some(Realtime { priority: 5, is_optional: false });
        start.limits = Limits { realtime, files: Some(64), ..Limits::default() };
    });
    let user = if getuid().is_root() { NOBODY } else { getuid().as_raw() };
    assert_eq!(output, format!("1\n64\n{user}\n"));
}

#[test]
fn what_a_sandboxed_program_is_refused_is_said() {
    let shim = Shim::start_with(|start| {
        start.sandbox.level = SandboxLevel::Standard;
        start.command = vec!["/no/such/program".to_owned()];
    });
    let reason = "cannot execute `/no/such/program`: no such file or directory".to_owned();
    shim.expect(&[STARTED, ShimReport::ExecFailed { reason }, ShimReport::Gone]);
    // A code of its own is not taken for that.
    let shim = Shim::start_with(|start| {
        start.sandbox.level = SandboxLevel::Standard;
        start.command = ["sh", "-c", "exit 126"].map(str::to_owned).to_vec();
    });
    shim.expect(&[STARTED, exited(126), ShimReport::Gone]);
}
