//! The parent of one program: starts it, reports how it ends, and leaves nothing of it behind.
//!
//! The agent can be killed and replaced while this runs on, so no exit code is ever lost. As a subreaper it inherits every
//! process that the program leaves behind, daemons included; so "no child is left" means "nothing of it is left".
//!
//! The instance *is* its main process: when that ends, what it leaves behind is killed at once. Three threads send events
//! to the main one: orders (standard input), output (the program's), and reaper (children that end).

mod descendants;
mod launch;
mod output;

use comms::io::clock::now;
use comms::io::descriptors;
use comms::logic::human::cause;
use comms::logic::time::Time;
use descendants::kill_descendants;
use output::Output;
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, Signal, WaitOptions, WaitStatus, pidfd_open, pidfd_send_signal};
use shim::process_record::{ProcessRecord, RECORD_FILE};
use shim::processes;
use shim::protocol::{EXIT_FILE, Gate, LAUNCH, ShimOrder, ShimReport, ShimStart};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// Until descendants are looked for again.
const KILL_AGAIN: Duration = Duration::from_millis(20);
/// How long the last output may take to reach its file before the end is reported without it.
const SETTLE: Duration = Duration::from_millis(500);

/// What `--help` says.
const HELP: &str = "\
The parent of one program that a node has started: holds it back until it is to run, keeps its output, reports how it ends
and leaves nothing of it behind. Nodes start it; there is no use for it by hand.

Usage: dca-shim --directory DIR [OPTIONS] -- PROGRAM [ARGUMENTS]

Options:
  --directory DIR              where output and exit code go
  --working-directory DIR      the program's working directory
  --gate none|exec             run the program at once, or when standard input says `go`
  --agent-loss-grace-ms N      how long it has to stop when the node is gone
  --environment NAME=VALUE     its whole environment; may be given more than once
  --memory BYTES  --cpu-s S  --files N  --nice N  --realtime P  --realtime-optional P
                               what it may use
  -h, --help                   this text
  -V, --version                the version";

