//! The parent of one program: starts it, reports how it ends, and leaves nothing of it behind.
//!
//! The agent can be killed and replaced while this runs on, so no exit code is ever lost. As a subreaper it inherits
//! every process that the program leaves behind, daemons included; so "no child is left" means "nothing of it is left".
//!
//! A program that hangs is ended, also without an agent. The program gives signs of life (`beats`),
//! and `watchdog` measures the time without a sign of life. It gets SIGABRT, so that a core can be
//! written, and SIGKILL after a grace.
//!
//! The instance *is* its main process: when that ends, its descendants are killed at once. Three threads send events to
//! the main one: agent (orders, attachments, losses), reaper (children that end) and watchdog. Two more keep the
//! program's output.
//!
//! When its agent is gone, the shim either stops the program within a grace, or keeps it until it ends or another agent
//! attaches ([`ShimStart::agent_loss_grace`]). The stop of a running program begins at once, and no agent that attaches
//! undoes it; at the gate, where nothing runs, the grace is how long another agent may take to attach.

mod agent;
mod beats;
mod descendants;
mod group;
mod judged;
mod launch;
mod output;
mod record;
mod sandbox;
mod secrets;
mod watchdog;

use agent::Agent;
use beats::Beats;
use comms::io::clock::now;
use comms::io::{core_dump, descriptors};
use comms::logic::human::cause;
use comms::logic::time::Time;
use descendants::kill_descendants;
use group::Group;
use output::Output;
use record::{Record, conclude, hold};
use rustix::io::Errno;
use rustix::process::{Pid, PidfdFlags, Signal, WaitOptions, WaitStatus, pidfd_open, pidfd_send_signal};
use shim::process_record::RECORD_FILE;
use shim::processes;
use shim::protocol::{
    EXIT_FILE, EndReason, Gate, LAUNCH, LEVELS, LimitKind, Limits, OUTPUT_FILE, ProgramEnd, SOCKET_FILE, ShimOrder,
    ShimReport, ShimStart,
};
use std::io::{self, Write};
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

/// Until descendants are looked for again.
const KILL_AGAIN: Duration = Duration::from_millis(20);
/// How long the last output may take to reach its file before the end is reported without it.
const SETTLE: Duration = Duration::from_millis(500);

/// How long a program that hangs has between SIGABRT and SIGKILL: the kernel may write a core.
const ABORT_GRACE: Duration = Duration::from_secs(2);

/// The signals of two limits. Source: signal(7), Linux on x86 and ARM.
const SIGXCPU: i32 = 24;
const SIGXFSZ: i32 = 25;

/// The text of `--help`.
const HELP: &str = "\
Starts one program for a node. Holds the program back until it may run, stores its output, reports
its end, and then ends all processes that the program has started. Only nodes start this command.

Usage: dca-shim --directory DIR [OPTIONS] -- PROGRAM [ARGUMENTS]

Options:
  --directory DIR              the folder for the output and the exit code
  --working-directory DIR      the working directory of the program
  --gate none|exec             start the program at once, or after `go` on standard input
  --agent-loss keep|N          continue without a node, or stop the program within N ms after the node is gone
  --watchdog MS                end the program if it gives no sign of life for this time (sd_notify(3): WATCHDOG=1)
  --ready-within MS            end the program if it is not ready after this time (READY=1)
  --secret N                   end word N of the command with the path of a file in memory. Standard input begins with
                               the content of this file: four bytes with its length, the lowest first, then the bytes
  --environment NAME=VALUE     a variable of the program; may be given more than once. A variable DCA_ENV_NAME of the
                               shim is also passed on, as NAME. The program gets no other variables
  --memory BYTES  --cpu-s S  --cpu-share THOUSANDTHS  --pids N  --files N  --file-size BYTES  --nice N
  --realtime P  --realtime-optional P
                               limits and priorities of the program
  --sandbox none|standard  --user UID:GID[:GID...]
                               the rights of the program, and the user and groups of its process
  --judged folder|hash:STAMP:PATH
                               the only executable that may run, as the node has checked it
  --sandbox-levels             print the optional parts of the sandbox that this kernel has: landlock, seccomp
  -h, --help                   this text
  -V, --version                the version";

