//! Real nodes: after a crash, on a full disk, in a crowd.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock::{Wakeup, now};
use rustix::process::Signal;
use shim::process_record::{Process, ProcessRecord, RECORD_FILE};
use shim::processes;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

/// How long anything may take on a machine that is busy.
const SOON: Duration = Duration::from_secs(60);
/// More than the soft limit of descriptors that a node is started with, and than zenoh lets wait by itself.
const SILENT: usize = 700;

/// A folder with everything that a test starts; dropping it kills the remaining processes.
struct Place {
    folder: PathBuf,
    nodes: Vec<Child>,
    left: Vec<Process>,
}

impl Place {
    fn new(name: &str) -> Self {
        // With a sign at its end no name begins another: the leftovers of a test are found by the name of its folder.
        let folder = std::env::temp_dir().join(format!("ds{}{name}_", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Self { folder, nodes: Vec::new(), left: Vec::new() }
    }

    fn command(&self, program: &str, arguments: &[&str]) -> Command {
        let mut command = Command::new(program);
        command.args(arguments).arg("--run-dir").arg(self.folder.join("n")).stdin(Stdio::null());
        command.current_dir(&self.folder).env_remove("RUST_LOG");
        command
    }

    /// Starts the node `c1` and waits until it prints that it is ready. Its programs end with it.
    fn node(&mut self) -> Process {
        self.node_with(&["--agent-loss-grace", "0.1"])
    }

    fn node_with(&mut self, options: &[&str]) -> Process {
        let node = Path::new(env!("CARGO_BIN_EXE_dca")).with_file_name("dca-node").display().to_string();
        // It becomes the node: the process id stays.
        let limited = ["-c", "ulimit -Sn 400; exec \"$@\"", "sh", &node, "--name", "c1"];
        let mut command = self.command("sh", &limited);
        command.args(options).arg("--state").arg(self.folder.join("s"));
        command.stdout(Stdio::piped()).stderr(Stdio::null());
        let mut node = command.spawn().unwrap();
        let lines = BufReader::new(node.stdout.take().unwrap()).lines();
        assert!(lines.map_while(Result::ok).any(|line| line.contains("is ready")), "the node starts");
        let process = processes::stat(node.id().cast_signed()).unwrap().process;
        self.nodes.push(node);
        process
    }

    /// Writes a spec of one plain program, which is a script.
    fn spec(&self, script: &str) -> String {
        let pids = self.folder.join("pids");
        std::fs::write(self.folder.join("script"), script.replace("PIDS", &pids.display().to_string())).unwrap();
        let spec = self.folder.join("left.dca");
        let exec = format!("sh {}/script", self.folder.display());
        let text = format!(
            "module Script(host) {{ exec \"{exec}\"; plain; done; }}\nprocess main() {{\n    host {{ \"c1\" }}\n    \
             instantiated_processes {{ a instof Script(\"c1\"); }}\n    internal_event_actions {{ a }}\n}}\n"
        );
        std::fs::write(&spec, text).unwrap();
        spec.display().to_string()
    }

    /// Runs `dca` to its end.
    fn ask(&self, arguments: &[&str]) -> Output {
        self.command(env!("CARGO_BIN_EXE_dca"), arguments).output().unwrap()
    }

    /// Deploys one plain program and waits until `count` processes have written their numbers; returns those.
    fn deploy(&mut self, script: &str, count: usize) -> Vec<Process> {
        let (spec, pids) = (self.spec(script), self.folder.join("pids"));
        let mut deploy = self.command(env!("CARGO_BIN_EXE_dca"), &["deploy", &spec]);
        self.nodes.push(deploy.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap());
        let read = || std::fs::read_to_string(&pids).unwrap_or_default();
        wait("the programs run", || read().lines().count() == count && read().ends_with('\n'));
        let process = |pid: &str| processes::stat(pid.trim().parse().unwrap()).unwrap().process;
        self.left = read().lines().map(process).collect();
        self.left.clone()
    }

    /// Kills the node and the only shim; neither hears of the other's end.
    fn crash(&self, node: Process) {
        let record = find(&self.folder.join("n"), RECORD_FILE).expect("the shim has written who runs");
        let record = ProcessRecord::parse(&std::fs::read_to_string(record).unwrap());
        let shim = record.shim.unwrap();
        for (process, signal) in [(shim, Signal::STOP), (node, Signal::KILL), (shim, Signal::KILL)] {
            processes::signal(process, signal);
        }
        wait("they are gone", || !processes::is_running(node) && !processes::is_running(shim));
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let ours = |process: &Process| {
            let command = std::fs::read(format!("/proc/{}/cmdline", process.pid)).unwrap_or_default();
            let name = self.folder.display().to_string();
            String::from_utf8_lossy(&command).contains(&name)
        };
        let left = processes::all().into_iter().map(|stat| stat.process).filter(ours);
        left.chain(self.left.clone()).for_each(|process| processes::signal(process, Signal::KILL));
        for node in &mut self.nodes {
            drop(node.wait());
        }
        drop(std::fs::remove_dir_all(&self.folder));
    }
}

#[track_caller]
fn wait(what: &str, condition: impl Fn() -> bool) {
    let (began, pause) = (now(), Wakeup::default());
    while !condition() {
        assert!(now() - began < SOON, "{what}: not within {SOON:?}");
        pause.wait(Some(now() + Duration::from_millis(5)));
    }
}

/// Returns the first file of a name below a folder.
fn find(folder: &Path, name: &str) -> Option<PathBuf> {
    std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).find_map(|path| {
        if path.is_dir() { find(&path, name) } else { path.file_name().is_some_and(|own| own == name).then_some(path) }
    })
}

/// A program that does not listen, a child of its session without an environment, a daemon with one.
#[test]
fn a_node_ends_what_its_killed_predecessor_and_shim_have_left() {
    let mut place = Place::new("a");
    let node = place.node();
    let script = "trap '' TERM; cd /\n\
                  env -i sh -c 'echo $$ >> PIDS; exec sleep 1000' &\n\
                  (setsid sh -c 'echo $$ >> PIDS; exec sleep 1000' &)\n\
                  echo $$ >> PIDS; while :; do sleep 0.1; done";
    let left = place.deploy(script, 3);
    place.crash(node);
    assert!(left.iter().all(|process| processes::is_running(*process)), "they outlive their shim and their node");
    place.node();
    let running: Vec<_> = left.iter().filter(|process| processes::is_running(**process)).collect();
    assert!(running.is_empty(), "beside the successor run {running:?} of {left:?}");
    assert_eq!(find(&place.folder.join("n"), RECORD_FILE), None);
}

/// Nothing but its control group names it.
#[test]
fn a_daemon_without_environment_and_session_is_ended_too() {
    let mut place = Place::new("b");
    let node = place.node();
    if !place.folder.join("n/c1/cgroup").exists() {
        println!("skipped: this user has no control group of its own here");
        return;
    }
    let script = "(env -i setsid sh -c 'cd /; echo $$ >> PIDS; exec sleep 1000' < /dev/null > /dev/null 2>&1 &)\n\
                  echo $$ >> PIDS; exec sleep 1000";
    let left = place.deploy(script, 2);
    place.crash(node);
    let next = place.node();
    assert!(!left.iter().any(|process| processes::is_running(*process)), "{left:?}");
    // The successor is in the group of the node that it took over.
    let group = std::fs::read_to_string(place.folder.join("n/c1/cgroup")).unwrap();
    let is_of = |process: Process| group.ends_with(&format!("dca-{}-{}", process.pid, process.started));
    // A node of another test may have removed the group while it was empty; then the successor has its own.
    assert!(is_of(node) || is_of(next), "{group}");
    let members = std::fs::read_to_string(Path::new(&group).join("cgroup.procs")).unwrap();
    assert!(members.lines().any(|pid| pid == next.pid.to_string()), "{members}");
}

/// The shim alone is killed: its node ends all of its orphans.
#[test]
fn a_node_ends_what_a_killed_shim_leaves() {
    let mut place = Place::new("c");
    place.node();
    let script = "(env -i setsid sh -c 'cd /; echo $$ >> PIDS; exec sleep 1000' < /dev/null > /dev/null 2>&1 &)\n\
                  echo $$ >> PIDS; exec sleep 1000";
    let left = place.deploy(script, 2);
    let record = find(&place.folder.join("n"), RECORD_FILE).unwrap();
    let shim = ProcessRecord::parse(&std::fs::read_to_string(record).unwrap()).shim.unwrap();
    processes::signal(shim, Signal::KILL);
    wait("nothing is left", || !left.iter().any(|process| processes::is_running(*process)));
}

/// The same for a node that has adopted the program: the orphans of another node's shim do not become its children, and
/// are found in their control group. One shim is killed; the other one is suspended, and the node kills it in the end.
#[test]
fn a_node_ends_what_the_shim_of_a_program_leaves_that_it_has_taken_over() {
    for suspended in [false, true] {
        let mut place = Place::new(if suspended { "cs" } else { "ct" });
        let node = place.node_with(&[]);
        if !place.folder.join("n/c1/cgroup").exists() {
            println!("skipped: this user has no control group of its own here");
            return;
        }
        let script = "trap '' TERM\n\
                      (env -i setsid sh -c 'cd /; trap \"\" TERM; echo $$ >> PIDS; exec sleep 1000' < /dev/null > /dev/null 2>&1 &)\n\
                      echo $$ >> PIDS; while :; do sleep 0.1; done";
        let left = place.deploy(script, 2);
        let record = find(&place.folder.join("n"), RECORD_FILE).unwrap();
        let shim = ProcessRecord::parse(&std::fs::read_to_string(record).unwrap()).shim.unwrap();
        if suspended {
            processes::signal(shim, Signal::STOP);
        }
        processes::signal(node, Signal::KILL);
        wait("the node is gone", || !processes::is_running(node));
        place.node_with(&[]);
        let running = || left.iter().filter(|process| processes::is_running(**process)).count();
        assert_eq!(running(), 2, "the program is taken over");
        if suspended {
            let stop = place.ask(&["stop", "left"]);
            assert_eq!(stop.status.code(), Some(0), "{}", String::from_utf8_lossy(&stop.stderr));
            assert_eq!(running(), 0, "{}", String::from_utf8_lossy(&stop.stdout));
        } else {
            processes::signal(shim, Signal::KILL);
            wait("nothing is left", || running() == 0);
        }
    }
}

/// A small file system, which ends with the test.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: PathBuf) -> Option<Self> {
        std::fs::create_dir_all(&at).unwrap();
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=24m", "none"]).arg(&at).output();
        mounted.is_ok_and(|output| output.status.success()).then_some(Self(at))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        drop(Command::new("umount").arg("-l").arg(&self.0).output());
    }
}