/// What the main thread waits for.
enum Event {
    Order(ShimOrder),
    AgentGone,
    Ended(Pid, WaitStatus),
    NoneLeft,
}

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1).peekable();
    let about = match arguments.peek().and_then(|first| first.to_str()) {
        Some("--version" | "-V") => Some(concat!("dca-shim ", env!("CARGO_PKG_VERSION"))),
        Some("--help" | "-h") => Some(HELP),
        _ => None,
    };
    if let Some(about) = about {
        return ExitCode::from(u8::from(writeln!(io::stdout(), "{about}").is_err()));
    }
    let is_launch = arguments.next_if(|first| first == LAUNCH).is_some();
    let start = match ShimStart::parse(arguments) {
        Ok(start) => start,
        Err(error) => {
            complain(&format!("dca-shim: {error}"));
            return ExitCode::from(2);
        }
    };
    if is_launch {
        return launch::launch(&start);
    }
    // Out of the agent's session, so that a Ctrl-C for the agent is not one for the program. Fails for a leader of one.
    rustix::process::setsid().map(drop).unwrap_or_default();
    match supervise(&start) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&format!("dca-shim: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Runs the program from the gate to the last report.
fn supervise(start: &ShimStart) -> io::Result<()> {
    rustix::process::set_child_subreaper(Some(rustix::process::getpid()))?;
    let record = match Record::begin(start) {
        Ok(record) => record,
        Err(error) => {
            let reason = format!("cannot write `{}`: {}", start.dir.join(RECORD_FILE).display(), cause(&error));
            conclude(&start.dir, &ShimReport::ExecFailed { reason });
            report(&ShimReport::Gone);
            return Ok(());
        }
    };
    let (events_tx, events) = sync_channel(64);
    let orders_tx = events_tx.clone();
    std::thread::Builder::new().name("orders".into()).spawn(move || hear_orders(&orders_tx))?;
    if start.gate == Gate::Exec {
        report(&ShimReport::Ready);
        if !is_opened(&events) {
            record.remove();
            report(&ShimReport::Gone);
            return Ok(());
        }
    }
    let output = Output::open(&start.dir)?;
    if start.descriptors.is_some() {
        descriptors::set(start.descriptors);
    }
    match execute(start, &output) {
        Ok(program) => {
            record.add(program.pid);
            report(&ShimReport::Started { pid: program.pid.as_raw_nonzero().get().cast_unsigned() });
            std::thread::Builder::new().name("reaper".into()).spawn(move || reap(&events_tx))?;
            Supervision { start, program, output: &output, deadline: None, killing: false }.run(&events);
        }
        Err(reason) => conclude(&start.dir, &ShimReport::ExecFailed { reason }),
    }
    output.settle(SETTLE);
    record.remove();
    report(&ShimReport::Gone);
    Ok(())
}

/// The record of who runs here, for a node that starts after this shim and its node were killed.
struct Record {
    path: PathBuf,
}

impl Record {
    fn begin(start: &ShimStart) -> io::Result<Self> {
        let path = start.dir.join(RECORD_FILE);
        let record = ProcessRecord {
            boot: processes::kernel_boot(),
            grace: start.agent_loss_grace,
            shim: processes::this(),
            program: None,
        };
        std::fs::write(&path, record.head())?;
        Ok(Self { path })
    }

    fn add(&self, program: Pid) {
        let Some(stat) = processes::stat(program.as_raw_nonzero().get()) else { return };
        let line = ProcessRecord::program_line(stat.process);
        let file = OpenOptions::new().append(true).open(&self.path);
        // Without it the marks in its environment are left.
        if let Err(error) = file.and_then(|mut file| file.write_all(line.as_bytes())) {
            complain(&format!("dca-shim: cannot write `{}`: {error}", self.path.display()));
        }
    }

    fn remove(&self) {
        std::fs::remove_file(&self.path).unwrap_or_default();
    }
}

/// Waits at the gate; says whether it was opened.
fn is_opened(events: &Receiver<Event>) -> bool {
    matches!(events.recv(), Ok(Event::Order(ShimOrder::Go)))
}

/// The main process.
struct Program {
    pid: Pid,
    /// Names it and nobody else, even after its number has been given to another process.
    pidfd: OwnedFd,
}

/// Starts the program, or says why not.
fn execute(start: &ShimStart, output: &Output) -> Result<Program, String> {
    let name = start.command.first().ok_or("there is no program")?;
    if !start.working_directory.is_dir() {
        return Err(format!("the working directory `{}` is not there", start.working_directory.display()));
    }
    let failed = |error: &io::Error| format!("cannot execute `{name}`: {}", cause(error));
    let (program, arguments) = launch::command(start).map_err(|error| failed(&error))?;
    let child = Command::new(program)
        .args(arguments)
        .env_clear()
        .envs(start.environment.iter().map(|(name, value)| (name, value)))
        .current_dir(&start.working_directory)
        // `kill 0` in a script means the script and what it started, not this shim.
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(output.writer().map_err(|error| failed(&error))?)
        .stderr(output.writer().map_err(|error| failed(&error))?)
        .spawn()
        .map_err(|error| failed(&error))?;
    output.started();
    let pid = Pid::from_child(&child);
    // The reaper is not running yet, so the number still means this process.
    let pidfd = pidfd_open(pid, PidfdFlags::empty()).map_err(|error| failed(&error.into()))?;
    Ok(Program { pid, pidfd })
}

/// From the start of the program to its end.
struct Supervision<'a> {
    start: &'a ShimStart,
    program: Program,
    output: &'a Output,
    /// When the grace is over, or descendants are looked for again.
    deadline: Option<Time>,
    killing: bool,
}

