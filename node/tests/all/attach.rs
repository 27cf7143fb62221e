//! Attaching to real shims that an earlier run of the node has started.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock::now;
use node::io::child::{self, Attached, ShimOrders, ShimReports};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};
use shim::process_record::{ProcessRecord, RECORD_FILE};
use shim::processes;
use shim::protocol::{Gate, OUTPUT_FILE, SOCKET_FILE, ShimOrder, ShimReport, ShimStart};
use std::io::ErrorKind;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use tokio::runtime::Runtime;
use tokio::sync::mpsc::{Receiver, Sender, channel};

/// The folder of one program, and the runtime of its node.
struct Place {
    dir: PathBuf,
    runtime: Runtime,
}

/// The reports of a shim, each with the last lines of output if it is an end.
type Reports = Receiver<(ShimReport, Vec<String>)>;

impl Place {
    fn new(name: &str) -> Self {
        let dir = std::env::temp_dir().join(format!("dca-attach-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        Self { dir, runtime: Runtime::new().unwrap() }
    }

    /// Starts a shim that continues without a node.
    fn start(&self, gate: Gate, script: &str) -> (ShimOrders, ShimReports) {
        let template = ShimStart::parse(["--directory", "/d", "--", "sh", "-c", script].map(Into::into)).unwrap();
        let environment =
            vec![("PATH".into(), "/usr/bin:/bin".into()), ("DCA_DIR".into(), self.dir.display().to_string())];
        let start = ShimStart {
            dir: self.dir.clone(),
            working_directory: self.dir.clone(),
            gate,
            agent_loss_grace: None,
            environment,
            ..template
        };
        let _runtime = self.runtime.enter();
        child::start(&shim(), &start).unwrap()
    }

    /// Ends everything of the node's, as kill -9 does.
    fn lose(&mut self) {
        self.runtime = Runtime::new().unwrap();
    }

    fn attach(&self, known: u64) -> std::io::Result<Attached> {
        let _runtime = self.runtime.enter();
        child::attach(&self.dir, known)
    }

    /// Lets orders and reports flow, as the node does.
    fn serve(&self, orders: ShimOrders, reports: ShimReports) -> (Sender<ShimOrder>, Reports) {
        let ((sender, queue), (sink, arriving)) = (channel(4), channel(4));
        drop(self.runtime.spawn(orders.pass(Vec::new(), queue)));
        drop(self.runtime.spawn(reports.listen(sink)));
        (sender, arriving)
    }

    fn next(&self, reports: &mut Reports) -> Option<(ShimReport, Vec<String>)> {
        self.runtime.block_on(reports.recv())
    }

    fn record(&self) -> ProcessRecord {
        ProcessRecord::parse(&std::fs::read_to_string(self.dir.join(RECORD_FILE)).unwrap())
    }

    /// The shim stays a child of this process, which has to take note of its end.
    fn reap(&self, shim: Pid) {
        waitpid(Some(shim), WaitOptions::empty()).unwrap();
    }

    fn shim(&self) -> Pid {
        Pid::from_raw(self.record().shim.unwrap().pid).unwrap()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.dir).unwrap();
    }
}

fn shim() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let shim = test.parent().and_then(Path::parent).unwrap().join("dca-shim");
    assert!(shim.exists(), "`cargo build --workspace --bins` makes the shim");
    shim
}

/// Starts a program that runs for a minute, and loses it once it runs.
fn lost(name: &str) -> Place {
    let mut place = Place::new(name);
    let (orders, reports) = place.start(Gate::None, "sleep 60");
    let (_sender, mut reports) = place.serve(orders, reports);
    assert!(matches!(place.next(&mut reports), Some((ShimReport::Started { .. }, _))));
    place.lose();
    place
}

