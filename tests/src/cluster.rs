//! Real processes: a test starts the workspace's own programs, each in its own folder.
//!
//! A [`Cluster`] is the folder of one test. A [`Host`] is a place in it where commands and nodes are started: this
//! machine, or one end of a [`Network`]. A [`Program`] is a started command with its output. Every descendant of a test
//! works in the test's folder or names it, so [`Cluster::left`] finds all of them, even if their parents have ended.

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

/// The longest time for a command that answers at once. A machine is slow while it builds something else.
pub const SOON: Duration = Duration::from_secs(30);
/// How often a condition without an event is checked.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Waits until `condition` holds. It is for changes without an event, such as those of other processes and files.
/// Returns how long it took, or none if `condition` did not hold within `within`.
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

/// Returns the number of rounds of a test: the value of `DCA_TEST_ROUNDS`, or `usual`.
pub fn rounds<T: FromStr>(usual: T) -> T {
    std::env::var("DCA_TEST_ROUNDS").ok().and_then(|rounds| rounds.parse().ok()).unwrap_or(usual)
}

/// Returns whether this process runs only `test`. If not, it first runs that test in such a process. Zenoh's threads
/// belong to the process, and stay in the network namespace of the first session. So a test that opens a session in a
/// namespace begins with `if !alone("module::name") { return }`.
///
/// # Panics
/// Panics if the test has failed there.
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

/// Lets `time` pass, for a test that measures in the meantime.
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
/// Panics if the program has not been built.
pub fn executable(name: &str) -> PathBuf {
    let test = std::env::current_exe().expect("Linux tells a process its executable");
    // target/PROFILE/deps/TEST
    let profile = test.parent().and_then(Path::parent).expect("a test stands in `deps`");
    let path = profile.join(name);
    assert!(path.is_file(), "{path:?} is not there; build it with `cargo build --workspace --bins`");
    path
}

/// The folder of one test, with all processes started from it. Dropping it ends the remaining processes, and removes
/// the folder.
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
    /// Makes an empty folder. Its path is short, since sockets are made below it.
    ///
    /// # Panics
    /// Panics if the folder cannot be made.
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        // Each name ends with a letter, so no name is the beginning of another. A search for one does not find both.
        let folder = std::env::temp_dir().join(format!("dt{}-{number}t", getpid().as_raw_nonzero()));
        std::fs::create_dir_all(&folder).expect("the folder for temporary files can be written");
        Self { folder }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes a file, and returns its path.
    ///
    /// # Panics
    /// Panics if the file cannot be written.
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

    /// Returns host `number` of a network. Like a separate machine, it has its own folder for sockets.
    ///
    /// # Panics
    /// Panics if the folders cannot be made.
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

    /// Returns all descendants of this test, without the test itself.
    pub fn left(&self) -> Vec<Process> {
        processes::of_folder(&self.folder)
    }

    /// Waits until no process is left, and returns how long that took.
    ///
    /// # Panics
    /// Panics if something is left after `within`. The message names it.
    #[track_caller]
    pub fn expect_nothing_left(&self, within: Duration) -> Duration {
        let took = wait_until(within, || self.left().is_empty());
        took.unwrap_or_else(|| panic!("left after {within:?}: {:#?}", self.left()))
    }

    /// Returns the program that a node has started for `path`. Its mark identifies it.
    pub fn leaf(&self, path: &str) -> Option<Process> {
        let mark = format!("DCA_INSTANCE={path}");
        self.left().into_iter().find(|process| process.environment.contains(&mark))
    }

    /// Returns the program that a node has started for `path`, once it is visible. While a program replaces itself by
    /// another, the system shows neither its arguments nor its environment.
    ///
    /// # Panics
    /// Panics if the program does not appear within `SOON`.
    #[track_caller]
    pub fn expect_leaf(&self, path: &str) -> Process {
        let mut found = None;
        wait_until(SOON, || {
            found = self.leaf(path);
            found.is_some()
        });
        found.unwrap_or_else(|| panic!("`{path}` does not run: {:#?}", self.left()))
    }

    /// Returns the runs of numbers that a sink of `dca-counting` has written to the file with this name: the first and
    /// last number of each.
    ///
    /// # Panics
    /// Panics if the sink has not stopped.
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
        // A process that is being killed may still write. Its files stay until the temporary files are cleaned the next
        // time.
        drop(std::fs::remove_dir_all(&self.folder));
    }
}

/// A place where commands are started.
#[derive(Clone, Debug)]
pub struct Host {
    folder: PathBuf,
    run_dir: PathBuf,
    /// The name of the host, and the socket folders of the other hosts.
    namespace: Option<(String, Vec<PathBuf>)>,
    /// A folder that is read-only there.
    sealed: Option<PathBuf>,
    /// The log filter of nodes there, if it differs from the default.
    log: Option<String>,
    /// The file systems that are unmounted there.
    unmounted: Vec<String>,
    /// The number of seconds by which its boot-time clock is ahead.
    ahead: Option<u64>,
    /// Environment variables of its programs.
    variables: Vec<(String, String)>,
}

