//! The real shim around real programs: every way a program can end, and nothing left of it afterwards.

#![expect(clippy::wildcard_enum_match_arm, reason = "a test looks for one variant and shows any other")]
#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

#[path = "shim/attach.rs"]
mod attach;
#[path = "shim/hanging.rs"]
mod hanging;
#[path = "shim/limits.rs"]
mod limits;
#[path = "shim/sandbox.rs"]
mod sandbox;
#[path = "shim/secrets.rs"]
mod secrets;

use comms::io::clock::now;
use shim::protocol::{
    EXIT_FILE, EndReason, Gate, Limits, OUTPUT_FILE, OUTPUT_FILE_OLD, OUTPUT_SIZE_MAX, ProgramEnd, Realtime, Sandbox,
    ShimOrder, ShimReport, ShimStart, SoftLimits, WatchdogBounds,
};
use std::io::{BufRead, BufReader, Lines, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// A shim under test, in its own instance directory.
struct Shim {
    dir: PathBuf,
    child: Child,
    orders: Option<ChildStdin>,
    reports: Lines<BufReader<ChildStdout>>,
}

impl Shim {
    fn start(gate: Gate, command: &[&str]) -> Self {
        Self::start_with(|start| {
            start.gate = gate;
            start.command = command.iter().map(ToString::to_string).collect();
        })
    }

    fn shell(script: &str) -> Self {
        Self::start(Gate::None, &["sh", "-c", script])
    }

    fn start_with(adjust: impl FnOnce(&mut ShimStart)) -> Self {
        Self::start_below(&[], adjust)
    }

    /// Starts a shim by a command, which gets its command line as arguments.
    fn start_below(command: &[&str], adjust: impl FnOnce(&mut ShimStart)) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let dir = std::env::temp_dir().join(format!("dca-shim-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let mut start = ShimStart {
            dir: dir.clone(),
            working_directory: dir.clone(),
            gate: Gate::None,
            agent_loss_grace: Some(Duration::from_millis(200)),
            watchdog: WatchdogBounds::default(),
            limits: Limits::default(),
            sandbox: Sandbox::default(),
            groups: Vec::new(),
            before: SoftLimits::default(),
            environment: vec![("PATH".into(), "/usr/bin:/bin".into()), ("DCA_INSTANCE".into(), "main/x".into())],
            secrets: Vec::new(),
            command: Vec::new(),
        };
        adjust(&mut start);
        let mut words = command.iter().copied().chain([env!("CARGO_BIN_EXE_dca-shim")]);
        let mut child = Command::new(words.next().unwrap())
            .args(words)
            .args(start.arguments())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let reports = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { dir, orders: child.stdin.take(), child, reports }
    }

    fn order(&mut self, order: &ShimOrder) {
        writeln!(self.orders.as_mut().unwrap(), "{order}").unwrap();
    }

    /// The next report, with the process id left out of `started`.
    fn next(&mut self) -> Option<ShimReport> {
        let line = self.reports.next()?.unwrap();
        Some(match ShimReport::parse(&line).unwrap() {
            ShimReport::Started { .. } => ShimReport::Started { pid: 0 },
            report => report,
        })
    }

    /// Reads reports to the end, and checks that the shim leaves.
    #[track_caller]
    fn expect(mut self, expected: &[ShimReport]) -> Over {
        let mut got = Vec::new();
        while let Some(report) = self.next() {
            got.push(report);
        }
        assert_eq!(got, expected);
        assert!(self.child.wait().unwrap().success());
        Over { dir: self.dir }
    }
}

/// The files that a shim leaves behind when no process is left.
struct Over {
    dir: PathBuf,
}

impl Over {
    fn read(&self, name: &str) -> String {
        String::from_utf8_lossy(&std::fs::read(self.dir.join(name)).unwrap_or_default()).into_owned()
    }
}

impl Drop for Over {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.dir).unwrap();
    }
}

const STARTED: ShimReport = ShimReport::Started { pid: 0 };
const LONG: Duration = Duration::from_secs(60);

fn exited(code: i32) -> ShimReport {
    ShimReport::Exited { code }
}

fn signalled(signal: i32) -> ShimReport {
    ShimReport::Signalled { signal }
}

/// Waits until the program has written a line to `name`, as the sign that it is where the test wants it.
fn wait_for(dir: &Path, name: &str) -> String {
    for _ in 0..200_000 {
        match std::fs::read_to_string(dir.join(name)) {
            Ok(text) if text.ends_with('\n') => return text,
            _ => std::thread::yield_now(),
        }
    }
    panic!("the program never wrote `{name}`");
}