/// An event for the main thread.
enum Event {
    Order(ShimOrder),
    AgentGone,
    /// Another agent has attached.
    Attached,
    Ended(Pid, WaitStatus),
    /// The program hangs.
    Overdue(EndReason),
    NoneLeft,
}

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1).peekable();
    let about = match arguments.peek().and_then(|first| first.to_str()) {
        Some("--version" | "-V") => Some(concat!("dca-shim ", env!("CARGO_PKG_VERSION")).to_owned()),
        Some("--help" | "-h") => Some(HELP.to_owned()),
        Some(LEVELS) => Some(sandbox::levels().join(" ")),
        _ => None,
    };
    if let Some(about) = about {
        return ExitCode::from(u8::from(print(&format!("{about}\n")).is_err()));
    }
    let is_launch = arguments.next_if(|first| first == LAUNCH).is_some();
    let mut start = match ShimStart::parse(arguments) {
        Ok(start) => start,
        Err(error) => {
            complain(&format!("dca-shim: {error}"));
            return ExitCode::from(2);
        }
    };
    start.take_variables(std::env::vars_os());
    if is_launch {
        // This process has the secrets of the program.
        return launch::launch(&start);
    }
    descriptors::close_inherited();
    // Out of the agent's session, so that a Ctrl-C for the agent is not one for the program. This fails if the shim already leads
    // a session.
    rustix::process::setsid().map(drop).unwrap_or_default();
    let secrets = match secrets::take(&mut start) {
        Ok(secrets) => secrets,
        Err(error) => {
            let agent = Agent::new(&start.dir);
            let reason = format!("its secrets cannot be kept: {}", cause(&error));
            for report in [ShimReport::ExecFailed { reason }, ShimReport::Gone] {
                agent.report(&report);
            }
            return ExitCode::FAILURE;
        }
    };
    match supervise(&start, secrets) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&format!("dca-shim: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Runs the program from the gate to the last report. Only the program inherits its secrets.
fn supervise(start: &ShimStart, secrets: Vec<OwnedFd>) -> io::Result<()> {
    // A file that is too long is an error of its writer, not the end of the shim. The program gets the default action
    // back.
    signal_hook::flag::register(SIGXFSZ, Arc::default())?;
    rustix::process::set_child_subreaper(Some(rustix::process::getpid()))?;
    let agent = Agent::new(&start.dir);
    // If the agent is lost, the files of the instance may already belong to another shim.
    if agent::is_lost() {
        agent.report(&ShimReport::Gone);
        return Ok(());
    }
    let (events_tx, events) = sync_channel(64);
    let (record, group) = match prepare(start, &agent, events_tx.clone()) {
        Ok(prepared) => prepared,
        Err(reason) => {
            conclude(&start.dir, &agent, ShimReport::ExecFailed { reason });
            agent.leave();
            return Ok(());
        }
    };
    // An agent that existed when the socket was opened knows of this shim or has a successor that finds it. If the
    // agent was lost before, no later agent would ever control the program.
    if agent::is_lost() || !is_opened(start, &agent, &events) {
        record.remove();
        drop(group);
        agent.leave();
        return Ok(());
    }
    let output = match Output::open(&start.dir) {
        Ok(output) => output,
        Err(error) => {
            // The output file was in order before the gate.
            let reason = format!("cannot open `{}`: {}", start.dir.join(OUTPUT_FILE).display(), cause(&error));
            conclude(&start.dir, &agent, ShimReport::ExecFailed { reason });
            record.remove();
            drop(group);
            agent.leave();
            return Ok(());
        }
    };
    let beats = Beats::open(start)?;
    if start.before.descriptors.is_some() {
        descriptors::set(start.before.descriptors);
    }
    if let Some(core) = start.before.core {
        core_dump::set(core);
    }
    let executed = execute(&group.start(start), &output);
    drop(secrets);
    let unknown = match executed {
        Ok(program) => {
            record.add(program.pid);
            let pid = program.pid.as_raw_nonzero().get();
            agent.report(&ShimReport::Started { pid: pid.cast_unsigned() });
            if let Some(beats) = beats {
                beats.watch(start, pid, events_tx.clone())?;
            }
            std::thread::Builder::new().name("reaper".into()).spawn(move || reap(&events_tx))?;
            let (agent, output, group) = (&agent, &output, &group);
            Supervision { start, agent, program, output, group, deadline: None, killing: false, why: None }.run(&events)
        }
        Err(reason) => conclude(&start.dir, &agent, ShimReport::ExecFailed { reason }),
    };
    if let Some(end) = unknown {
        hold(&start.dir, &agent, &end, &events);
    }
    output.settle(SETTLE);
    record.remove();
    drop(group);
    agent.leave();
    Ok(())
}

/// Takes the instance directory for this shim, makes the program's control group, and lets agents
/// attach. Returns the reason if this fails.
fn prepare(start: &ShimStart, agent: &Agent, events: SyncSender<Event>) -> Result<(Record, Group), String> {
    let failed = |action: &str, name: &str, error: &io::Error| {
        format!("cannot {action} `{}`: {}", start.dir.join(name).display(), cause(error))
    };
    // The record of an earlier program would be taken for the end of this one.
    match std::fs::remove_file(start.dir.join(EXIT_FILE)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(failed("remove", EXIT_FILE, &error)),
        _ => {}
    }
    let group = Group::make(&start.limits)?;
    // A program that waits at a gate is to be refused before anything runs, not at its turn.
    if start.gate == Gate::Exec {
        launch::try_limits(&group.start(start))?;
    }
    Output::check(&start.dir).map_err(|error| failed("open", OUTPUT_FILE, &error))?;
    let record = Record::begin(start).map_err(|error| failed("write", RECORD_FILE, &error))?;
    agent.listen(events).map_err(|error| {
        record.remove();
        failed("open", SOCKET_FILE, &error)
    })?;
    Ok((record, group))
}

/// Waits at the gate, if there is one; returns whether it was opened.
fn is_opened(start: &ShimStart, agent: &Agent, events: &Receiver<Event>) -> bool {
    if start.gate == Gate::None {
        return true;
    }
    agent.report(&ShimReport::Ready);
    let mut deadline = None;
    loop {
        match next(events, deadline) {
            Ok(Event::Order(order)) => return order == ShimOrder::Go,
            Ok(Event::AgentGone) => deadline = start.agent_loss_grace.map(|grace| now() + grace),
            Ok(Event::Attached) => deadline = None,
            // Nothing runs yet.
            Ok(Event::Ended(..) | Event::Overdue(_) | Event::NoneLeft) => {}
            Err(_too_late) => return false,
        }
    }
}

/// Returns the next event, or that the deadline has come.
fn next(events: &Receiver<Event>, deadline: Option<Time>) -> Result<Event, RecvTimeoutError> {
    match deadline {
        Some(deadline) => events.recv_timeout(deadline.since(now())),
        None => events.recv().map_err(RecvTimeoutError::from),
    }
}

/// The main process.
struct Program {
    pid: Pid,
    /// Refers only to this process, even after its number has been given to another one.
    pidfd: OwnedFd,
}

/// Starts the program, or returns the reason why it cannot be started.
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
        .envs(launch::variables(start, beats::environment(start)))
        .current_dir(&start.working_directory)
        // `kill 0` in a script means the script and its children, not this shim.
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
    agent: &'a Agent,
    program: Program,
    output: &'a Output,
    group: &'a Group,
    /// When the grace is over, or descendants are looked for again.
    deadline: Option<Time>,
    killing: bool,
    /// Why the program is being ended, if no agent has asked for it.
    why: Option<EndReason>,
}