impl Host {
    /// Returns the same machine with an additional environment variable for its programs.
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

    /// Returns the same machine. Its nodes log with this filter, as with `RUST_LOG`.
    #[must_use]
    pub fn with_log(self, filter: &str) -> Self {
        Self { log: Some(filter.to_owned()), ..self }
    }

    /// Returns this machine without some of its mounts. Needs root.
    #[must_use]
    pub fn without_mounts(self, mounts: &[&str]) -> Self {
        Self { unmounted: mounts.iter().map(|mount| (*mount).to_owned()).collect(), ..self }
    }

    /// Returns a host of a network whose boot-time clock is ahead by this number of seconds. A machine that has run for
    /// longer has such a clock.
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
        // Two nodes with the same name have different folders for sockets, so these folders also differ.
        self.folder.join(self.run_dir.file_name().unwrap_or_default()).with_extension("state")
    }

    /// Returns the folder with the sockets of this host's nodes.
    pub fn run_dir(&self) -> &Path {
        &self.run_dir
    }

    /// Starts `dca` with these arguments. A verb that talks to nodes also receives the folder.
    pub fn dca(&self, arguments: &[&str]) -> Program {
        Program::start(self.dca_command(arguments))
    }

    /// Runs `dca` to its end on a terminal with this number of columns and these environment variables. Returns its
    /// exit code and all of its output on the terminal.
    ///
    /// # Panics
    /// Panics if the command does not end within `SOON`, or if no terminal can be opened.
    pub fn on_terminal(&self, columns: u16, environment: &[(&str, &str)], arguments: &[&str]) -> (Option<i32>, String) {
        let mut command = self.dca_command(arguments);
        command.env_remove("NO_COLOR").env("TERM", "xterm").envs(environment.iter().copied());
        terminal::run(command, columns, None)
    }

    /// Runs `dca` on a terminal, and presses Ctrl-C once it has shown `wanted`. Otherwise it is like
    /// [`Host::on_terminal`].
    ///
    /// # Panics
    /// Panics like [`Host::on_terminal`].
    pub fn on_terminal_until(&self, columns: u16, wanted: &str, arguments: &[&str]) -> (Option<i32>, String) {
        let mut command = self.dca_command(arguments);
        command.env("TERM", "xterm");
        terminal::run(command, columns, Some(wanted))
    }

    /// Starts `dca` on a terminal with this number of columns and these environment variables.
    ///
    /// # Panics
    /// Panics if no terminal can be opened.
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

    /// Runs `dca` to its end. The input fits into a pipe, and is the standard input of the command.
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

    /// Starts a node, but does not wait until it is ready.
    pub fn start_node(&self, name: &str, arguments: &[&str]) -> Program {
        let mut command = self.command("dca-node");
        command.arg("--name").arg(name).arg("--run-dir").arg(&self.run_dir).args(arguments);
        command.arg("--state").arg(self.state());
        command.envs(self.log.iter().map(|filter| ("RUST_LOG", filter)));
        Program::start(command)
    }

    /// Starts a node of this machine under another command, such as `nohup`, and waits until the node can be called.
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

    /// Runs one test of this test program again, in this place and with these environment variables.
    ///
    /// # Panics
    /// Panics if the test cannot be started.
    pub fn test(&self, name: &str, environment: &[(&str, &str)]) -> Program {
        let own = std::env::current_exe().expect("Linux tells a process its executable");
        let mut command = self.command(&own.display().to_string());
        command.args(["--exact", name, "--nocapture"]).envs(environment.iter().copied());
        Program::start(command)
    }

    /// Returns the status of every node from `dca status`.
    ///
    /// # Panics
    /// Panics if the output is not the documented JSON.
    pub fn statuses(&self, arguments: &[&str]) -> Vec<NodeStatus> {
        let ended = self.ask(&[&["status", "--json"], arguments].concat());
        assert_eq!(ended.code, Some(0), "{ended}");
        serde_json::from_str(&ended.out).expect("`dca status --json` prints statuses")
    }

    /// Returns the process id of each program that is up, by its path.
    ///
    /// # Panics
    /// Panics if no node answers.
    pub fn pids(&self) -> BTreeMap<String, u32> {
        self.processes(&[]).into_iter().filter_map(|(_, process)| Some((process.path, process.pid?))).collect()
    }

    /// Returns every leaf and group from `dca status`, with its host.
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
                // Hosts share no files, since a socket of another host would bypass the network. Only this program sees
                // the file systems that are mounted here. Each command replaces itself by the next one, so the process
                // id stays the same.
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
        // Relative paths and temporary files are in the test's own folder. Every descendant is recognised by this
        // folder.
        command.current_dir(&self.folder).env("TMPDIR", &self.folder).env_remove("RUST_LOG");
        command.envs(self.variables.iter().map(|(name, value)| (name, value)));
        command
    }
}