fn is_running(pid: &str) -> bool {
    Path::new("/proc").join(pid.trim()).exists()
}

/// A pipe in the place of the output file would block the shim until it is read: it refuses before anything runs. The
/// parent of the node may have left something open: a pipe of a shell, a lock, a file with a secret.
#[test]
fn a_program_has_no_descriptor_that_nobody_has_given_it() {
    let leaky = ["sh", "-c", r#"exec 3</dev/null 7</etc/passwd 9<&0; exec "$@""#, "sh"];
    let look = "for n in 3 4 5 6 7 8 9; do [ -e /proc/$$/fd/$n ] && echo $n; done > got; ls -l /proc/$PPID/fd > shim";
    let script = ["sh", "-c", look];
    let shim = Shim::start_below(&leaky, |start| start.command = script.map(str::to_owned).to_vec());
    let over = shim.expect(&[STARTED, exited(0), ShimReport::Gone]);
    assert_eq!(over.read("got"), "");
    assert!(!over.read("shim").contains("/etc/passwd"), "nor does its shim keep it open");
}

#[test]
fn a_pipe_in_place_of_the_output_is_refused() {
    for gate in [Gate::None, Gate::Exec] {
        let shim = Shim::start_with(|start| {
            let (pipe, fifo) = (start.dir.join(OUTPUT_FILE), rustix::fs::FileType::Fifo);
            rustix::fs::mknodat(rustix::fs::CWD, &pipe, fifo, 0o600.into(), 0).unwrap();
            (start.gate, start.command) = (gate, vec!["true".into()]);
        });
        let reason = format!(
            "cannot open `{}`: it is a pipe; only regular files are written",
            shim.dir.join(OUTPUT_FILE).display()
        );
        shim.expect(&[ShimReport::ExecFailed { reason }, ShimReport::Gone]);
    }
}

/// The shim and its files have the limit of its node; the program learns of its limit by the usual signal.
#[test]
fn a_limit_of_file_sizes_ends_no_shim() {
    let text = "yes | head -c 400000; echo 1; exec head -c 400000 /dev/zero > big";
    let limited = ["sh", "-c", "ulimit -f 100; exec \"$@\"", "sh"];
    let shim = Shim::start_below(&limited, |start| start.command = ["sh", "-c", text].map(str::to_owned).to_vec());
    let (started, end) = (ShimReport::Started { pid: 0 }, ShimReport::Signalled { signal: 25 });
    let over = shim.expect(&[started, end, ShimReport::Gone]);
    assert!(std::fs::metadata(over.dir.join(OUTPUT_FILE)).unwrap().len() <= 100 << 10);
}

#[test]
fn exit_code_is_reported_and_recorded() {
    let over = Shim::shell("echo out; echo err >&2; pwd; exit 7").expect(&[STARTED, exited(7), ShimReport::Gone]);
    assert_eq!(over.read(EXIT_FILE), "exited 7\n");
    assert_eq!(over.read(OUTPUT_FILE), format!("out\nerr\n{}\n", over.dir.display()));
}

#[test]
fn environment_is_what_was_declared_and_nothing_else() {
    let shim = Shim::start(Gate::None, &["env"]);
    let over = shim.expect(&[STARTED, exited(0), ShimReport::Gone]);
    assert_eq!(over.read(OUTPUT_FILE), "DCA_INSTANCE=main/x\nPATH=/usr/bin:/bin\n");
}

#[test]
fn signal_is_reported() {
    let over = Shim::shell("kill -SEGV $$").expect(&[STARTED, signalled(11), ShimReport::Gone]);
    assert_eq!(over.read(EXIT_FILE), "signalled 11\n");
}

#[test]
fn a_script_that_kills_its_group_does_not_kill_the_shim() {
    Shim::shell("kill -KILL 0").expect(&[STARTED, signalled(9), ShimReport::Gone]);
}

#[test]
fn failure_to_execute_says_why() {
    let failed = |reason: &str| ShimReport::ExecFailed { reason: reason.to_owned() };
    let over = Shim::start(Gate::None, &["/no/such/program"])
        .expect(&[failed("cannot execute `/no/such/program`: no such file or directory"), ShimReport::Gone]);
    assert!(over.read(EXIT_FILE).starts_with("exec-failed cannot execute"));
    Shim::start(Gate::None, &["/dev/null"])
        .expect(&[failed("cannot execute `/dev/null`: permission denied"), ShimReport::Gone]);
    let shim = Shim::start_with(|start| {
        start.command = vec!["true".into()];
        start.working_directory = "/no/such/folder".into();
    });
    shim.expect(&[failed("the working directory `/no/such/folder` is not there"), ShimReport::Gone]);
}

#[test]
fn gate_holds_until_go() {
    let mut shim = Shim::start(Gate::Exec, &["sh", "-c", "exit 3"]);
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    assert!(!shim.dir.join(OUTPUT_FILE).exists(), "nothing of the program's exists at the gate");
    shim.order(&ShimOrder::Go);
    shim.expect(&[STARTED, exited(3), ShimReport::Gone]);
}

#[test]
fn stop_at_the_gate_starts_nothing() {
    for order in [ShimOrder::Kill, ShimOrder::Stop { grace: LONG }] {
        let mut shim = Shim::start(Gate::Exec, &["sh", "-c", "echo started"]);
        shim.order(&order);
        let over = shim.expect(&[ShimReport::Ready, ShimReport::Gone]);
        assert_eq!(over.read(OUTPUT_FILE), "");
    }
}

#[test]
fn stop_gives_the_program_its_grace() {
    let mut shim = Shim::shell("trap 'echo bye; exit 5' TERM; echo up > up; while :; do sleep 0.01; done");
    wait_for(&shim.dir, "up");
    shim.order(&ShimOrder::Stop { grace: LONG });
    let over = shim.expect(&[STARTED, exited(5), ShimReport::Gone]);
    assert_eq!(over.read(OUTPUT_FILE), "bye\n");
}

#[test]
fn a_program_that_does_not_listen_is_killed() {
    let mut shim = Shim::shell("trap '' TERM; echo up > up; while :; do sleep 0.01; done");
    wait_for(&shim.dir, "up");
    shim.order(&ShimOrder::Stop { grace: Duration::from_millis(50) });
    shim.expect(&[STARTED, signalled(9), ShimReport::Gone]);
}

#[test]
fn a_stopped_program_hears_the_stop() {
    let mut shim = Shim::shell("echo up > up; kill -STOP $$; exit 1");
    wait_for(&shim.dir, "up");
    shim.order(&ShimOrder::Stop { grace: LONG });
    shim.expect(&[STARTED, signalled(15), ShimReport::Gone]);
}

#[test]
fn daemons_go_with_their_program() {
    // Each is in its own session, immune to SIGTERM, and its parent is gone.
    let daemons = "for i in 1 2 3 4 5; do \
                   setsid sh -c '(trap \"\" TERM HUP; sh -c \"echo \\$PPID\" >> pids; while :; do sleep 0.01; done) &'; \
                   done; while [ $(wc -l < pids) -lt 5 ]; do sleep 0.01; done; echo up > up;";
    let check = |script: &str, end: ShimReport, order: Option<ShimOrder>| {
        let mut shim = Shim::shell(&format!("{daemons} {script}"));
        wait_for(&shim.dir, "up");
        if let Some(order) = order {
            shim.order(&order);
        }
        let over = shim.expect(&[STARTED, end, ShimReport::Gone]);
        let pids = over.read("pids");
        assert_eq!(pids.lines().count(), 5);
        for pid in pids.lines() {
            assert!(!is_running(pid), "{pid} of {script}");
        }
    };
    check("exit 0", exited(0), None);
    check("exec sleep 60", signalled(15), Some(ShimOrder::Stop { grace: LONG }));
    check("exec sleep 60", signalled(9), Some(ShimOrder::Kill));
}

#[test]
fn a_fork_bomb_ends() {
    let mut shim = Shim::shell("echo up > up; f() { sleep 30 & sleep 0.001; f; }; f & f & f & f");
    wait_for(&shim.dir, "up");
    shim.order(&ShimOrder::Kill);
    shim.expect(&[STARTED, signalled(9), ShimReport::Gone]);
}

#[test]
fn nothing_outlives_a_lost_agent() {
    let script = "trap '' TERM; setsid sleep 60 & echo $! > pid; echo $$ > up; while :; do sleep 0.01; done";
    let mut shim = Shim::shell(script);
    let pids = [wait_for(&shim.dir, "up"), wait_for(&shim.dir, "pid")];
    drop(shim.orders.take());
    let end = ShimReport::Ended { end: ProgramEnd::Signal(9), why: EndReason::AgentLost };
    let over = shim.expect(&[STARTED, end, ShimReport::Gone]);
    assert_eq!(over.read(EXIT_FILE), "ended signal 9 agent-lost\n");
    assert!(!pids.iter().any(|pid| is_running(pid)));

    let mut shim = Shim::start(Gate::Exec, &["sh", "-c", "echo started"]);
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    drop(shim.orders.take());
    shim.expect(&[ShimReport::Gone]);
}

/// A process that is left behind holds the output open. The end of the program is still reported at once.
#[test]
fn who_holds_the_output_open_holds_up_nobody() {
    let mut shim = Shim::shell("setsid sleep 60 & echo $! > pid; exit 3");
    let pid = wait_for(&shim.dir, "pid");
    assert_eq!(shim.next(), Some(STARTED));
    let began = now();
    let over = shim.expect(&[exited(3), ShimReport::Gone]);
    let took = now() - began;
    // It waits half a second for the last output; it would wait a minute for the process that holds the output open.
    assert!(took < LONG / 6, "{took:?}");
    assert!(!is_running(&pid) && over.read(EXIT_FILE) == "exited 3\n");
}

#[test]
fn a_flood_of_output_is_bounded_and_keeps_its_end() {
    let over = Shim::shell("head -c 20000000 /dev/zero | tr '\\0' 'x'; echo; echo last words").expect(&[
        STARTED,
        exited(0),
        ShimReport::Gone,
    ]);
    let sizes = [OUTPUT_FILE, OUTPUT_FILE_OLD].map(|name| over.read(name).len() as u64);
    assert!(sizes.iter().all(|size| *size < OUTPUT_SIZE_MAX + (2 << 20)), "{sizes:?}");
    assert!(sizes[1] >= OUTPUT_SIZE_MAX);
    let text = over.read(OUTPUT_FILE_OLD) + &over.read(OUTPUT_FILE);
    assert!(text.ends_with("last words\n") || text.contains("bytes of output were dropped here"));
}

#[test]
fn wrong_arguments_are_usage() {
    let output = Command::new(env!("CARGO_BIN_EXE_dca-shim")).arg("--gate").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(String::from_utf8_lossy(&output.stderr), "dca-shim: argument `--gate`: needs a value\n");
}

fn limited(limits: Limits, script: &str) -> Shim {
    Shim::start_with(|start| {
        start.limits = limits;
        start.command = ["sh", "-c", script].map(str::to_owned).to_vec();
    })
}

#[test]
fn a_program_has_its_limits_from_the_start() {
    let usage = Limits {
        memory: Some(512 << 20),
        cpu: Some(Duration::from_secs(90)),
        files: Some(64),
        nice: Some(7),
        file_size: Some(1 << 20),
        ..Limits::default()
    };
    let script = "ulimit -v; ulimit -t; ulimit -n; nice; ulimit -f";
    let over = limited(usage, script).expect(&[STARTED, exited(0), ShimReport::Gone]);
    let output = over.read(OUTPUT_FILE);
    let (memory, others) = output.split_once('\n').unwrap();
    // A control group limits memory where this host lets a program have one.
    assert!(memory == "524288" || memory == "unlimited", "{output}");
    assert_eq!(others, "90\n64\n7\n2048\n");
}

/// A node raises its own limit; programs that use select(2) must not find it raised.
#[test]
fn a_program_has_the_soft_limit_that_it_is_given() {
    let shim = Shim::start_with(|start| {
        start.before.descriptors = Some(100);
        start.command = ["sh", "-c", "ulimit -Sn; [ $(ulimit -Hn) = unlimited ] || [ $(ulimit -Hn) -gt 100 ]"]
            .map(str::to_owned)
            .to_vec();
    });
    let over = shim.expect(&[STARTED, exited(0), ShimReport::Gone]);
    assert_eq!(over.read(OUTPUT_FILE), "100\n");
}

/// A node writes no core of itself; its programs may, as far as the node itself was allowed to.
#[test]
fn a_program_has_the_core_limit_that_it_is_given() {
    let shim = Shim::start_with(|start| {
        start.before.core = Some(0);
        start.command = ["sh", "-c", "ulimit -Sc"].map(str::to_owned).to_vec();
    });
    let over = shim.expect(&[STARTED, exited(0), ShimReport::Gone]);
    assert_eq!(over.read(OUTPUT_FILE), "0\n");
}

/// No kernel allows more open files than it has numbers for.
#[test]
fn what_the_kernel_refuses_is_one_sentence() {
    let usage = Limits { files: Some(u64::MAX >> 1), ..Limits::default() };
    let reason = "a limit of 9223372036854775807 open files is refused: operation not permitted".to_owned();
    limited(usage, "echo ran").expect(&[STARTED, ShimReport::ExecFailed { reason }, ShimReport::Gone]);
}

#[test]
fn what_is_not_there_is_named_behind_limits_too() {
    let shim = Shim::start_with(|start| {
        start.limits.nice = Some(1);
        start.command = vec!["/no/such/program".to_owned()];
    });
    let reason = "cannot execute `/no/such/program`: no such file or directory".to_owned();
    shim.expect(&[STARTED, ShimReport::ExecFailed { reason }, ShimReport::Gone]);
}

/// The class is the 41st field. Source: proc_pid_stat(5).
#[test]
fn real_time_is_given_or_refused_as_the_policy_says() {
    let probe = Command::new("chrt").args(["--fifo", "5", "true"]).stderr(Stdio::null()).status();
    let is_allowed = probe.is_ok_and(|status| status.success());
    let with = |is_optional| Limits { realtime: Some(Realtime { priority: 5, is_optional }), ..Limits::default() };
    let script = "cut -d' ' -f41 /proc/$$/stat";
    let over = limited(with(true), script).expect(&[STARTED, exited(0), ShimReport::Gone]);
    let class = over.read(OUTPUT_FILE);
    assert!(class.ends_with(if is_allowed { "1\n" } else { "0\n" }), "{class}");
    assert_eq!(class.contains("it runs without"), !is_allowed, "{class}");
    let mut shim = limited(with(false), script);
    let mut reports = Vec::new();
    while let Some(report) = shim.next() {
        reports.push(report);
    }
    let is_refused = |report: &ShimReport| matches!(report, ShimReport::ExecFailed { reason } if reason.starts_with("real-time priority 5 is refused"));
    assert_eq!(reports.iter().any(is_refused), !is_allowed, "{reports:?}");
    drop(Over { dir: shim.dir.clone() });
    assert!(shim.child.wait().unwrap().success());
}

/// Output continues in a new file when the old one is removed or moved away. There are at most two files of 1 MiB.
#[test]
fn output_goes_on_when_its_file_is_taken_away() {
    // Each line is written before the next order: the test does something with the file in between.
    let script = "while :; do read -r line < orders && printf '%s\\n' \"$line\"; done";
    for (what, expected) in
        [("removed", "second\n"), ("moved", "second\n"), ("emptied", "second\n"), ("left", "first\nsecond\n")]
    {
        let mut shim = Shim::start(Gate::Exec, &["sh", "-c", script]);
        let (orders, file) = (shim.dir.join("orders"), shim.dir.join(OUTPUT_FILE));
        rustix::fs::mkfifoat(rustix::fs::CWD, &orders, rustix::fs::Mode::RWXU).unwrap();
        assert_eq!(shim.next(), Some(ShimReport::Ready));
        shim.order(&ShimOrder::Go);
        assert_eq!(shim.next(), Some(STARTED));
        let say = |word: &str| std::fs::write(&orders, format!("{word}\n")).unwrap();
        let wait_for = |expected: &str| {
            let give_up = now() + Duration::from_secs(30);
            while std::fs::read_to_string(&file).unwrap_or_default() != expected {
                assert!(now() < give_up, "{what}: {:?}", std::fs::read_to_string(&file));
                std::thread::yield_now();
            }
        };
        say("first");
        wait_for("first\n");
        match what {
            "removed" => std::fs::remove_file(&file).unwrap(),
            "moved" => std::fs::rename(&file, shim.dir.join("elsewhere")).unwrap(),
            "emptied" => std::fs::write(&file, "").unwrap(),
            _ => {}
        }
        say("second");
        wait_for(expected);
        shim.order(&ShimOrder::Kill);
        shim.expect(&[signalled(9), ShimReport::Gone]);
    }
}

/// Output has an end also where the old file cannot be put aside.
#[test]
fn output_has_an_end_where_it_cannot_be_put_aside() {
    let script = "mkdir out.log.1; head -c 5000000 /dev/zero";
    let over = Shim::shell(script).expect(&[STARTED, exited(0), ShimReport::Gone]);
    assert!(over.read(OUTPUT_FILE).len() as u64 <= OUTPUT_SIZE_MAX + (64 << 10), "{}", over.read(OUTPUT_FILE).len());
}
