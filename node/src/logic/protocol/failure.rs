//! Failures, in a form for messages, and in words.

use super::Estop;
use crate::logic::printable::printable;
use crate::logic::table::counted;
use language::algebra::Value;
use language::automaton::Failure as Reason;
use language::plan::{LeafKind, Plan};
use language::script::ScriptError;
use serde::{Deserialize, Serialize};
use shim::protocol::{EndReason, LimitKind, ShimReport};
use std::fmt;
use std::time::Duration;

/// A failure: its cause, where it happened, and when.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Absolute path of the process where it began: `main/dooropensyst/hit/force`.
    pub origin: String,
    /// The cause.
    pub cause: FailureCause,
    /// Time since GO.
    #[serde(with = "comms::logic::human::seconds")]
    pub at: Duration,
}

impl Failure {
    /// Returns the report about the failure for the supervisor of the process.
    pub fn report(&self, plan: &Plan) -> Value {
        let is_plain = plan.leaves.iter().any(|leaf| leaf.kind == LeafKind::Plain && leaf.path == self.origin);
        self.cause.reason(is_plain).report()
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chain = self.origin.split('/').collect::<Vec<_>>().join(" ← ");
        write!(f, "{chain}: {} at {:.1} s", self.cause, self.at.as_secs_f64())
    }
}

/// The cause of a failure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FailureCause {
    /// The program was ended by a signal that DCA did not send.
    Signal(i32),
    /// The program ended with this code, without reporting that it was done.
    Exit(i32),
    /// The program has reported a failure in its own words.
    Reported(String),
    /// The program could not be started.
    Exec(String),
    /// The program does not exist: it ended before it was needed, and could not be restarted.
    NotAvailable(String),
    /// The process was activated while it was running.
    Busy,
    /// A service ended by itself.
    ServiceEnded,
    /// The program did not confirm its stop.
    StopUnconfirmed,
    /// The host of the process could not be reached any more.
    HostLost(String),
    /// The spec contains `fail("why")`.
    Failed(String),
    /// The program died repeatedly.
    Exhausted {
        /// How the program died the last time.
        last: String,
        /// How many times it was restarted before.
        restarts: u32,
    },
    /// The host of the process could not be reached any more while the process was stopping.
    HostLostStopping(String),
    /// The program ended unexpectedly, after it had written something.
    Program {
        /// How it ended.
        end: ProgramEnd,
        /// How many times it was restarted before.
        restarts: u32,
        /// The last lines that the program wrote.
        output: Vec<String>,
    },
    /// The program hung: it gave no sign of life for this long.
    Watchdog(#[serde(with = "comms::logic::human::seconds")] Duration),
    /// The program was not ready after this long, at its start or in its `Init`.
    StartTimeout(#[serde(with = "comms::logic::human::seconds")] Duration),
    /// The program was stopped because its node was gone.
    AgentLost,
    /// The kernel has killed the program or a process of it: it needed more memory than its limit, given in bytes.
    OutOfMemory(u64),
    /// The program met a limit of its policy.
    Limit {
        /// The policy: `pids`, `cpu` or `file_size`.
        policy: String,
        /// Its value: a count, seconds or bytes.
        value: u64,
    },
    /// The program died once more than its group allows.
    Intensity {
        /// How the program died the last time.
        last: String,
        /// How many restarts the group allows,
        restarts: u32,
        /// within this time.
        #[serde(with = "comms::logic::human::seconds")]
        within: Duration,
    },
    /// The program was ended for this cause, after it had written something.
    Ended {
        /// The cause.
        cause: Box<Self>,
        /// How many times it was restarted before.
        restarts: u32,
        /// The last lines that the program wrote.
        output: Vec<String>,
    },
    /// The process was not begun. Another program of its deployment could not be ended, and holds one of its devices.
    DeviceHeld {
        /// The device.
        device: String,
        /// Absolute path of the other program.
        by: String,
    },
    /// The deployment continues on another node with the name of its home. The text is where that node runs.
    Preempted(String),
    /// A user has stopped everything on the home of the deployment.
    Estop(Estop),
    /// The machine of the home was rebooted.
    Rebooted,
    /// The node of the home was restarted, and has adopted nothing.
    Restarted,
    /// A user stopped the deployment while its home could not be reached. The text is the host that reports this.
    StoppedAway(String),
    /// The program was stopped, but work outside of it may continue. The text is in the program's own words.
    MayGoOn(String),
    /// No arm of a `match` has the outcome.
    NoMatch,
    /// The `Stop()` of the program did not finish within its limit, so the program was ended.
    StopTimeout(#[serde(with = "comms::logic::human::seconds")] Duration),
    /// A script of the activity gave no value.
    Script(ScriptError),
}

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ProgramEnd {
    /// It exited with this code.
    Exit(i32),
    /// It was ended by this signal.
    Signal(i32),
}

impl fmt::Display for ProgramEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // DCA has not sent this signal. Its own signals are reported by their purpose.
            Self::Signal(number @ 9) => write!(f, "{} (external)", signal_name(*number)),
            Self::Signal(number) => f.write_str(&signal_name(*number)),
            Self::Exit(code) => write!(f, "left with exit code {code} before it was done"),
        }
    }
}