#[test]
fn a_second_run_hears_the_end_and_gives_the_orders() {
    let mut place = Place::new("end");
    std::fs::write(place.dir.join("out.log"), "of the one before\n").unwrap();
    let (orders, reports) = place.start(Gate::Exec, "echo first words; read line < never; exit 4");
    rustix::fs::mkfifoat(rustix::fs::CWD, place.dir.join("never"), rustix::fs::Mode::RWXU).unwrap();
    let (sender, mut reports) = place.serve(orders, reports);
    assert_eq!(place.next(&mut reports), Some((ShimReport::Ready, Vec::new())));
    place.runtime.block_on(sender.send(ShimOrder::Go)).unwrap();
    assert!(matches!(place.next(&mut reports), Some((ShimReport::Started { .. }, _))));
    let shim = place.shim();
    place.lose();

    let Attached { orders, reports, taken, missed } = place.attach(2).unwrap();
    assert_eq!((taken, missed), (1, 0));
    let (sender, mut reports) = place.serve(orders, reports);
    // Once the pipe can be written to, the program is past its first line.
    std::fs::write(place.dir.join("never"), "go on\n").unwrap();
    assert_eq!(
        place.next(&mut reports),
        Some((ShimReport::Exited { code: 4 }, vec!["first words".to_owned()])),
        "and nothing of the program before"
    );
    assert_eq!(place.next(&mut reports), Some((ShimReport::Gone, Vec::new())));
    assert_eq!(place.next(&mut reports), None);
    drop(sender);

    place.reap(shim);
    assert_eq!(place.attach(2).unwrap_err().kind(), ErrorKind::NotFound);
    assert_eq!(
        child::ended(&place.dir),
        None,
        "a record that is there is of a program whose node does not know its end"
    );
    assert_eq!(child::ended_output(&place.dir), ["first words"]);
}

#[test]
fn a_shim_that_is_killed_takes_its_program_along_and_is_reported_gone() {
    let place = lost("killed");
    let Attached { orders, reports, .. } = place.attach(1).unwrap();
    let (sender, mut reports) = place.serve(orders, reports);
    let (shim, program) = (place.shim(), place.record().program.unwrap());
    kill_process(shim, Signal::KILL).unwrap();
    assert_eq!(place.next(&mut reports), Some((ShimReport::Gone, Vec::new())));
    assert_eq!(place.next(&mut reports), None);
    assert!(!processes::is_running(program));
    drop(sender);
    place.reap(shim);
    assert_eq!(place.attach(1).unwrap_err().kind(), ErrorKind::ConnectionRefused);
    assert_eq!(child::ended(&place.dir), None);
}

/// A program can write to its folder. A process that it names there in its own place is not ended, unless it runs as
/// the same user.
#[test]
fn a_program_that_names_a_process_of_somebody_else_does_not_have_it_killed() {
    if !rustix::process::getuid().is_root() {
        return println!("skipped: needs root, for a process of another user");
    }
    let place = lost("named");
    // Not a child of this process, which would be ended as a leftover of a killed shim.
    let orphan = "sleep 60 > /dev/null 2>&1 & echo $!";
    let said = Command::new("sh").args(["-c", orphan]).uid(65_534).output().unwrap().stdout;
    let named = processes::stat(String::from_utf8(said).unwrap().trim().parse().unwrap()).unwrap().process;
    let record = ProcessRecord { program: None, ..place.record() };
    std::fs::write(place.dir.join(RECORD_FILE), record.head() + &ProcessRecord::program_line(named)).unwrap();
    let Attached { orders, reports, .. } = place.attach(1).unwrap();
    let (sender, mut reports) = place.serve(orders, reports);
    let shim = place.shim();
    kill_process(shim, Signal::KILL).unwrap();
    assert_eq!(place.next(&mut reports), Some((ShimReport::Gone, Vec::new())));
    assert_eq!(place.next(&mut reports), None);
    drop(sender);
    place.reap(shim);
    assert!(processes::is_running(named), "it is none of the program's");
    processes::signal(named, Signal::KILL);
    // Nor is the target of a program's link shown.
    std::fs::remove_file(place.dir.join(OUTPUT_FILE)).unwrap();
    std::fs::write(place.dir.join("secret"), "a secret\n").unwrap();
    std::os::unix::fs::symlink(place.dir.join("secret"), place.dir.join(OUTPUT_FILE)).unwrap();
    assert_eq!(child::ended_output(&place.dir), Vec::<String>::new());
}

