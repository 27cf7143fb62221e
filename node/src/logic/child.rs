//! What the agent and the shim of one program say to each other.
//!
//! The shim is the parent of the program, so that the agent can be killed and replaced while the program runs on. It is
//! told what to start by its arguments, ordered about by lines on its standard input, and reports by lines on its
//! standard output. End of input means that the agent is gone.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// The program's output, in the instance directory.
pub const OUTPUT_FILE: &str = "output.log";
/// Output before that, once [`OUTPUT_FILE`] has reached [`OUTPUT_SIZE_MAX`].
pub const OUTPUT_FILE_OLD: &str = "output.log.1";
/// Where [`OUTPUT_FILE`] is rotated, in bytes.
pub const OUTPUT_SIZE_MAX: u64 = 1 << 20;
/// How the program ended, as the line of the [`ShimReport`]; durable before the report is made.
pub const EXIT_FILE: &str = "exit";
/// How long a program may take to stop once its agent is gone, unless the launch says otherwise.
pub const AGENT_LOSS_GRACE: Duration = Duration::from_secs(1);

/// What a shim starts, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Launch {
    /// The instance directory, which exists: output and exit record go there.
    pub directory: PathBuf,
    /// The program's working directory.
    pub working_directory: PathBuf,
    /// When the program is executed.
    pub gate: Gate,
    /// How long the program may take to stop once the agent is gone.
    pub agent_loss_grace: Duration,
    /// The program's whole environment; nothing is inherited.
    pub environment: Vec<(String, String)>,
    /// The executable (a path, or a name looked up in the `PATH` above) and its arguments.
    pub command: Vec<String>,
}

/// When the program is executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// At once; it waits by itself, as controllers do.
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
    /// The program has left by itself or when asked to; its children may still run.
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
}

/// Why a line or a command line was not understood.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ChildError {
    /// Not a line of this protocol.
    #[error("`{line}` is not {expected}")]
    Line {
        /// As read.
        line: String,
        /// What it should have been.
        expected: &'static str,
    },
    /// An argument of the shim is wrong.
    #[error("argument `{argument}`: {problem}")]
    Argument {
        /// As given.
        argument: String,
        /// What is wrong.
        problem: &'static str,
    },
    /// The shim was given no program.
    #[error("no program to start after `--`")]
    NoProgram,
}

impl ShimOrder {
    /// Returns the order as a line without its end.
    pub fn encode(&self) -> String {
        match self {
            Self::Go => "go".to_owned(),
            Self::Stop { grace } => format!("stop {}", grace.as_millis()),
            Self::Kill => "kill".to_owned(),
        }
    }

    /// Reads a line without its end.
    ///
    /// # Errors
    /// If it is no order.
    pub fn decode(line: &str) -> Result<Self, ChildError> {
        let wrong = || ChildError::Line { line: line.to_owned(), expected: "an order to a shim" };
        match line.split_once(' ') {
            None if line == "go" => Ok(Self::Go),
            None if line == "kill" => Ok(Self::Kill),
            Some(("stop", millis)) => {
                let Ok(millis) = millis.parse() else { return Err(wrong()) };
                Ok(Self::Stop { grace: Duration::from_millis(millis) })
            }
            _ => Err(wrong()),
        }
    }
}

impl ShimReport {
    /// Returns the report as a line without its end.
    pub fn encode(&self) -> String {
        match self {
            Self::Ready => "ready".to_owned(),
            Self::Started { pid } => format!("started {pid}"),
            Self::Exited { code } => format!("exited {code}"),
            Self::Signalled { signal } => format!("signalled {signal}"),
            Self::ExecFailed { reason } => format!("exec-failed {}", reason.replace(['\n', '\r'], " ")),
            Self::Gone => "gone".to_owned(),
        }
    }

    /// Reads a line without its end.
    ///
    /// # Errors
    /// If it is no report.
    pub fn decode(line: &str) -> Result<Self, ChildError> {
        let wrong = || ChildError::Line { line: line.to_owned(), expected: "a report of a shim" };
        let report = match line.split_once(' ') {
            None if line == "ready" => Some(Self::Ready),
            None if line == "gone" => Some(Self::Gone),
            Some(("started", pid)) => pid.parse().ok().map(|pid| Self::Started { pid }),
            Some(("exited", code)) => code.parse().ok().map(|code| Self::Exited { code }),
            Some(("signalled", signal)) => signal.parse().ok().map(|signal| Self::Signalled { signal }),
            Some(("exec-failed", reason)) => Some(Self::ExecFailed { reason: reason.to_owned() }),
            _ => None,
        };
        report.ok_or_else(wrong)
    }
}