impl FailureCause {
    /// Returns the cause of failure in a report of a shim; nothing if the program has not ended.
    pub fn of_end(report: &ShimReport) -> Option<Self> {
        let (end, why) = report.end()?;
        Some(match (why, end) {
            (Some(EndReason::Watchdog(bound)), _) => Self::Watchdog(bound),
            (Some(EndReason::StartTimeout(bound)), _) => Self::StartTimeout(bound),
            (Some(EndReason::AgentLost), _) => Self::AgentLost,
            (Some(EndReason::OutOfMemory(bytes)), _) => Self::OutOfMemory(bytes),
            (Some(EndReason::Limit(limit, value)), _) => Self::Limit { policy: policy_of(limit).to_owned(), value },
            (None, shim::protocol::ProgramEnd::Exit(code)) => Self::Exit(code),
            (None, shim::protocol::ProgramEnd::Signal(signal)) => Self::Signal(signal),
        })
    }

    /// Returns the reason that an activity and an `else match` get. `is_plain` says whether the failure began in a
    /// plain program, which reports a failure by its exit code.
    pub fn reason(&self, is_plain: bool) -> Reason {
        match self {
            Self::Reported(_) => Reason::Reported,
            Self::Exit(_) | Self::Program { end: ProgramEnd::Exit(_), restarts: 0, .. } if is_plain => Reason::Reported,
            Self::Signal(_)
            | Self::Exit(_)
            | Self::Program { .. }
            | Self::Exec(_)
            | Self::NotAvailable(_)
            | Self::Exhausted { .. }
            | Self::Watchdog(_)
            | Self::StartTimeout(_)
            | Self::StopTimeout(_)
            | Self::AgentLost
            | Self::OutOfMemory(_)
            | Self::Limit { .. }
            | Self::Intensity { .. }
            | Self::Ended { .. }
            | Self::DeviceHeld { .. } => Reason::Crash,
            Self::HostLost(_) => Reason::HostLost,
            Self::Busy => Reason::Busy,
            Self::ServiceEnded => Reason::ServiceEnded,
            Self::NoMatch => Reason::NoMatch,
            Self::Script(error) => Reason::of_script(error.kind),
            Self::Failed(text) => Reason::Failed(text.clone()),
            Self::StopUnconfirmed | Self::HostLostStopping(_) | Self::MayGoOn(_) => Reason::StopUnconfirmed,
            // These causes end a whole deployment, so no supervisor gets them.
            Self::Preempted(_) | Self::Estop(_) | Self::Rebooted | Self::Restarted | Self::StoppedAway(_) => {
                Reason::Reported
            }
        }
    }

    /// Returns whether the program, or work that it has begun, may still be running.
    pub fn is_unconfirmed_stop(&self) -> bool {
        matches!(self, Self::StopUnconfirmed | Self::HostLostStopping(_) | Self::MayGoOn(_))
    }

    /// Adds details of the failed program to the cause: how many times it was restarted, and the last lines of its output.
    #[must_use]
    pub fn of_program(self, restarts: u32, output: Vec<String>) -> Self {
        if let (Self::Exit(code), false) = (&self, output.is_empty()) {
            return Self::Program { end: ProgramEnd::Exit(*code), restarts, output };
        }
        if let (Self::Signal(signal), false) = (&self, output.is_empty()) {
            return Self::Program { end: ProgramEnd::Signal(*signal), restarts, output };
        }
        let is_end = matches!(
            self,
            Self::Watchdog(_)
                | Self::StartTimeout(_)
                | Self::StopTimeout(_)
                | Self::OutOfMemory(_)
                | Self::Limit { .. }
                | Self::AgentLost
        );
        if is_end && !output.is_empty() {
            return Self::Ended { cause: Box::new(self), restarts, output };
        }
        if restarts == 0 { self } else { Self::Exhausted { last: self.to_string(), restarts } }
    }

    /// Returns the last lines of the program that failed. They are empty if it wrote nothing, or if no program was the cause.
    pub fn output(&self) -> &[String] {
        if let Self::Program { output, .. } | Self::Ended { output, .. } = self { output } else { &[] }
    }
}