/// Without its epoch on the disk a deployment would run, and after a restart another one under the same epoch.
#[test]
fn a_full_disk_refuses_a_deployment_and_gives_no_epoch_twice() {
    let mut place = Place::new("d");
    let Some(disk) = SmallDisk::mount(place.folder.join("s")) else {
        println!("skipped: needs root to mount a small disk");
        return;
    };
    let deploy = |place: &Place, spec: &str| {
        let output = place.ask(&["deploy", spec]);
        let text = String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout);
        (output.status.code(), text)
    };
    let epoch = || {
        let journal = std::fs::read_to_string(disk.0.join("c1/journal")).unwrap_or_default();
        journal.lines().filter_map(|line| line.split(' ').next()?.parse::<u64>().ok()).max().unwrap_or(0)
    };
    let node = place.node();
    let spec = place.spec("exit 0");
    let filler = disk.0.join("filler");
    // A file system that is full to the last byte takes no line either.
    let filled = std::fs::write(&filler, vec![7; 24 << 20]).unwrap_err();
    assert_eq!(filled.kind(), ErrorKind::StorageFull);
    let (code, text) = deploy(&place, &spec);
    assert_eq!((code, epoch()), (Some(1), 0), "{text}");
    assert!(text.contains("the deployment's epoch cannot be written down: No space left"), "{text}");
    std::fs::remove_file(&filler).unwrap();
    let (code, text) = deploy(&place, &spec);
    let first = epoch();
    assert!(code == Some(0) && first > 0, "{text}");
    processes::signal(node, Signal::KILL);
    wait("it is gone", || !processes::is_running(node));
    place.node();
    let (code, text) = deploy(&place, &spec);
    assert!(code == Some(0) && epoch() > first, "{first}, then {}: {text}", epoch());
}

