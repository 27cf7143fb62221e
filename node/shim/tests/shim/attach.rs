//! A shim whose agent is gone, and the agents that attach to it.

use super::{LONG, Over, STARTED, Shim, exited, wait_for};
use rustix::process::{Pid, Signal, kill_process};
use shim::process_record::RECORD_FILE;
use shim::protocol::{
    AttachReply, AttachRequest, EXIT_FILE, EndReason, Gate, OUTPUT_FILE, ProgramEnd, SOCKET_FILE, ShimOrder,
    ShimReport, ShimStart,
};
use std::io::{BufRead, BufReader, ErrorKind, Lines, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Runs for at most a minute, and ends with 5 when asked to.
const POLITE: &str = "trap 'exit 5' TERM; echo up > up; i=0; while [ $((i+=1)) -lt 6000 ]; do sleep 0.01; done";
/// Runs for at most a minute, whatever it is told.
const STUBBORN: &str = "trap '' TERM; echo up > up; i=0; while [ $((i+=1)) -lt 6000 ]; do sleep 0.01; done";
/// Ends with 9 when a file exists.
const WAITING: &str = "echo up > up; while [ ! -e end ]; do sleep 0.01; done; exit 9";

/// A shim without its agent.
struct Lost {
    dir: PathBuf,
    child: Child,
}

/// An agent that has attached.
struct Agent {
    orders: UnixStream,
    reports: Lines<BufReader<UnixStream>>,
    taken: u64,
}

impl Lost {
    /// Closes both pipes of a shim, as the death of its agent does.
    fn of(shim: Shim) -> Self {
        let Shim { dir, child, orders, reports } = shim;
        drop((orders, reports));
        Self { dir, child }
    }

    fn connect(&self) -> UnixStream {
        UnixStream::connect(self.dir.join(SOCKET_FILE)).unwrap()
    }

    fn attach(&self, reports: u64) -> Agent {
        let mut orders = self.connect();
        writeln!(orders, "{}", AttachRequest { reports }).unwrap();
        let mut reports = BufReader::new(orders.try_clone().unwrap()).lines();
        let taken = AttachReply::parse(&reports.next().unwrap().unwrap()).unwrap().orders;
        Agent { orders, reports, taken }
    }

    /// Waits until the shim has left by itself; only its files may be left.
    #[track_caller]
    fn left(mut self) -> Over {
        assert!(self.child.wait().unwrap().success());
        for name in [SOCKET_FILE, RECORD_FILE] {
            assert!(!self.dir.join(name).exists(), "{name}");
        }
        Over { dir: self.dir }
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }
}

impl Agent {
    fn order(&mut self, order: &ShimOrder) {
        writeln!(self.orders, "{order}").unwrap();
    }

    /// The next report, with the process id left out of `started`.
    fn next(&mut self) -> Option<ShimReport> {
        let report = ShimReport::parse(&self.reports.next()?.unwrap()).unwrap();
        Some(if matches!(report, ShimReport::Started { .. }) { STARTED } else { report })
    }

    #[track_caller]
    fn expect(mut self, expected: &[ShimReport]) {
        let got: Vec<ShimReport> = std::iter::from_fn(|| self.next()).collect();
        assert_eq!(got, expected);
    }
}

/// Starts a shim that continues without an agent, or whose agent has a grace.
fn start(gate: Gate, grace: Option<Duration>, script: &str) -> Shim {
    Shim::start_with(|start| {
        start.gate = gate;
        start.agent_loss_grace = grace;
        start.command = ["sh", "-c", script].map(str::to_owned).to_vec();
    })
}

#[test]
fn a_new_agent_gets_what_it_does_not_have_and_goes_on_with_the_orders() {
    for (known, expected) in [(0, vec![STARTED, exited(5), ShimReport::Gone]), (1, vec![exited(5), ShimReport::Gone])] {
        let mut shim = start(Gate::None, None, POLITE);
        assert_eq!(shim.next(), Some(STARTED));
        wait_for(&shim.dir, "up");
        let lost = Lost::of(shim);
        let mode = lost.dir.join(SOCKET_FILE).metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        let mut agent = lost.attach(known);
        assert_eq!(agent.taken, 0);
        agent.order(&ShimOrder::Stop { grace: LONG });
        agent.expect(&expected);
        assert_eq!(lost.left().read(EXIT_FILE), "exited 5\n");
    }
}

#[test]
fn what_ends_without_an_agent_leaves_its_cause() {
    for (last, record) in [("exit 9", "exited 9\n"), ("kill -SEGV $$", "signalled 11\n")] {
        let shim = start(Gate::None, None, &WAITING.replace("exit 9", last));
        wait_for(&shim.dir, "up");
        let lost = Lost::of(shim);
        std::fs::write(lost.dir.join("end"), "").unwrap();
        assert_eq!(lost.left().read(EXIT_FILE), record);
    }
}

/// The disk does not take the record, and no agent hears: the shim stays until one of the two changes, or its folder is
/// gone.
#[test]
fn an_end_that_the_disk_does_not_take_waits_for_an_agent_or_the_disk() {
    for (is_agent_first, is_folder_gone) in [(true, false), (false, false), (false, true)] {
        let mut shim = start(Gate::None, None, &WAITING.replace("exit 9", "echo ended > ended; exit 9"));
        assert_eq!(shim.next(), Some(STARTED));
        wait_for(&shim.dir, "up");
        let lost = Lost::of(shim);
        // In the place of the file that becomes the record.
        let in_the_way = lost.dir.join("exit.new");
        std::fs::create_dir(&in_the_way).unwrap();
        std::fs::write(lost.dir.join("end"), "").unwrap();
        wait_for(&lost.dir, "ended");
        if is_agent_first {
            lost.attach(1).expect(&[exited(9), ShimReport::Gone]);
        }
        if is_folder_gone {
            let elsewhere = lost.dir.with_extension("gone");
            std::fs::rename(&lost.dir, &elsewhere).unwrap();
            let over = lost.left();
            std::fs::rename(&elsewhere, &over.dir).unwrap();
            continue;
        }
        std::fs::remove_dir(&in_the_way).unwrap();
        let over = lost.left();
        assert!(is_agent_first || over.read(EXIT_FILE) == "exited 9\n");
    }
}

/// The end comes while one agent is there and another waits behind it.
#[test]
fn an_end_between_two_agents_is_told_whole_or_not_at_all() {
    let mut shim = start(Gate::None, None, WAITING);
    // An agent that has had more reports than a shim has made means another shim.
    assert_eq!(shim.next(), Some(STARTED));
    wait_for(&shim.dir, "up");
    let lost = Lost::of(shim);
    let first = lost.attach(1);
    let second = lost.connect();
    std::fs::write(lost.dir.join("end"), "").unwrap();
    drop(first);
    (&second).write_all(b"attach 1\n").unwrap();
    let mut told = String::new();
    // A shim that leaves closes waiting connections; then the record has the end.
    match (&second).read_to_string(&mut told) {
        Ok(_) => assert!(["", "attached 0\nexited 9\ngone\n"].contains(&told.as_str()), "{told}"),
        Err(error) => assert_eq!(error.kind(), ErrorKind::ConnectionReset),
    }
    assert_eq!(lost.left().read(EXIT_FILE), "exited 9\n");
}

#[test]
fn orders_on_their_way_are_counted_and_half_ones_are_not() {
    let mut shim = start(Gate::Exec, None, POLITE);
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    kill_process(Pid::from_child(&shim.child), Signal::STOP).unwrap();
    shim.order(&ShimOrder::Go);
    // As a program would be stopped that has 5 s.
    shim.orders.as_mut().unwrap().write_all(b"stop 5").unwrap();
    let lost = Lost::of(shim);
    lost.signal(Signal::CONT);
    let mut agent = lost.attach(1);
    assert_eq!((agent.taken, agent.next()), (1, Some(STARTED)));
    wait_for(&lost.dir, "up");
    agent.orders.write_all(b"no order\nstop ").unwrap();
    drop(agent);
    let mut agent = lost.attach(2);
    assert_eq!(agent.taken, 1);
    agent.order(&ShimOrder::Stop { grace: LONG });
    agent.expect(&[exited(5), ShimReport::Gone]);
    drop(lost.left());
}

#[test]
fn a_grace_stops_the_program_and_nobody_undoes_it() {
    let shim = start(Gate::None, Some(LONG), POLITE);
    wait_for(&shim.dir, "up");
    assert_eq!(Lost::of(shim).left().read(EXIT_FILE), "ended exit 5 agent-lost\n");

    let mut shim = start(Gate::None, Some(Duration::from_secs(5)), STUBBORN);
    assert!(matches!(shim.next(), Some(ShimReport::Started { .. })), "an agent that has this attaches");
    wait_for(&shim.dir, "up");
    let lost = Lost::of(shim);
    let agent = lost.attach(1);
    let killed = ShimReport::Ended { end: ProgramEnd::Signal(9), why: EndReason::AgentLost };
    agent.expect(&[killed, ShimReport::Gone]);
    assert_eq!(lost.left().read(EXIT_FILE), "ended signal 9 agent-lost\n");
}

#[test]
fn at_the_gate_a_grace_is_the_time_to_attach() {
    let grace = Duration::from_secs(2);
    let mut shim = start(Gate::Exec, Some(Duration::from_millis(50)), "echo started");
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    assert_eq!(Lost::of(shim).left().read(OUTPUT_FILE), "");

    let mut shim = start(Gate::Exec, Some(grace), "echo started; exit 3");
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    let lost = Lost::of(shim);
    let mut agent = lost.attach(1);
    agent.orders.set_read_timeout(Some(grace + Duration::from_millis(200))).unwrap();
    let silence = agent.reports.next().unwrap().unwrap_err();
    assert_eq!(silence.kind(), ErrorKind::WouldBlock, "the grace is over, and the shim waits");
    agent.orders.set_read_timeout(None).unwrap();
    agent.order(&ShimOrder::Go);
    agent.expect(&[STARTED, exited(3), ShimReport::Gone]);
    assert_eq!(lost.left().read(OUTPUT_FILE), "started\n");
}

#[test]
fn a_kept_program_waits_at_its_gate() {
    let mut shim = start(Gate::Exec, None, "exit 3");
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    let lost = Lost::of(shim);
    drop(lost.attach(1));
    let mut agent = lost.attach(1);
    assert_eq!(agent.taken, 0);
    agent.order(&ShimOrder::Go);
    agent.expect(&[STARTED, exited(3), ShimReport::Gone]);
    drop(lost.left());

    let mut shim = start(Gate::Exec, None, "echo started");
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    let lost = Lost::of(shim);
    let mut agent = lost.attach(0);
    agent.order(&ShimOrder::Kill);
    agent.expect(&[ShimReport::Ready, ShimReport::Gone]);
    assert_eq!(lost.left().read(OUTPUT_FILE), "");
}

#[test]
fn the_end_of_an_earlier_program_is_not_this_ones() {
    let mut shim = Shim::start_with(|start| {
        std::fs::write(start.dir.join(EXIT_FILE), "exited 7\n").unwrap();
        std::fs::write(start.dir.join(SOCKET_FILE), "").unwrap();
        (start.gate, start.command) = (Gate::Exec, vec!["true".to_owned()]);
    });
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    assert!(!shim.dir.join(EXIT_FILE).exists());
    shim.order(&ShimOrder::Go);
    assert_eq!(shim.expect(&[STARTED, exited(0), ShimReport::Gone]).read(EXIT_FILE), "exited 0\n");
}

#[test]
fn twenty_agents_one_after_the_other() {
    let mut shim = start(Gate::Exec, None, POLITE);
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    shim.order(&ShimOrder::Go);
    wait_for(&shim.dir, "up");
    let lost = Lost::of(shim);
    for round in 0..20 {
        let mut agent = lost.attach(round % 3);
        assert_eq!(agent.taken, 1 + round);
        let had = usize::try_from(round % 3).unwrap();
        for report in &[ShimReport::Ready, STARTED][had..] {
            assert_eq!(agent.next().as_ref(), Some(report));
        }
        agent.order(&ShimOrder::Go);
    }
    let mut agent = lost.attach(2);
    assert_eq!(agent.taken, 21);
    agent.order(&ShimOrder::Stop { grace: LONG });
    agent.expect(&[exited(5), ShimReport::Gone]);
    drop(lost.left());
}

#[test]
fn what_is_no_agent_is_closed_and_that_is_all() {
    let mut shim = start(Gate::Exec, None, POLITE);
    assert_eq!(shim.next(), Some(ShimReport::Ready));
    let lost = Lost::of(shim);
    let long = vec![b'a'; 100_000];
    for garbage in [&b"go\n"[..], b"attach\n", b"attach x\n", b"attach 99\n", b"\xff\xfe\n", b"\n", &long] {
        let mut stranger = lost.connect();
        // It may be closed before all of it is written.
        stranger.write_all(garbage).unwrap_or_default();
        let mut answer = Vec::new();
        match stranger.read_to_end(&mut answer) {
            Ok(_) => {}
            Err(error) => assert_eq!(error.kind(), ErrorKind::ConnectionReset),
        }
        assert_eq!(answer, b"");
    }
    // A client that sends nothing, and one that is gone in the middle of its line.
    let silent = lost.connect();
    lost.connect().write_all(b"attach 0").unwrap();
    let mut agent = lost.attach(1);
    assert_eq!(agent.taken, 0);
    drop(silent);
    agent.order(&ShimOrder::Go);
    assert_eq!(agent.next(), Some(STARTED));
    wait_for(&lost.dir, "up");
    agent.order(&ShimOrder::Stop { grace: LONG });
    agent.expect(&[exited(5), ShimReport::Gone]);
    drop(lost.left());
}

/// If the agent was gone before the socket was opened, no later agent would find the shim.
#[test]
fn a_shim_whose_agent_is_gone_at_its_start_starts_nothing() {
    for (gate, grace) in [(Gate::None, None), (Gate::Exec, None), (Gate::None, Some(LONG)), (Gate::Exec, Some(LONG))] {
        let dir = std::env::temp_dir().join(format!("dca-late-{}-{gate:?}-{}", std::process::id(), grace.is_none()));
        std::fs::create_dir_all(&dir).unwrap();
        std::fs::write(dir.join(EXIT_FILE), "exited 7\n").unwrap();
        let template = ShimStart::parse(["--directory", "/d", "--", "touch", "started"].map(Into::into)).unwrap();
        let start =
            ShimStart { dir: dir.clone(), working_directory: dir.clone(), gate, agent_loss_grace: grace, ..template };
        let (input, orders) = std::io::pipe().unwrap();
        // An order that was never counted.
        (&orders).write_all(b"go\n").unwrap();
        drop(orders);
        let mut shim = Command::new(env!("CARGO_BIN_EXE_dca-shim"));
        let output = shim.args(start.arguments()).stdin(input).stdout(Stdio::piped()).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stdout), "gone\n");
        assert!(output.status.success());
        let over = Over { dir };
        assert_eq!(over.read(EXIT_FILE), "exited 7\n", "the folder may be another's");
        assert_eq!(files(&over.dir), [EXIT_FILE]);
    }
}

fn files(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).unwrap().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}
