//! The protocol between an agent and the shim of one program.
//!
//! The shim is the parent of the program, so that the agent can be killed and replaced while the program keeps running.
//! Its arguments name the program, it takes orders as lines on its standard input, and reports as lines on its standard
//! output. End of input means that the agent is gone.
//!
//! Another agent then attaches at the socket [`SOCKET_FILE`]. Orders and reports are counted from the start of the
//! shim, over all connections, so that none is lost and none is carried out twice:
//!
//! ```text
//! agent   attach 2          it has two reports
//! shim    attached 1        it has taken one order: `go`, `stop` or `kill`
//!         exited 7          the reports from the third on, first those that were made, then each when it is made
//!         gone
//! agent   stop 5000         the orders from the second on
//! ```
//! The shim reads one connection at a time, to its end. A connection that begins with anything else is closed.

mod end;
mod judged;
mod start;

pub use end::{EndReason, LimitKind, ProgramEnd};
pub use judged::{Judged, JudgedBy, Stamp};
pub use start::{
    Account, Limits, Realtime, SECRET_MAX, Sandbox, SandboxLevel, ShimStart, SoftLimits, WatchdogBounds, secret,
};
use std::fmt;
use std::time::Duration;
use thiserror::Error;

/// The program's output, in the instance directory.
pub const OUTPUT_FILE: &str = "out.log";
/// Output before that, once [`OUTPUT_FILE`] has reached [`OUTPUT_SIZE_MAX`].
pub const OUTPUT_FILE_OLD: &str = "out.log.1";
/// Where [`OUTPUT_FILE`] is rotated, in bytes.
pub const OUTPUT_SIZE_MAX: u64 = 1 << 20;
/// Why the kernel does not let the program run as it should, for a person.
pub const REFUSED_FILE: &str = "refused";
/// The first argument of a shim that becomes the program itself, within its limits.
pub const LAUNCH: &str = "--launch";
/// The argument of a shim before the instance directory of its program.
pub const DIRECTORY: &str = "--directory";
/// The prefix of a program's variables in the environment of its shim: variables such as `LD_PRELOAD` must affect the
/// program alone. Arguments could be read by every user.
pub const VARIABLE_PREFIX: &str = "DCA_ENV_";
/// The argument of a shim that prints the levels of its sandbox that the kernel supports, one word each:
/// `landlock seccomp`.
pub const LEVELS: &str = "--sandbox-levels";
/// How the program ended, as the line of the [`ShimReport`]; in place before the report is made.
pub const EXIT_FILE: &str = "exit";
/// The socket in the instance directory where an agent attaches to a shim that has lost its agent.
pub const SOCKET_FILE: &str = "shim.sock";
/// The socket for the program's signs of life, in the instance directory: datagrams in the format of sd_notify(3).
pub const BEAT_FILE: &str = "beat.sock";
/// The longest line between agent and shim, its end included, in bytes. A longer one ends the connection.
pub const LINE_MAX: u64 = 8 << 10;
/// How long a program may take to stop once its agent is gone, unless the start sets another time.
pub const AGENT_LOSS_GRACE: Duration = Duration::from_secs(1);

/// When the program is executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// At once. The program waits by itself, as a controller does.
    None,
    /// After [`ShimOrder::Go`].
    Exec,
}

/// From the agent to the shim.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ShimOrder {
    /// Open the gate.
    Go,
    /// SIGTERM to the program; SIGKILL to everything that is left after the grace.
    Stop {
        /// How long it may take.
        grace: Duration,
    },
    /// SIGKILL to everything, now.
    Kill,
}

/// From the shim to the agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ShimReport {
    /// The gate is shut: everything is prepared, nothing of the user's runs.
    Ready,
    /// The program is running.
    Started {
        /// Its process id.
        pid: u32,
    },
    /// The program has exited by itself or on request; its children may still run.
    Exited {
        /// Its exit code.
        code: i32,
    },
    /// The program was ended by a signal; its children may still run.
    Signalled {
        /// The signal.
        signal: i32,
    },
    /// The program could not be executed.
    ExecFailed {
        /// Why, for a person.
        reason: String,
    },
    /// Last report: no process of the instance is left.
    Gone,
    /// The program has ended, and the shim knows why; its children may still run.
    Ended {
        /// The exit code or the signal.
        end: ProgramEnd,
        /// The reason that the shim knows.
        why: EndReason,
    },
}

/// The first line of an agent that attaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttachRequest {
    /// How many reports of this shim the agent has.
    pub reports: u64,
}

/// The shim's answer; the reports that the agent does not have follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttachReply {
    /// How many orders the shim has taken.
    pub orders: u64,
}

/// Why the arguments of a shim were not understood.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ChildError {
    /// An argument of the shim is wrong.
    #[error("argument `{argument}`: {problem}")]
    Argument {
        /// As given.
        argument: String,
        /// The problem with it, such as "needs a value".
        problem: &'static str,
    },
    /// The shim was given no program.
    #[error("no program to start after `--`")]
    NoProgram,
}

impl fmt::Display for ShimOrder {
    /// Writes the order as a line without its end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Go => f.write_str("go"),
            Self::Stop { grace } => write!(f, "stop {}", grace.as_millis()),
            Self::Kill => f.write_str("kill"),
        }
    }
}