/// A node takes the room for the words of an emergency stop when it starts.
#[test]
fn a_full_disk_takes_the_reason_of_an_emergency_stop() {
    let mut place = Place::new("full");
    let Some(disk) = SmallDisk::mount(place.folder.join("s")) else {
        println!("skipped: needs root to mount a small disk");
        return;
    };
    for reason in ["smoke in the cell", "a person in the cell"] {
        let node = place.node();
        let filler = disk.0.join("filler");
        let filled = std::fs::write(&filler, vec![7; 24 << 20]).unwrap_err();
        assert_eq!(filled.kind(), ErrorKind::StorageFull);
        let stopped = place.ask(&["estop", reason]);
        assert_eq!(stopped.status.code(), Some(0), "{stopped:?}");
        processes::signal(node, Signal::KILL);
        wait("it is gone", || !processes::is_running(node));
        std::fs::remove_file(&filler).unwrap();
        let again = place.node();
        let status = String::from_utf8_lossy(&place.ask(&["status"]).stdout).into_owned();
        assert!(status.contains(&format!(": {reason}")), "{status}");
        assert_eq!(place.ask(&["estop", "--release"]).status.code(), Some(0));
        processes::signal(again, Signal::KILL);
        wait("it is gone", || !processes::is_running(again));
    }
}

