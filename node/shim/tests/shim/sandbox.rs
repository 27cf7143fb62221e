//! Programs in a sandbox: their remaining rights, and the calls that they can no longer make.

use super::{STARTED, Shim, exited};
use rustix::process::getuid;
use shim::protocol::{
    Account, Gate, Judged, JudgedBy, Limits, OUTPUT_FILE, Realtime, Sandbox, SandboxLevel, ShimOrder, ShimReport,
    ShimStart, Stamp,
};
use std::fs::Permissions;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::Path;
use std::process::{Command, Stdio};

/// A user without rights, on every Linux.
const NOBODY: u32 = 65534;

/// Runs a script in the standard sandbox, as user `nobody` if this test may do that; returns its output.
fn confined(script: &str, adjust: impl FnOnce(&mut ShimStart)) -> String {
    let user = getuid().is_root().then(|| Account { uid: NOBODY, gid: NOBODY, groups: vec![20] });
    let shim = Shim::start_with(|start| {
        start.sandbox = Sandbox { level: SandboxLevel::Standard, user, own: None, judged: None };
        start.command = ["sh", "-c", script].map(str::to_owned).to_vec();
        adjust(start);
    });
    shim.expect(&[STARTED, exited(0), ShimReport::Gone]).read(OUTPUT_FILE)
}

/// The record of a process in /proc. Source: proc_pid_status(5).
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

/// The levels of the sandbox on this kernel, as the shim prints them.
fn levels() -> String {
    let said = Command::new(env!("CARGO_BIN_EXE_dca-shim")).arg("--sandbox-levels").output().unwrap();
    assert!(said.status.success());
    String::from_utf8(said.stdout).unwrap()
}

/// Root without capabilities still owns the files of the system and the settings of the kernel, and may make user namespaces: in the
/// sandbox none of this is possible. The setting is replaced by itself.
#[test]
fn what_the_kernel_offers_is_taken_too() {
    if !getuid().is_root() {
        println!("skipped: needs root");
        return;
    }
    let found = levels();
    let script = "touch $OWN/here && (touch /etc/dca-shim-test) 2> /dev/null && rm /etc/dca-shim-test && echo landlock; \
        setting=/proc/sys/kernel/core_pattern; value=$(cat $setting); \
        (echo \"$value\" > $setting) 2> /dev/null && echo setting; \
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
    for (level, word, what) in [
        ("landlock", "landlock", "a file of the system is made"),
        ("landlock", "setting", "a setting of the kernel is changed"),
        ("seccomp", "seccomp", "a namespace is made"),
    ] {
        if found.contains(level) && free.contains(word) {
            assert!(!confined.contains(word), "{what}: {confined}");
        } else {
            println!("skipped: no {level} here, or nothing that it takes: {found}; {free}");
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
    // An exit code of the program itself is not taken for a refusal.
    let shim = Shim::start_with(|start| {
        start.sandbox.level = SandboxLevel::Standard;
        start.command = ["sh", "-c", "exit 126"].map(str::to_owned).to_vec();
    });
    shim.expect(&[STARTED, exited(126), ShimReport::Gone]);
}

/// Makes an executable script; returns the judgement of it.
fn judged(path: &Path, text: &str, by: JudgedBy) -> Judged {
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
    let path = std::fs::canonicalize(path).unwrap();
    let stamp = Stamp::of(&std::fs::metadata(&path).unwrap());
    Judged { path, stamp, by }
}

/// Waits at its gate with a command that a node has judged, while something happens.
fn meanwhile(command: &Path, judged: Judged, limits: Limits, happens: impl FnOnce()) -> Shim {
    let mut shim = Shim::start_with(|start| {
        start.gate = Gate::Exec;
        start.limits = limits;
        start.sandbox.judged = Some(judged);
        start.command = vec![command.display().to_string()];
    });
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    happens();
    shim.order(&ShimOrder::Go);
    shim
}

/// A link is turned round between the judgement of a node and the start: the file that was judged runs, and no other.
#[test]
fn what_was_judged_runs_wherever_a_link_leads_by_then() {
    let folder = std::env::temp_dir().join(format!("dca-judged-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [good, evil, link] = ["good", "evil", "link"].map(|name| folder.join(name));
    let real_time = Limits { realtime: Some(Realtime { priority: 5, is_optional: true }), ..Limits::default() };
    for (by, limits) in
        [(JudgedBy::Folder, Limits::default()), (JudgedBy::Hash, Limits::default()), (JudgedBy::Hash, real_time)]
    {
        let is_good = judged(&good, "#!/bin/sh\necho good as $0\n", by);
        judged(&evil, "#!/bin/sh\necho evil\n", by);
        std::fs::remove_file(&link).unwrap_or_default();
        symlink(&good, &link).unwrap();
        let turned = || {
            std::fs::remove_file(&link).unwrap();
            symlink(&evil, &link).unwrap();
        };
        let ran = meanwhile(&link, is_good.clone(), limits, turned);
        let said = ran.expect(&[STARTED, exited(0), ShimReport::Gone]).read(OUTPUT_FILE);
        let name =
            if by == JudgedBy::Folder { is_good.path.display().to_string() } else { "/proc/self/fd/".to_owned() };
        assert!(said.starts_with(&format!("good as {name}")), "{by:?}: {said}");
        // Any program except a script gets the name in the spec.
        let shell = std::fs::canonicalize("/bin/sh").unwrap();
        let stamp = Stamp::of(&std::fs::metadata(&shell).unwrap());
        let shim = Shim::start_with(|start| {
            start.sandbox.judged = Some(Judged { path: shell, stamp, by });
            start.command = ["/nowhere/sh", "-c", "echo as $0; ls /proc/self/fd | wc -l"].map(str::to_owned).to_vec();
        });
        let said = shim.expect(&[STARTED, exited(0), ShimReport::Gone]).read(OUTPUT_FILE);
        assert_eq!(said, "as /nowhere/sh\n4\n", "nothing of it stays open");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// The file itself is changed, or another one has its name: nothing runs.
#[test]
fn a_file_that_was_exchanged_after_the_judgement_does_not_run() {
    let folder = std::env::temp_dir().join(format!("dca-exchanged-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let [program, other, evil] = ["program", "other", "evil"].map(|name| folder.join(name));
    let written = || std::fs::write(&program, "#!/bin/sh\ntouch /tmp/evil\n").unwrap();
    let renamed = || std::fs::rename(&other, &program).unwrap();
    let linked = || {
        std::fs::remove_file(&program).unwrap();
        symlink(&evil, &program).unwrap();
    };
    let happenings: [(&dyn Fn(), &str); 3] =
        [(&written, "was changed"), (&renamed, "was changed"), (&linked, "was changed")];
    for by in [JudgedBy::Folder, JudgedBy::Hash] {
        for (happens, why) in happenings {
            std::fs::remove_file(&program).unwrap_or_default();
            let good = judged(&program, "#!/bin/sh\necho good\n", by);
            judged(&other, "#!/bin/sh\necho other\n", by);
            judged(&evil, "#!/bin/sh\necho evil\n", by);
            let (path, shim) = (good.path.clone(), meanwhile(&program, good, Limits::default(), happens));
            let reason =
                format!("`{}` {why} or exchanged after the policy had admitted it; deploy it again", path.display());
            let ended = shim.expect(&[STARTED, ShimReport::ExecFailed { reason }, ShimReport::Gone]);
            assert_eq!(ended.read(OUTPUT_FILE), "", "nothing has run");
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}
