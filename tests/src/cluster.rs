//! Real processes: the workspace's own programs, each started by a test in its own folder.
//!
//! A [`Cluster`] is the folder of one test. A [`Host`] is a place in it where commands and nodes are started: this
//! machine, or one end of a [`Network`]. A [`Program`] is a started command with its output. Everything that descends
//! from a test works in its folder or names it, so [`Cluster::left`] finds all of it, even if its parents have ended.

mod capture;
mod fakes;
mod freezer;
mod hosts;
mod network;
mod processes;
mod program;
mod pushed_hand;
mod slow_link;
mod terminal;
mod trace;
mod turn;
mod typed_terminal;

pub use capture::Capture;
pub use fakes::{Fakes, Said};
pub use freezer::Freezer;
pub use hosts::{Hosts, NAMES};
pub use network::Network;
pub use processes::{Busy, Process, descriptors, memory, threads};
pub use program::{Ended, Program, Stream};
pub use slow_link::{Line, SlowLink};
pub use trace::{Sample, Trace, Window, best_second, peak, rate, window};
pub use turn::Turn;
pub use typed_terminal::{Left, TypedTerminal};

use comms::io::clock::{Wakeup, now};
use node::logic::protocol::{NodeStatus, ProcessStatus};
use rustix::process::{Signal, getpid};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::str::FromStr;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// How long a command has that answers at once; a machine that builds something else at the same time is slow.
pub const SOON: Duration = Duration::from_secs(30);
/// How often a condition is checked that no event announces.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Waits until `condition` holds, for changes without an event: other processes and files. Returns how long it took, or
/// none if `condition` did not hold within `within`.
pub fn wait_until(within: Duration, mut condition: impl FnMut() -> bool) -> Option<Duration> {
    let (began, pause) = (now(), Wakeup::default());
    loop {
        if condition() {
            return Some(now() - began);
        }
        if now() - began > within {
            return None;
        }
        pause.wait(Some(now() + LOOK_EVERY));
    }
}

/// Returns how often a test repeats: `usual`, or the value of `DCA_TEST_ROUNDS`.
pub fn rounds<T: FromStr>(usual: T) -> T {
    std::env::var("DCA_TEST_ROUNDS").ok().and_then(|rounds| rounds.parse().ok()).unwrap_or(usual)
}

/// Returns whether the calling process is the one for `test` alone; if not, runs that test in such a process first.
/// Zenoh's threads belong to the process and stay in the network namespace in which the first session was opened, so a
/// test that opens a session in a namespace begins with `if !alone("module::name") { return }`.
///
/// # Panics
/// The test has failed there.
pub fn alone(test: &str) -> bool {
    const ALONE: &str = "DCA_TEST_ALONE";
    if std::env::var_os(ALONE).is_some_and(|name| name == test) {
        return true;
    }
    let own = std::env::current_exe().expect("Linux tells a process its executable");
    let mut command = Command::new(own);
    command.args(["--exact", test, "--include-ignored", "--nocapture"]).env(ALONE, test);
    let output = command.output().expect("a test can be started again");
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    let passed = output.status.success() && out.contains("1 passed");
    assert!(passed, "`{test}` failed in its own process: {}\n{out}{err}", output.status);
    for line in err.lines().filter(|line| line.contains("skipped: ")) {
        writeln!(std::io::stderr(), "{line}").unwrap_or_default();
    }
    false
}

/// Lets `time` pass, for a test that measures during this time.
pub fn pass(time: Duration) {
    Wakeup::default().wait(Some(now() + time));
}

/// Returns the path of one of the workspace's specs.
pub fn spec(name: &str) -> String {
    format!("{}/../specs/{name}.dca", env!("CARGO_MANIFEST_DIR"))
}

/// Returns the path of a program of this workspace, built with the same profile as the test.
///
/// # Panics
/// It has not been built.
pub fn executable(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("Linux tells a process its executable");
    // target/PROFILE/deps/TEST
    let profile = test.parent().and_then(Path::parent).expect("a test stands in `deps`");
    let path = profile.join(name);
    assert!(path.is_file(), "{path:?} is not there; build it with `cargo build --workspace --bins`");
    path
}

/// The folder of one test, with all processes started from it. Dropping it ends the remaining processes and removes the
/// folder.
#[derive(Debug)]
pub struct Cluster {
    folder: PathBuf,
}

impl Default for Cluster {
    fn default() -> Self {
        Self::new()
    }
}