impl Supervision<'_> {
    fn run(&mut self, events: &Receiver<Event>) {
        loop {
            match self.next(events) {
                Some(Event::Order(ShimOrder::Go)) => {}
                Some(Event::Order(ShimOrder::Stop { grace })) => self.stop(grace),
                Some(Event::Order(ShimOrder::Kill)) | None => self.kill(),
                Some(Event::AgentGone) => self.stop(self.start.agent_loss_grace),
                Some(Event::Ended(pid, status)) if pid == self.program.pid => {
                    self.output.settle(SETTLE);
                    conclude(&self.start.dir, &self.ending(status));
                    self.kill();
                }
                Some(Event::Ended(..)) => {}
                Some(Event::NoneLeft) => return,
            }
        }
    }

    /// How the main process has ended, or that it never came to run.
    fn ending(&self, status: WaitStatus) -> ShimReport {
        let refusal = status.exit_status().and_then(|code| launch::refusal(&self.start.dir, code));
        refusal.map_or_else(|| ending(status), |reason| ShimReport::ExecFailed { reason })
    }

    /// Returns the next event; none when the deadline has come.
    fn next(&self, events: &Receiver<Event>) -> Option<Event> {
        let next = match self.deadline {
            Some(deadline) => events.recv_timeout(deadline.since(now())),
            None => events.recv().map_err(RecvTimeoutError::from),
        };
        match next {
            Ok(event) => Some(event),
            Err(RecvTimeoutError::Timeout) => None,
            // The reaper ends with this event.
            Err(RecvTimeoutError::Disconnected) => Some(Event::NoneLeft),
        }
    }

    /// Kills everything, at once and then again and again until there is nothing left.
    fn kill(&mut self) {
        if self.killing && self.deadline.is_some_and(|again| again > now()) {
            return;
        }
        self.killing = true;
        kill_descendants();
        self.deadline = Some(now() + KILL_AGAIN);
    }

    /// Asks the main process to end; a second, shorter grace counts.
    fn stop(&mut self, grace: Duration) {
        if self.killing {
            return;
        }
        let until = now() + grace;
        self.deadline = Some(self.deadline.map_or(until, |earlier| earlier.min(until)));
        // A stopped process could not hear the first without the second; one that is gone needs neither.
        for signal in [Signal::TERM, Signal::CONT] {
            pidfd_send_signal(&self.program.pidfd, signal).unwrap_or_default();
        }
    }
}

fn hear_orders(events: &SyncSender<Event>) {
    for line in io::stdin().lines() {
        let Ok(line) = line else { break };
        let Some(order) = ShimOrder::parse(&line) else {
            complain(&format!("dca-shim: `{line}` is no order"));
            continue;
        };
        if events.send(Event::Order(order)).is_err() {
            return;
        }
    }
    events.send(Event::AgentGone).unwrap_or_default();
}

/// Collects every child that ends, its own and those inherited, until there is none.
fn reap(events: &SyncSender<Event>) {
    loop {
        match rustix::process::wait(WaitOptions::empty()) {
            Ok(Some((pid, status))) if events.send(Event::Ended(pid, status)).is_err() => return,
            Ok(_) | Err(Errno::INTR) => {}
            Err(_none_left) => break,
        }
    }
    events.send(Event::NoneLeft).unwrap_or_default();
}

fn ending(status: WaitStatus) -> ShimReport {
    match (status.exit_status(), status.terminating_signal()) {
        (Some(code), _) => ShimReport::Exited { code },
        (None, Some(signal)) => ShimReport::Signalled { signal },
        // `wait` without options returns for no other reason.
        (None, None) => ShimReport::Exited { code: -1 },
    }
}

/// Makes the end durable, then reports it.
fn conclude(dir: &Path, end: &ShimReport) {
    if let Err(error) = record(dir, end) {
        complain(&format!("dca-shim: cannot write `{}`: {error}", dir.join(EXIT_FILE).display()));
    }
    report(end);
}

fn record(dir: &Path, end: &ShimReport) -> io::Result<()> {
    let unfinished = dir.join("exit.new");
    let mut file = File::create(&unfinished)?;
    writeln!(file, "{end}")?;
    file.sync_all()?;
    std::fs::rename(&unfinished, dir.join(EXIT_FILE))?;
    File::open(dir)?.sync_all()
}

/// Tells the agent. One that is gone does not hear it; its successor reads the record.
fn report(report: &ShimReport) {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{report}").and_then(|()| stdout.flush()).unwrap_or_default();
}

fn complain(text: &str) {
    writeln!(io::stderr(), "{text}").unwrap_or_default();
}