/// Traces its parent, with the options that it is given, and takes note of nothing.
const TRACER: &str = "
import ctypes, os, signal, sys
ptrace = ctypes.CDLL(None).ptrace
ptrace.argtypes = [ctypes.c_long, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
SEIZE = 0x4206
print('traced' if ptrace(SEIZE, os.getppid(), None, int(sys.argv[1])) == 0 else 'refused', flush=True)
while True:
    signal.pause()
";
/// `PTRACE_O_TRACEEXIT`: a traced process stops before it ends. Source: ptrace(2).
const TRACE_EXIT: u32 = 0x40;

/// A traced process is dead only for its tracer until that collects it, or does not even die before the tracer allows
/// it. Here the tracer is the program itself.
#[test]
fn a_shim_that_its_program_traces_leaves_nothing_either() {
    for (name, options) in [("traced", 0), ("held", TRACE_EXIT)] {
        let place = Place::new(name);
        let tracer = place.dir.join("tracer.py");
        std::fs::write(&tracer, TRACER).unwrap();
        let (orders, reports) = place.start(Gate::None, &format!("exec python3 {} {options}", tracer.display()));
        let (sender, mut reports) = place.serve(orders, reports);
        assert!(matches!(place.next(&mut reports), Some((ShimReport::Started { .. }, _))));
        let program = place.record().program.unwrap();
        let said = || std::fs::read_to_string(place.dir.join(OUTPUT_FILE)).unwrap_or_default();
        while !said().ends_with('\n') {
            std::thread::yield_now();
        }
        if said() == "traced\n" {
            child::leftovers::kill_shim(&place.dir);
            assert_eq!(place.next(&mut reports), Some((ShimReport::Gone, Vec::new())), "{name}");
        } else {
            println!("skipped: needs root, to trace a process");
            place.runtime.block_on(sender.send(ShimOrder::Kill)).unwrap();
            while place.next(&mut reports).is_some() {}
        }
        assert!(!processes::is_running(program), "{name}");
        drop(sender);
        assert_eq!(place.next(&mut reports), None, "{name}");
    }
}

#[test]
fn a_suspended_shim_does_not_hold_its_node_up() {
    let place = lost("suspended");
    let shim = place.shim();
    kill_process(shim, Signal::STOP).unwrap();
    // A signal is on its way for a while, and the threads that it has not reached still answer.
    let threads = || std::fs::read_dir(format!("/proc/{shim}/task")).unwrap().flatten();
    let stands = |stat: String| stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('T'));
    while !threads().all(|thread| std::fs::read_to_string(thread.path().join("stat")).is_ok_and(stands)) {
        std::thread::yield_now();
    }
    let began = now();
    assert_eq!(place.attach(1).unwrap_err().kind(), ErrorKind::TimedOut);
    let waiting = crowd(&place.dir.join(SOCKET_FILE));
    assert_eq!(place.attach(1).unwrap_err().kind(), ErrorKind::TimedOut);
    assert!(now() - began < Duration::from_secs(20));
    drop(waiting);

    kill_process(shim, Signal::CONT).unwrap();
    let Attached { orders, reports, taken, missed } = place.attach(0).unwrap();
    assert_eq!((taken, missed), (0, 1), "that it was started was not heard");
    let (sender, mut reports) = place.serve(orders, reports);
    assert!(matches!(place.next(&mut reports), Some((ShimReport::Started { .. }, _))));
    place.runtime.block_on(sender.send(ShimOrder::Kill)).unwrap();
    assert_eq!(place.next(&mut reports), Some((ShimReport::Signalled { signal: 9 }, Vec::new())));
    assert_eq!(place.next(&mut reports), Some((ShimReport::Gone, Vec::new())));
    drop(sender);
    place.reap(shim);
}

/// A program whose shim is suspended ends unseen by that. Its node sees it, and has the shim go on, which says how it has ended.
#[test]
fn the_end_of_a_program_is_told_although_its_shim_was_suspended() {
    for is_attached in [false, true] {
        let mut place = Place::new(&format!("unseen-{is_attached}"));
        let (orders, reports) = place.start(Gate::None, "sleep 60");
        let (sender, mut reports) = place.serve(orders, reports);
        assert!(matches!(place.next(&mut reports), Some((ShimReport::Started { .. }, _))));
        let shim = place.shim();
        let mut told = (sender, reports);
        if is_attached {
            place.lose();
            let Attached { orders, reports, .. } = place.attach(1).unwrap();
            told = place.serve(orders, reports);
        }
        kill_process(shim, Signal::STOP).unwrap();
        processes::signal(place.record().program.unwrap(), Signal::KILL);
        assert_eq!(place.next(&mut told.1), Some((ShimReport::Signalled { signal: 9 }, Vec::new())), "{is_attached}");
        assert_eq!(place.next(&mut told.1), Some((ShimReport::Gone, Vec::new())));
        drop(told);
        if is_attached {
            place.reap(shim);
        }
    }
}