impl ShimOrder {
    /// Reads a line without its end; none if it is not an order.
    pub fn parse(line: &str) -> Option<Self> {
        match line.split_once(' ') {
            None if line == "go" => Some(Self::Go),
            None if line == "kill" => Some(Self::Kill),
            Some(("stop", millis)) => Some(Self::Stop { grace: Duration::from_millis(millis.parse().ok()?) }),
            _ => None,
        }
    }
}

impl fmt::Display for ShimReport {
    /// Writes the report as a line without its end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ready => f.write_str("ready"),
            Self::Started { pid } => write!(f, "started {pid}"),
            Self::Exited { code } => write!(f, "exited {code}"),
            Self::Signalled { signal } => write!(f, "signalled {signal}"),
            Self::ExecFailed { reason } => write!(f, "exec-failed {}", reason.replace(['\n', '\r'], " ")),
            Self::Gone => f.write_str("gone"),
            Self::Ended { end, why } => write!(f, "ended {end} {why}"),
        }
    }
}

impl ShimReport {
    /// Reads a line without its end; none if it is not a report.
    pub fn parse(line: &str) -> Option<Self> {
        match line.split_once(' ') {
            None if line == "ready" => Some(Self::Ready),
            None if line == "gone" => Some(Self::Gone),
            Some(("started", pid)) => Some(Self::Started { pid: pid.parse().ok()? }),
            Some(("exited", code)) => Some(Self::Exited { code: code.parse().ok()? }),
            Some(("signalled", signal)) => Some(Self::Signalled { signal: signal.parse().ok()? }),
            Some(("exec-failed", reason)) => Some(Self::ExecFailed { reason: reason.to_owned() }),
            Some(("ended", rest)) => {
                let words: Vec<&str> = rest.split(' ').collect();
                let (end, why) = words.split_at_checked(2)?;
                Some(Self::Ended { end: ProgramEnd::parse(end)?, why: EndReason::parse(why)? })
            }
            _ => None,
        }
    }

    /// Returns how the program ended, and why if the shim knows; none if the report is of something else.
    pub fn end(&self) -> Option<(ProgramEnd, Option<EndReason>)> {
        match self {
            Self::Exited { code } => Some((ProgramEnd::Exit(*code), None)),
            Self::Signalled { signal } => Some((ProgramEnd::Signal(*signal), None)),
            Self::Ended { end, why } => Some((*end, Some(*why))),
            Self::Ready | Self::Started { .. } | Self::ExecFailed { .. } | Self::Gone => None,
        }
    }
}

impl fmt::Display for AttachRequest {
    /// Writes the request as a line without its end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "attach {}", self.reports)
    }
}

impl AttachRequest {
    /// Reads a line without its end; none if it is not a request.
    pub fn parse(line: &str) -> Option<Self> {
        Some(Self { reports: line.strip_prefix("attach ")?.parse().ok()? })
    }
}

impl fmt::Display for AttachReply {
    /// Writes the reply as a line without its end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "attached {}", self.orders)
    }
}

impl AttachReply {
    /// Reads a line without its end; none if it is not a reply.
    pub fn parse(line: &str) -> Option<Self> {
        Some(Self { orders: line.strip_prefix("attached ")?.parse().ok()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_round_trip() {
        let orders = [ShimOrder::Go, ShimOrder::Kill, ShimOrder::Stop { grace: Duration::from_millis(250) }];
        for order in orders {
            assert_eq!(ShimOrder::parse(&order.to_string()), Some(order));
        }
        let reports = [
            ShimReport::Ready,
            ShimReport::Started { pid: 7 },
            ShimReport::Exited { code: -1 },
            ShimReport::Signalled { signal: 11 },
            ShimReport::ExecFailed { reason: "no such file or directory".to_owned() },
            ShimReport::Gone,
            ShimReport::Ended { end: ProgramEnd::Signal(6), why: EndReason::Watchdog(Duration::from_millis(500)) },
            ShimReport::Ended { end: ProgramEnd::Signal(9), why: EndReason::StartTimeout(Duration::from_secs(3)) },
            ShimReport::Ended { end: ProgramEnd::Exit(143), why: EndReason::AgentLost },
            ShimReport::Ended { end: ProgramEnd::Signal(9), why: EndReason::OutOfMemory(200_000_000) },
            ShimReport::Ended { end: ProgramEnd::Exit(1), why: EndReason::Limit(LimitKind::Pids, 32) },
            ShimReport::Ended { end: ProgramEnd::Signal(24), why: EndReason::Limit(LimitKind::Cpu, 600) },
            ShimReport::Ended { end: ProgramEnd::Signal(25), why: EndReason::Limit(LimitKind::FileSize, 7) },
        ];
        for report in reports {
            assert_eq!(ShimReport::parse(&report.to_string()), Some(report));
        }
        for line in
            ["", "go now", "stop", "stop soon", "started", "exited x", "left 3", "ended exit 1", "ended exit 1 soon"]
        {
            assert_eq!((ShimOrder::parse(line), ShimReport::parse(line)), (None, None), "{line}");
        }
        let (request, reply) = (AttachRequest { reports: 3 }, AttachReply { orders: u64::MAX });
        assert_eq!(AttachRequest::parse(&request.to_string()), Some(request));
        assert_eq!(AttachReply::parse(&reply.to_string()), Some(reply));
        for line in ["", "attach", "attach ", "attach -1", "attach 1 2", "attached", "attached x", "go"] {
            assert_eq!((AttachRequest::parse(line), AttachReply::parse(line)), (None, None), "{line}");
        }
    }
}