/// Replaces each connection that is closed, until `over` is set.
fn crowd(socket: &Path, made: &AtomicUsize, over: &AtomicBool) {
    let mut streams: Vec<Option<UnixStream>> = (0..SILENT).map(|_| None).collect();
    while !over.load(Ordering::Relaxed) {
        for stream in &mut streams {
            let is_open = stream.as_mut().is_some_and(
                |stream| matches!(stream.read(&mut [0; 8]), Err(error) if error.kind() == ErrorKind::WouldBlock),
            );
            if !is_open {
                *stream = UnixStream::connect(socket).ok();
                stream.iter().for_each(|stream| stream.set_nonblocking(true).unwrap());
                made.fetch_add(1, Ordering::Relaxed);
            }
        }
        std::thread::yield_now();
    }
}

/// Each connection that is closed is replaced at once.
#[test]
fn seven_hundred_silent_connections_do_not_shut_a_newcomer_out() {
    let mut place = Place::new("e");
    place.node();
    let (made, over) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicBool::new(false)));
    let socket = place.folder.join("n/c1/node.sock");
    let crowding = std::thread::spawn({
        let (made, over) = (Arc::clone(&made), Arc::clone(&over));
        move || crowd(&socket, &made, &over)
    });
    wait("the crowd is there", || made.load(Ordering::Relaxed) >= SILENT);
    let answers: Vec<_> = (0..5).map(|_| place.ask(&["nodes"])).collect();
    over.store(true, Ordering::Relaxed);
    crowding.join().unwrap();
    for answer in answers {
        let (out, err) = (String::from_utf8_lossy(&answer.stdout), String::from_utf8_lossy(&answer.stderr));
        assert!(answer.status.success() && out.contains("c1"), "{out}{err}");
    }
}