impl Cluster {
    /// Makes an empty folder with a short path, because sockets are made below it.
    ///
    /// # Panics
    /// The folder cannot be made.
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        // With a letter at its end no name begins another, so that looking for one does not find both.
        let folder = std::env::temp_dir().join(format!("dt{}-{number}t", getpid().as_raw_nonzero()));
        std::fs::create_dir_all(&folder).expect("the folder for temporary files can be written");
        Self { folder }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes a file; returns its path.
    ///
    /// # Panics
    /// It cannot be written.
    pub fn file(&self, name: &str, text: &str) -> String {
        let path = self.folder.join(name);
        std::fs::write(&path, text).expect("a test can write in its own folder");
        path.display().to_string()
    }

    /// Returns this machine.
    pub fn here(&self) -> Host {
        Host {
            folder: self.folder.clone(),
            run_dir: self.folder.join("n"),
            namespace: None,
            sealed: None,
            log: None,
            unmounted: Vec::new(),
            ahead: None,
            variables: Vec::new(),
        }
    }

    /// Returns host `number` of a network, with its own folder for sockets, like a separate machine.
    ///
    /// # Panics
    /// The folders cannot be made.
    pub fn host(&self, network: &Network, number: usize) -> Host {
        let run_dir = |number| self.folder.join(format!("n{number}"));
        let others: Vec<PathBuf> = network.hosts().filter(|other| *other != number).map(run_dir).collect();
        for folder in &others {
            std::fs::create_dir_all(folder).expect("a test can write in its own folder");
        }
        let namespace = Some((network.namespace(number), others));
        Host {
            folder: self.folder.clone(),
            run_dir: run_dir(number),
            namespace,
            sealed: None,
            log: None,
            unmounted: Vec::new(),
            ahead: None,
            variables: Vec::new(),
        }
    }

    /// Returns every process that descends from this test, but for the test itself.
    pub fn left(&self) -> Vec<Process> {
        processes::of_folder(&self.folder)
    }

    /// Waits until nothing is left; returns how long that took.
    ///
    /// # Panics
    /// Something is left after `within`; names it.
    #[track_caller]
    pub fn expect_nothing_left(&self, within: Duration) -> Duration {
        let took = wait_until(within, || self.left().is_empty());
        took.unwrap_or_else(|| panic!("left after {within:?}: {:#?}", self.left()))
    }

    /// Returns the program that a node has started for `path`, recognised by its mark.
    pub fn leaf(&self, path: &str) -> Option<Process> {
        let mark = format!("DCA_INSTANCE={path}");
        self.left().into_iter().find(|process| process.environment.contains(&mark))
    }

    /// Returns the program that a node has started for `path`, once it can be seen: while a program makes way for
    /// another, the system shows neither its arguments nor its environment.
    ///
    /// # Panics
    /// There is none within `SOON`.
    #[track_caller]
    pub fn expect_leaf(&self, path: &str) -> Process {
        let mut found = None;
        wait_until(SOON, || {
            found = self.leaf(path);
            found.is_some()
        });
        found.unwrap_or_else(|| panic!("`{path}` does not run: {:#?}", self.left()))
    }

    /// Returns the runs of numbers that a sink of `dca-counting` has written into the file of this name, the first and
    /// last number of each.
    ///
    /// # Panics
    /// It has not stopped.
    pub fn counted(&self, name: &str) -> Vec<(u64, u64)> {
        let text = std::fs::read_to_string(self.folder().join(name)).expect("the sink has stopped");
        let run = |run: &str| {
            let (first, last) = run.split_once('-').expect("a run has two ends");
            (first.parse().expect("it is a number"), last.parse().expect("it is a number"))
        };
        text.split_whitespace().map(run).collect()
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for process in self.left() {
            process.signal(Signal::KILL);
        }
        // A process that is being killed may still write. Its files stay until temporary files are next cleaned.
        drop(std::fs::remove_dir_all(&self.folder));
    }
}

/// A place where commands are started.
#[derive(Clone, Debug)]
pub struct Host {
    folder: PathBuf,
    run_dir: PathBuf,
    /// Its name, and the folders with sockets of the other hosts.
    namespace: Option<(String, Vec<PathBuf>)>,
    /// A folder that can only be read there.
    sealed: Option<PathBuf>,
    /// The log filter of nodes there, where it is not the usual.
    log: Option<String>,
    /// The file systems that are not mounted there.
    unmounted: Vec<String>,
    /// By how many seconds its boot-time clock is ahead.
    ahead: Option<u64>,
    /// Variables of its programs.
    variables: Vec<(String, String)>,
}

impl Host {
    /// Returns the same machine with a variable in the environment of its programs.
    #[must_use]
    pub fn with_variable(mut self, name: &str, value: &str) -> Self {
        self.variables.push((name.to_owned(), value.to_owned()));
        self
    }

    /// Returns the same machine with another folder for the sockets of its nodes.
    #[must_use]
    pub fn with_run_dir(self, run_dir: impl Into<PathBuf>) -> Self {
        Self { run_dir: run_dir.into(), ..self }
    }

