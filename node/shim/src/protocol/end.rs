//! How a program ended, and why.

use std::fmt;
use std::time::Duration;

/// How a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProgramEnd {
    /// With this exit code.
    Exit(i32),
    /// By this signal.
    Signal(i32),
}

/// The reason why a program ended without a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndReason {
    /// The program gave no sign of life for this long.
    Watchdog(Duration),
    /// The program was not ready after this time.
    StartTimeout(Duration),
    /// Its agent was gone.
    AgentLost,
    /// The kernel has killed it or something of it, which had more memory than this, in bytes.
    OutOfMemory(u64),
    /// The program met a limit of this value: bytes, seconds or a count, depending on the kind.
    Limit(LimitKind, u64),
}

/// A limit that a program met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitKind {
    /// Processes and threads at one time.
    Pids,
    /// Processor time, in seconds.
    Cpu,
    /// The length of a file, in bytes.
    FileSize,
}

impl fmt::Display for ProgramEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exit(code) => write!(f, "exit {code}"),
            Self::Signal(signal) => write!(f, "signal {signal}"),
        }
    }
}

impl ProgramEnd {
    pub(super) fn parse(words: &[&str]) -> Option<Self> {
        match words {
            ["exit", code] => Some(Self::Exit(code.parse().ok()?)),
            ["signal", signal] => Some(Self::Signal(signal.parse().ok()?)),
            [..] => None,
        }
    }
}

impl fmt::Display for EndReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Watchdog(bound) => write!(f, "watchdog {}", bound.as_millis()),
            Self::StartTimeout(bound) => write!(f, "start-timeout {}", bound.as_millis()),
            Self::AgentLost => f.write_str("agent-lost"),
            Self::OutOfMemory(bytes) => write!(f, "out-of-memory {bytes}"),
            Self::Limit(LimitKind::Pids, count) => write!(f, "limit-pids {count}"),
            Self::Limit(LimitKind::Cpu, seconds) => write!(f, "limit-cpu {seconds}"),
            Self::Limit(LimitKind::FileSize, bytes) => write!(f, "limit-file-size {bytes}"),
        }
    }
}

impl EndReason {
    pub(super) fn parse(words: &[&str]) -> Option<Self> {
        let time = |millis: &str| Some(Duration::from_millis(millis.parse().ok()?));
        match words {
            ["watchdog", bound] => Some(Self::Watchdog(time(bound)?)),
            ["start-timeout", bound] => Some(Self::StartTimeout(time(bound)?)),
            ["agent-lost"] => Some(Self::AgentLost),
            ["out-of-memory", bytes] => Some(Self::OutOfMemory(bytes.parse().ok()?)),
            ["limit-pids", count] => Some(Self::Limit(LimitKind::Pids, count.parse().ok()?)),
            ["limit-cpu", seconds] => Some(Self::Limit(LimitKind::Cpu, seconds.parse().ok()?)),
            ["limit-file-size", bytes] => Some(Self::Limit(LimitKind::FileSize, bytes.parse().ok()?)),
            [..] => None,
        }
    }
}