impl Launch {
    /// Returns the arguments of the shim.
    pub fn arguments(&self) -> Vec<OsString> {
        let gate = match self.gate {
            Gate::None => "none",
            Gate::Exec => "exec",
        };
        let mut arguments: Vec<OsString> = vec!["--directory".into(), self.directory.clone().into()];
        arguments.extend(["--working-directory".into(), self.working_directory.clone().into()]);
        arguments.extend(["--gate".into(), gate.into()]);
        arguments.extend(["--agent-loss-grace-ms".into(), self.agent_loss_grace.as_millis().to_string().into()]);
        for (name, value) in &self.environment {
            arguments.extend(["--environment".into(), format!("{name}={value}").into()]);
        }
        arguments.push("--".into());
        arguments.extend(self.command.iter().map(OsString::from));
        arguments
    }

    /// Reads the arguments of the shim, its own name left out.
    ///
    /// # Errors
    /// Names the first argument that is wrong.
    pub fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, ChildError> {
        let mut launch = Self {
            directory: PathBuf::new(),
            working_directory: PathBuf::from("/"),
            gate: Gate::None,
            agent_loss_grace: AGENT_LOSS_GRACE,
            environment: Vec::new(),
            command: Vec::new(),
        };
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            let name = argument.to_string_lossy().into_owned();
            if name == "--" {
                break;
            }
            let wrong = |problem| ChildError::Argument { argument: name.clone(), problem };
            let value = arguments.next().ok_or_else(|| wrong("needs a value"))?;
            launch.set(&name, value).map_err(wrong)?;
        }
        for argument in arguments {
            launch.command.push(text(argument).map_err(|()| ChildError::Argument {
                argument: "--".to_owned(),
                problem: "the command must be UTF-8",
            })?);
        }
        if launch.directory.as_os_str().is_empty() {
            return Err(ChildError::Argument { argument: "--directory".to_owned(), problem: "is needed" });
        }
        if launch.command.is_empty() { Err(ChildError::NoProgram) } else { Ok(launch) }
    }

    fn set(&mut self, name: &str, value: OsString) -> Result<(), &'static str> {
        match name {
            "--directory" => self.directory = value.into(),
            "--working-directory" => self.working_directory = value.into(),
            "--gate" => {
                self.gate = match value.to_str() {
                    Some("none") => Gate::None,
                    Some("exec") => Gate::Exec,
                    _ => return Err("must be `none` or `exec`"),
                };
            }
            "--agent-loss-grace-ms" => {
                let millis = value.to_str().and_then(|millis| millis.parse().ok());
                self.agent_loss_grace = Duration::from_millis(millis.ok_or("must be a number")?);
            }
            "--environment" => {
                let entry = text(value).map_err(|()| "must be UTF-8")?;
                let (name, value) = entry.split_once('=').ok_or("must be `NAME=value`")?;
                self.environment.push((name.to_owned(), value.to_owned()));
            }
            _ => return Err("is unknown"),
        }
        Ok(())
    }
}

fn text(value: OsString) -> Result<String, ()> {
    value.into_string().map_err(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_round_trip() {
        let orders = [ShimOrder::Go, ShimOrder::Kill, ShimOrder::Stop { grace: Duration::from_millis(250) }];
        for order in orders {
            assert_eq!(ShimOrder::decode(&order.encode()), Ok(order));
        }
        let reports = [
            ShimReport::Ready,
            ShimReport::Started { pid: 7 },
            ShimReport::Exited { code: -1 },
            ShimReport::Signalled { signal: 11 },
            ShimReport::ExecFailed { reason: "no such file or directory".to_owned() },
            ShimReport::Gone,
        ];
        for report in reports {
            assert_eq!(ShimReport::decode(&report.encode()), Ok(report));
        }
        for line in ["", "go now", "stop", "stop soon", "started", "exited x", "left 3"] {
            assert!(ShimOrder::decode(line).is_err() && ShimReport::decode(line).is_err(), "{line}");
        }
    }

    #[test]
    fn launch_round_trips() {
        let launch = Launch {
            directory: "/run/dca/d/x".into(),
            working_directory: "/tmp".into(),
            gate: Gate::Exec,
            agent_loss_grace: Duration::from_millis(20),
            environment: vec![("DCA_INSTANCE".into(), "main/a=b".into()), ("EMPTY".into(), String::new())],
            command: vec!["sleep".into(), "--".into(), "5".into()],
        };
        assert_eq!(Launch::parse(launch.arguments()), Ok(launch));
    }

    #[test]
    fn launch_refusals() {
        let check = |arguments: &[&str], expect: &str| {
            let error = Launch::parse(arguments.iter().map(OsString::from)).unwrap_err();
            assert_eq!(error.to_string(), expect);
        };
        check(&["--directory", "/d", "--"], "no program to start after `--`");
        check(&["--", "true"], "argument `--directory`: is needed");
        check(&["--gate", "open"], "argument `--gate`: must be `none` or `exec`");
        check(&["--directory"], "argument `--directory`: needs a value");
        check(&["--speed", "9"], "argument `--speed`: is unknown");
    }
}