    /// Returns the same machine with nodes that log with this filter, as `RUST_LOG`.
    #[must_use]
    pub fn with_log(self, filter: &str) -> Self {
        Self { log: Some(filter.to_owned()), ..self }
    }

    /// Returns this machine without some of its mounts. Needs root.
    #[must_use]
    pub fn without_mounts(self, mounts: &[&str]) -> Self {
        Self { unmounted: mounts.iter().map(|mount| (*mount).to_owned()).collect(), ..self }
    }

    /// Returns a host of a network whose boot-time clock is ahead by so many seconds, like a machine that has run for
    /// longer.
    #[must_use]
    pub fn with_clock_ahead(self, seconds: u64) -> Self {
        Self { ahead: Some(seconds), ..self }
    }

    /// Returns this machine with a read-only disk for the states of its nodes. Needs root.
    #[must_use]
    pub fn with_read_only_state(self) -> Self {
        Self { sealed: Some(self.state()), ..self }
    }

    /// Returns the folder with the states of this host's nodes.
    pub fn state(&self) -> PathBuf {
        // Two nodes of one name have different folders for sockets, so these are different too.
        self.folder.join(self.run_dir.file_name().unwrap_or_default()).with_extension("state")
    }

    /// Returns the folder with the sockets of this host's nodes.
    pub fn run_dir(&self) -> &Path {
        &self.run_dir
    }

    /// Starts `dca` with these arguments; verbs that talk to nodes get the folder.
    pub fn dca(&self, arguments: &[&str]) -> Program {
        Program::start(self.dca_command(arguments))
    }

    /// Runs `dca` to its end on a terminal of so many columns, with these variables in its environment. Returns its
    /// exit code and all that came to the terminal.
    ///
    /// # Panics
    /// Panics if the command has not ended `SOON`, or if no terminal can be opened.
    pub fn on_terminal(&self, columns: u16, environment: &[(&str, &str)], arguments: &[&str]) -> (Option<i32>, String) {
        let mut command = self.dca_command(arguments);
        command.env_remove("NO_COLOR").env("TERM", "xterm").envs(environment.iter().copied());
        terminal::run(command, columns, None)
    }

    /// Runs `dca` on a terminal, and presses Ctrl-C once it has shown `wanted`; else as [`Host::on_terminal`].
    ///
    /// # Panics
    /// As [`Host::on_terminal`].
    pub fn on_terminal_until(&self, columns: u16, wanted: &str, arguments: &[&str]) -> (Option<i32>, String) {
        let mut command = self.dca_command(arguments);
        command.env("TERM", "xterm");
        terminal::run(command, columns, Some(wanted))
    }

    /// Starts `dca` on a terminal of so many columns, with these variables in its environment.
    ///
    /// # Panics
    /// No terminal can be opened.
    pub fn typed(&self, columns: u16, environment: &[(&str, &str)], arguments: &[&str]) -> TypedTerminal {
        let mut command = self.dca_command(arguments);
        command.env_remove("NO_COLOR").env("TERM", "xterm").envs(environment.iter().copied());
        TypedTerminal::start(command, columns)
    }

    fn dca_command(&self, arguments: &[&str]) -> Command {
        let mut command = self.command("dca");
        command.args(arguments);
        let asks_nodes = [
            "run", "deploy", "plan", "replace", "attach", "nodes", "status", "logs", "stop", "db", "param", "events",
            "names", "echo", "tap", "hz", "call", "get", "list", "queue", "router", "lock", "clock", "add", "remove",
            "switch", "estop", "ctl", "top", "view",
        ];
        if arguments.first().is_some_and(|verb| asks_nodes.contains(verb)) {
            command.arg("--run-dir").arg(&self.run_dir);
        }
        command
    }

    /// Runs `dca` to its end.
    pub fn ask(&self, arguments: &[&str]) -> Ended {
        self.dca(arguments).ended(SOON)
    }

    /// Runs `dca` to its end with this on its standard input, which fits into a pipe.
    ///
    /// # Panics
    /// Panics if the command has no pipes.
    pub fn ask_given(&self, arguments: &[&str], input: &[u8]) -> Ended {
        let (reader, mut writer) = std::io::pipe().expect("Linux has pipes");
        writer.write_all(input).expect("it fits");
        drop(writer);
        Program::start_given(self.dca_command(arguments), reader.into()).ended(SOON)
    }

    /// Deploys a spec without a record, and waits until it has begun.
    pub fn mission(&self, file: &str) -> Program {
        let mission = self.dca(&["deploy", "--no-record", file]);
        mission.wait_for(Stream::Err, "▸", SOON);
        mission
    }