impl Supervision<'_> {
    /// Returns the end of the program if it is not yet known to an agent or the disk.
    fn run(&mut self, events: &Receiver<Event>) -> Option<ShimReport> {
        let mut unknown = None;
        loop {
            match next(events, self.deadline) {
                Ok(Event::Order(ShimOrder::Stop { grace })) => self.stop(grace),
                Ok(Event::Order(ShimOrder::Kill)) | Err(RecvTimeoutError::Timeout) => self.kill(),
                Ok(Event::AgentGone) => {
                    if let Some(grace) = self.start.agent_loss_grace {
                        self.give_reason(EndReason::AgentLost);
                        self.stop(grace);
                    }
                }
                Ok(Event::Overdue(why)) => self.abort(why),
                Ok(Event::Ended(pid, status)) if pid == self.program.pid => {
                    self.output.settle(SETTLE);
                    unknown = conclude(&self.start.dir, self.agent, self.ending(status));
                    self.kill();
                }
                Ok(Event::Order(ShimOrder::Go) | Event::Ended(..) | Event::Attached) => {}
                // The reaper ends with `NoneLeft`.
                Ok(Event::NoneLeft) | Err(RecvTimeoutError::Disconnected) => return unknown,
            }
        }
    }

    /// How the main process has ended, or that it never came to run.
    fn ending(&self, status: WaitStatus) -> ShimReport {
        let refusal = status.exit_status().and_then(|code| launch::refusal(&self.start.dir, code));
        if let Some(reason) = refusal {
            return ShimReport::ExecFailed { reason };
        }
        let end = ending(status);
        let is_asked = self.killing || self.deadline.is_some();
        let met = || self.group.reason(end).or_else(|| limit_met(&self.start.limits, end));
        let why = self.why.or_else(|| if is_asked { None } else { met() });
        match (why, end) {
            (Some(why), end) => ShimReport::Ended { end, why },
            (None, ProgramEnd::Exit(code)) => ShimReport::Exited { code },
            (None, ProgramEnd::Signal(signal)) => ShimReport::Signalled { signal },
        }
    }

    /// Keeps the reason why the program is being ended. The first reason is used. There is no
    /// reason if the program was asked to stop.
    fn give_reason(&mut self, why: EndReason) {
        if !self.killing && self.deadline.is_none() {
            self.why = Some(why);
        }
    }

    /// Aborts a program that hangs, unless it is already being stopped.
    fn abort(&mut self, why: EndReason) {
        if self.killing || self.deadline.is_some() {
            return;
        }
        self.why = Some(why);
        self.deadline = Some(now() + ABORT_GRACE);
        self.signal(&[Signal::ABORT, Signal::CONT]);
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

    /// Asks the main process to end. If this is called again with a shorter grace, the shorter grace is used.
    fn stop(&mut self, grace: Duration) {
        if self.killing {
            return;
        }
        let until = now() + grace;
        self.deadline = Some(self.deadline.map_or(until, |earlier| earlier.min(until)));
        self.signal(&[Signal::TERM, Signal::CONT]);
    }

    /// Signals the main process. A suspended process needs SIGCONT after the first signal; a process that is gone needs
    /// none.
    fn signal(&self, signals: &[Signal]) {
        for signal in signals {
            pidfd_send_signal(&self.program.pidfd, *signal).unwrap_or_default();
        }
    }
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

/// Returns which limit of a process was met by a program that ended so; these end it with a signal.
fn limit_met(limits: &Limits, end: ProgramEnd) -> Option<EndReason> {
    let time = limits.cpu.map(|time| Duration::from_secs(time.as_secs()));
    let is_over = |time: Duration| end == ProgramEnd::Signal(9) && processes::time_of_ended_children() >= time;
    let time = time.filter(|time| end == ProgramEnd::Signal(SIGXCPU) || is_over(*time));
    let length = limits.file_size.filter(|_| end == ProgramEnd::Signal(SIGXFSZ));
    let cpu = time.map(|time| EndReason::Limit(LimitKind::Cpu, time.as_secs()));
    cpu.or(length.map(|bytes| EndReason::Limit(LimitKind::FileSize, bytes)))
}

fn ending(status: WaitStatus) -> ProgramEnd {
    match (status.exit_status(), status.terminating_signal()) {
        (Some(code), _) => ProgramEnd::Exit(code),
        (None, Some(signal)) => ProgramEnd::Signal(signal),
        // `wait` without options returns for no other reason.
        (None, None) => ProgramEnd::Exit(-1),
    }
}

fn print(text: &str) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush())
}

fn complain(text: &str) {
    writeln!(io::stderr(), "{text}").unwrap_or_default();
}