impl fmt::Display for FailureCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Signal(number) => ProgramEnd::Signal(*number).fmt(f),
            Self::Exit(code) => ProgramEnd::Exit(*code).fmt(f),
            Self::Program { end, restarts: 0, .. } => end.fmt(f),
            Self::Program { end, restarts, .. } => write!(f, "{end} after {}", counted(*restarts, "restart")),
            Self::Ended { cause, restarts: 0, .. } => cause.fmt(f),
            Self::Ended { cause, restarts, .. } => write!(f, "{cause} after {}", counted(*restarts, "restart")),
            Self::Reported(text) | Self::Failed(text) => f.write_str(&printable(text)),
            Self::Exec(text) => write!(f, "could not be started: {}", printable(text)),
            Self::NotAvailable(text) => write!(f, "was not there any more: {}", printable(text)),
            Self::Busy => f.write_str("was activated while it was still running"),
            Self::ServiceEnded => f.write_str("a service ended by itself"),
            Self::NoMatch => f.write_str("no arm of `match` has this outcome"),
            Self::Script(error) => f.write_str(&printable(&error.to_string())),
            Self::StopUnconfirmed => f.write_str("its stop could not be confirmed"),
            Self::MayGoOn(what) => write!(f, "its stop could not be confirmed: {}", printable(what)),
            Self::Exhausted { last, restarts } => {
                write!(f, "{} after {}", printable(last), counted(*restarts, "restart"))
            }
            Self::HostLostStopping(host) => write!(f, "host `{host}` was lost before it confirmed the stop"),
            Self::Watchdog(bound) => write!(f, "its loop has not come round for {}", spelt(*bound)),
            Self::StartTimeout(bound) => write!(f, "it was not ready within {}", spelt(*bound)),
            Self::StopTimeout(bound) => {
                write!(f, "its stop did not finish within {}, so the program was ended", spelt(*bound))
            }
            Self::AgentLost => f.write_str("was stopped because its node was gone (`on_agent_loss`)"),
            Self::OutOfMemory(bytes) => {
                write!(f, "ran out of memory: `memory {}`", size(*bytes))
            }
            Self::Limit { policy, value } => {
                let value = match policy.as_str() {
                    "cpu" => format!("{value} s"),
                    "file_size" => size(*value),
                    _ => value.to_string(),
                };
                write!(f, "met its limit `{} {value}`", printable(policy))
            }
            Self::Intensity { last, restarts, within } => {
                let (last, bears) = (printable(last), counted(*restarts, "restart"));
                write!(f, "{last}, and its group bears {bears} within {}", spelt(*within))
            }
            Self::DeviceHeld { device, by } => write!(
                f,
                "was not begun: `{device}` is held by `{by}`, whose stop could not be confirmed; end its program first"
            ),
            Self::Preempted(place) => {
                write!(f, "was ended: another node of this name goes on with the deployment ({})", printable(place))
            }
            Self::Estop(estop) => write!(f, "was ended: {estop}"),
            Self::Rebooted => f.write_str("its home was rebooted"),
            Self::Restarted => f.write_str("the node of its home was started again"),
            Self::StoppedAway(host) => write!(f, "was stopped while its home was away, as `{}` says", printable(host)),
            Self::HostLost(host) => write!(f, "host `{host}` could not be reached any more"),
        }
    }
}

/// Returns the word of the policy that sets a limit.
const fn policy_of(limit: LimitKind) -> &'static str {
    match limit {
        LimitKind::Pids => "pids",
        LimitKind::Cpu => "cpu",
        LimitKind::FileSize => "file_size",
    }
}

/// Formats a size in bytes: `200 MB`.
fn size(bytes: u64) -> String {
    match bytes {
        bytes if bytes % 1_000_000 == 0 => format!("{} MB", bytes / 1_000_000),
        bytes if bytes % 1000 == 0 => format!("{} kB", bytes / 1000),
        bytes => format!("{bytes} B"),
    }
}

/// Formats a time: `0.5 s` for half a second.
fn spelt(time: Duration) -> String {
    format!("{} s", time.as_secs_f64())
}

/// Returns the name of a signal: `SIGSEGV` for 11. Source: signal(7), Linux on x86 and ARM.
pub fn signal_name(number: i32) -> String {
    let name = match number {
        1 => "SIGHUP",
        2 => "SIGINT",
        3 => "SIGQUIT",
        4 => "SIGILL",
        5 => "SIGTRAP",
        6 => "SIGABRT",
        7 => "SIGBUS",
        8 => "SIGFPE",
        9 => "SIGKILL",
        10 => "SIGUSR1",
        11 => "SIGSEGV",
        12 => "SIGUSR2",
        13 => "SIGPIPE",
        14 => "SIGALRM",
        15 => "SIGTERM",
        24 => "SIGXCPU",
        31 => "SIGSYS",
        other => return format!("signal {other}"),
    };
    name.to_owned()
}