    /// Starts a node, without waiting for it to be ready.
    pub fn start_node(&self, name: &str, arguments: &[&str]) -> Program {
        let mut command = self.command("dca-node");
        command.arg("--name").arg(name).arg("--run-dir").arg(&self.run_dir).args(arguments);
        command.arg("--state").arg(self.state());
        command.envs(self.log.iter().map(|filter| ("RUST_LOG", filter)));
        Program::start(command)
    }

    /// Starts a node of this machine under another command, such as `nohup`, and waits until it can be called.
    pub fn node_under(&self, launcher: &[&str], name: &str) -> Program {
        let mut command = Command::new("env");
        command.args(launcher).arg(executable("dca-node")).args(["--name", name]);
        command.arg("--run-dir").arg(&self.run_dir).arg("--state").arg(self.state());
        command.current_dir(&self.folder).env("TMPDIR", &self.folder).env_remove("RUST_LOG");
        let node = Program::start(command);
        node.wait_for(Stream::Out, &format!("node `{name}` is ready"), SOON);
        node
    }

    /// Starts a node and waits until it can be called.
    pub fn node(&self, name: &str, arguments: &[&str]) -> Program {
        let node = self.start_node(name, arguments);
        node.wait_for(Stream::Out, &format!("node `{name}` is ready"), SOON);
        node
    }

    /// Runs one test of this test program once more, in this place, with these variables in its environment.
    ///
    /// # Panics
    /// It cannot be started.
    pub fn test(&self, name: &str, environment: &[(&str, &str)]) -> Program {
        let own = std::env::current_exe().expect("Linux tells a process its executable");
        let mut command = self.command(&own.display().to_string());
        command.args(["--exact", name, "--nocapture"]).envs(environment.iter().copied());
        Program::start(command)
    }

    /// Returns the status of every node from `dca status`.
    ///
    /// # Panics
    /// It is not the documented JSON.
    pub fn statuses(&self, arguments: &[&str]) -> Vec<NodeStatus> {
        let ended = self.ask(&[&["status", "--json"], arguments].concat());
        assert_eq!(ended.code, Some(0), "{ended}");
        serde_json::from_str(&ended.out).expect("`dca status --json` prints statuses")
    }

    /// Returns the process id of each program that is up, by its path.
    ///
    /// # Panics
    /// No node answers.
    pub fn pids(&self) -> BTreeMap<String, u32> {
        self.processes(&[]).into_iter().filter_map(|(_, process)| Some((process.path, process.pid?))).collect()
    }

    /// Returns every leaf and group that `dca status` shows, with its host.
    pub fn processes(&self, arguments: &[&str]) -> Vec<(String, ProcessStatus)> {
        let parts = |node: NodeStatus| {
            let host = node.host;
            let processes = node.deployments.into_iter().flat_map(|part| part.processes);
            processes.map(move |process| (host.clone(), process)).collect::<Vec<_>>()
        };
        self.statuses(arguments).into_iter().flat_map(parts).collect()
    }

    fn command(&self, name: &str) -> Command {
        let executable = executable(name);
        let mut command = match (&self.namespace, &self.sealed) {
            (None, None) if self.unmounted.is_empty() => Command::new(executable),
            (None, None) => {
                const UNMOUNT: &str = "while [ \"$1\" != -- ]; do umount -l \"$1\"; shift; done; shift; exec \"$@\"";
                let mut command = Command::new("unshare");
                command.args(["--mount", "sh", "-c", UNMOUNT, "sh"]).args(&self.unmounted).arg("--").arg(executable);
                command
            }
            (None, Some(folder)) => {
                const SEAL: &str =
                    "mount --bind \"$1\" \"$1\" && mount -o remount,bind,ro \"$1\" && shift && exec \"$@\"";
                let mut command = Command::new("unshare");
                command.args(["--mount", "sh", "-c", SEAL, "sh"]).arg(folder).arg(executable);
                command
            }
            (Some((namespace, others)), _) => {
                let mut command = Command::new("ip");
                // Hosts share no files: a socket of another host would be a way around the network. Only this program
                // sees the file systems mounted here. Each command replaces itself by the next one, so the process id
                // stays.
                const HIDE: &str =
                    "while [ \"$1\" != -- ]; do mount -t tmpfs none \"$1\"; shift; done; shift; exec \"$@\"";
                command.args(["netns", "exec", namespace]);
                if let Some(ahead) = self.ahead {
                    command.args(["unshare", "--time", "--boottime", &ahead.to_string()]);
                }
                command.args(["sh", "-c", HIDE, "sh"]);
                command.args(others).arg("--").arg(executable);
                command
            }
        };
        // Relative paths and temporary files are the test's own, and every descendant is known by its folder.
        command.current_dir(&self.folder).env("TMPDIR", &self.folder).env_remove("RUST_LOG");
        command.envs(self.variables.iter().map(|(name, value)| (name, value)));
        command
    }
}