/// The first process of a container gets the orphans of all others. An orphan that is still there at the next look is reaped.
#[test]
#[expect(clippy::zombie_processes, reason = "the node waits for it")]
fn an_orphan_that_has_ended_does_not_stay() {
    let orphan = Command::new("true").spawn().unwrap();
    let pid = orphan.id().cast_signed();
    while processes::stat(pid).is_some_and(|stat| !stat.is_zombie) {
        std::thread::yield_now();
    }
    // Another test that ends leftovers may have reaped it by now.
    let seen = processes::stat(pid).into_iter().map(|stat| stat.process).collect();
    child::leftovers::reap_orphans(&seen);
    assert_eq!(processes::stat(pid), None);
}

/// Returns as many connections as the kernel lets wait.
fn crowd(socket: &Path) -> Vec<OwnedFd> {
    let address = SocketAddrUnix::new(socket).unwrap();
    let one = || {
        let one = socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::NONBLOCK, None).unwrap();
        connect(&one, &address).is_ok().then_some(one)
    };
    std::iter::from_fn(one).collect()
}

/// The folders of ended programs cost the successor of their node one look at the processes, and not one each. The program of a killed shim is
/// ended, and that of a living one is not.
#[test]
fn ended_programs_cost_a_successor_nothing() {
    let node = std::env::temp_dir().join(format!("dca-attach-{}-successor", std::process::id()));
    let place = |deployment: &str| {
        let dir = node.join(deployment).join("0");
        std::fs::create_dir_all(&dir).unwrap();
        let mut place = Place { dir, runtime: Runtime::new().unwrap() };
        let (orders, reports) = place.start(Gate::None, "sleep 60");
        let (_sender, mut reports) = place.serve(orders, reports);
        assert!(matches!(place.next(&mut reports), Some((ShimReport::Started { .. }, _))));
        place.lose();
        place
    };
    let (living, forgotten, killed) = (place("living.9"), place("forgotten.9"), place("killed.9"));
    let programs = [&living, &forgotten, &killed].map(|place| place.record().program.unwrap());
    let shims = [&living, &forgotten, &killed].map(Place::shim);
    kill_process(shims[2], Signal::KILL).unwrap();
    for number in 0..1600 {
        std::fs::create_dir_all(node.join(format!("ended.{}", number % 8)).join(number.to_string())).unwrap();
    }
    let known = [living.dir.clone()].into();
    child::leftovers::end_others(&node, &known);
    assert_eq!(programs.map(processes::is_running), [true, false, false]);
    assert_eq!([&living, &killed].map(|place| place.dir.join(RECORD_FILE).exists()), [true, false]);

    let began = now();
    (0..20).for_each(|_| assert!(!processes::all().is_empty()));
    let look = (now() - began) / 20;
    let began = now();
    child::leftovers::end_others(&node, &known);
    let took = now() - began;
    println!("1,600 folders of ended programs: {took:?}, one look at the processes: {look:?}");
    assert!(took < 400 * look, "{took:?} of {look:?}");
    assert!(processes::is_running(programs[0]));
    kill_process(shims[0], Signal::KILL).unwrap();
    processes::signal(programs[0], Signal::KILL);
    [&living, &forgotten, &killed].iter().zip(shims).for_each(|(place, shim)| place.reap(shim));
    drop((living, forgotten, killed));
    std::fs::remove_dir_all(&node).unwrap();
}

/// Files of an earlier program in the folder are not taken for those of the program that is being started.
#[test]
fn a_start_clears_the_traces_of_the_program_before() {
    let place = Place::new("before");
    std::fs::write(place.dir.join("exit"), "exited 7\n").unwrap();
    let template = ShimStart::parse(["--directory", "/d", "--", "true"].map(Into::into)).unwrap();
    let start = ShimStart { dir: place.dir.clone(), ..template };
    let _runtime = place.runtime.enter();
    assert_eq!(child::start(Path::new("/no/such/shim"), &start).unwrap_err().kind(), ErrorKind::NotFound);
    assert_eq!(child::ended(&place.dir), None);
}
