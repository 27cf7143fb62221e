//! The arguments of a shim: the program to start, and how.

use super::{AGENT_LOSS_GRACE, ChildError, DIRECTORY, Gate, Judged, VARIABLE_PREFIX};
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

/// The word in place of a grace when the program continues without an agent.
const KEEP: &str = "keep";

/// The start of a program: its command, place, limits and watchdogs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShimStart {
    /// The instance directory, which exists: output and exit record go there.
    pub dir: PathBuf,
    /// The program's working directory.
    pub working_directory: PathBuf,
    /// When the program is executed.
    pub gate: Gate,
    /// How long the program may take to stop once the agent is gone. Without a grace, the program
    /// runs until it ends by itself, or until an attached agent ends it.
    pub agent_loss_grace: Option<Duration>,
    /// How long the program may hang.
    pub watchdog: WatchdogBounds,
    /// The limits of the program.
    pub limits: Limits,
    /// The user it runs as, and its rights.
    pub sandbox: Sandbox,
    /// The control groups that the program joins before it is executed; the shim adds them for its own launch.
    pub groups: Vec<PathBuf>,
    /// The earlier values of the soft limits that the node has changed for itself.
    pub before: SoftLimits,
    /// The program's whole environment; nothing is inherited.
    pub environment: Vec<(String, String)>,
    /// Which words of the command end with the path of a file that has a secret. Their values come first on standard
    /// input, in this order, as [`secret`] writes them.
    pub secrets: Vec<u32>,
    /// The executable (a path, or a name looked up in the `PATH` above) and its arguments.
    pub command: Vec<String>,
}

/// How long a program may hang before its shim ends it; without a limit if none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WatchdogBounds {
    /// How long the program may give no sign of life. A program with [`Gate::None`] is watched from its first sign on.
    pub silence: Option<Duration>,
    /// How long an `Init` of the program may take, and with [`Gate::Exec`] the time to its `READY=1`.
    pub ready_within: Option<Duration>,
}

/// Soft limits in which a node differs from its programs. None means that the node has not changed the limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SoftLimits {
    /// How many files and sockets a program may have open before it asks for more.
    pub descriptors: Option<u64>,
    /// How many bytes of the memory of a program the kernel may write to the disk when it crashes.
    pub core: Option<u64>,
}

/// The limits of a program. If a limit is missing, the program has the limit of the shim.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Addressable memory, in bytes.
    pub memory: Option<u64>,
    /// Processor time in total, in whole seconds.
    pub cpu: Option<Duration>,
    /// Open files and sockets.
    pub files: Option<u64>,
    /// Niceness, -20 to 19.
    pub nice: Option<i8>,
    /// The real-time class, first in, first out.
    pub realtime: Option<Realtime>,
    /// Processes and threads at one time.
    pub pids: Option<u64>,
    /// The share of the processors, in thousandths of one.
    pub cpu_share: Option<u32>,
    /// The longest file, in bytes.
    pub file_size: Option<u64>,
}

/// The rights that a program has on its host.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Sandbox {
    /// How much is taken from it.
    pub level: SandboxLevel,
    /// The user it runs as, if not the shim's.
    pub user: Option<Account>,
    /// The folder of that user where the sockets of the program are: the instance directory is the node's alone.
    pub own: Option<PathBuf>,
    /// The only file that may run, even if the first word of the command leads to another file by then.
    pub judged: Option<Judged>,
}

/// How much is taken from a program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SandboxLevel {
    /// Nothing: it has the rights of its shim.
    #[default]
    None,
    /// It has no capability, and programs that it executes give it no rights (`no_new_privs`).
    Standard,
}

/// A user of the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Account {
    /// Its number.
    pub uid: u32,
    /// The number of its group.
    pub gid: u32,
    /// The ids of all its other groups.
    pub groups: Vec<u32>,
}

/// A place in the real-time class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Realtime {
    /// 1 to 99. Source: sched(7).
    pub priority: u8,
    /// Whether the program runs without it when the kernel refuses.
    pub is_optional: bool,
}

impl WatchdogBounds {
    /// Returns the shortest bound; none if the program is not watched.
    pub fn shortest(&self) -> Option<Duration> {
        self.silence.into_iter().chain(self.ready_within).min()
    }
}

impl ShimStart {
    /// Returns the arguments of the shim.
    pub fn arguments(&self) -> Vec<OsString> {
        let gate = match self.gate {
            Gate::None => "none",
            Gate::Exec => "exec",
        };
        let mut arguments: Vec<OsString> = vec![DIRECTORY.into(), self.dir.clone().into()];
        arguments.extend(["--working-directory".into(), self.working_directory.clone().into()]);
        arguments.extend(["--gate".into(), gate.into()]);
        let agent_loss = self.agent_loss_grace.map_or_else(|| KEEP.to_owned(), |grace| grace.as_millis().to_string());
        arguments.extend(["--agent-loss".into(), agent_loss.into()]);
        let WatchdogBounds { silence, ready_within } = self.watchdog;
        for (name, bound) in [("--watchdog", silence), ("--ready-within", ready_within)] {
            arguments.extend(bound.into_iter().flat_map(|bound| [name.into(), bound.as_millis().to_string().into()]));
        }
        if let Some(descriptors) = self.before.descriptors {
            arguments.extend(["--descriptors".into(), descriptors.to_string().into()]);
        }
        if let Some(core) = self.before.core {
            arguments.extend(["--core".into(), core.to_string().into()]);
        }
        for (name, value) in limit_arguments(&self.limits) {
            arguments.extend([name.into(), value.into()]);
        }
        if self.sandbox.level == SandboxLevel::Standard {
            arguments.extend(["--sandbox".into(), "standard".into()]);
        }
        if let Some(Account { uid, gid, groups }) = &self.sandbox.user {
            let groups: String = groups.iter().map(|group| format!(":{group}")).collect();
            arguments.extend(["--user".into(), format!("{uid}:{gid}{groups}").into()]);
        }
        arguments.extend(self.sandbox.own.iter().flat_map(|own| ["--own".into(), own.clone().into()]));
        arguments.extend(self.sandbox.judged.iter().flat_map(|judged| ["--judged".into(), judged.argument()]));
        for group in &self.groups {
            arguments.extend(["--group".into(), group.clone().into()]);
        }
        for (name, value) in &self.environment {
            arguments.extend(["--environment".into(), format!("{name}={value}").into()]);
        }
        for word in &self.secrets {
            arguments.extend(["--secret".into(), word.to_string().into()]);
        }
        arguments.push("--".into());
        arguments.extend(self.command.iter().map(OsString::from));
        arguments
    }

    /// Returns the variables of the program with their names in the environment of its shim.
    pub fn variables(&self) -> impl Iterator<Item = (String, &str)> {
        self.environment.iter().map(|(name, value)| (format!("{VARIABLE_PREFIX}{name}"), value.as_str()))
    }

    /// Takes the variables of the program from the environment of its shim.
    pub fn take_variables(&mut self, variables: impl IntoIterator<Item = (OsString, OsString)>) {
        let own = |(name, value): (OsString, OsString)| {
            let name = name.into_string().ok()?.strip_prefix(VARIABLE_PREFIX)?.to_owned();
            Some((name, value.into_string().ok()?))
        };
        self.environment.extend(variables.into_iter().filter_map(own));
    }

    /// Reads the arguments of the shim, its own name left out.
    ///
    /// # Errors
    /// Names the first argument that is wrong.
    pub fn parse(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, ChildError> {
        let mut start = Self {
            dir: PathBuf::new(),
            working_directory: PathBuf::from("/"),
            gate: Gate::None,
            agent_loss_grace: Some(AGENT_LOSS_GRACE),
            watchdog: WatchdogBounds::default(),
            limits: Limits::default(),
            sandbox: Sandbox::default(),
            groups: Vec::new(),
            before: SoftLimits::default(),
            environment: Vec::new(),
            secrets: Vec::new(),
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
            start.set(&name, value).map_err(wrong)?;
        }
        for argument in arguments {
            start.command.push(text(argument).map_err(|()| ChildError::Argument {
                argument: "--".to_owned(),
                problem: "the command must be UTF-8",
            })?);
        }
        if start.dir.as_os_str().is_empty() {
            return Err(ChildError::Argument { argument: DIRECTORY.to_owned(), problem: "is needed" });
        }
        if start.command.is_empty() { Err(ChildError::NoProgram) } else { Ok(start) }
    }

    fn set(&mut self, name: &str, value: OsString) -> Result<(), &'static str> {
        match name {
            DIRECTORY => self.dir = value.into(),
            "--working-directory" => self.working_directory = value.into(),
            "--gate" => {
                self.gate = match value.to_str() {
                    Some("none") => Gate::None,
                    Some("exec") => Gate::Exec,
                    _ => return Err("must be `none` or `exec`"),
                };
            }
            "--agent-loss" => {
                let text = value.to_str().unwrap_or_default();
                let millis = || text.parse().ok().ok_or("must be `keep` or a number");
                self.agent_loss_grace = if text == KEEP { None } else { Some(Duration::from_millis(millis()?)) };
            }
            "--watchdog" | "--ready-within" => {
                let millis = value.to_str().and_then(|millis| millis.parse().ok()).ok_or("must be a number")?;
                let WatchdogBounds { silence, ready_within } = &mut self.watchdog;
                let bound = if name == "--watchdog" { silence } else { ready_within };
                *bound = Some(Duration::from_millis(millis));
            }
            "--descriptors" | "--core" => {
                let count = value.to_str().and_then(|count| count.parse().ok());
                let SoftLimits { descriptors, core } = &mut self.before;
                let limit = if name == "--core" { core } else { descriptors };
                *limit = Some(count.ok_or("must be a number")?);
            }
            "--own" => self.sandbox.own = Some(value.into()),
            "--judged" => {
                self.sandbox.judged = Some(Judged::parse(value).ok_or("must be `folder:STAMP:PATH` or `hash:…`")?);
            }
            "--group" => self.groups.push(value.into()),
            "--sandbox" => {
                self.sandbox.level = match value.to_str() {
                    Some("none") => SandboxLevel::None,
                    Some("standard") => SandboxLevel::Standard,
                    _ => return Err("must be `none` or `standard`"),
                };
            }
            "--user" => {
                let account = value.to_str().and_then(account);
                self.sandbox.user = Some(account.ok_or("must be numbers: `UID:GID`, and more groups")?);
            }
            "--secret" => {
                let word = value.to_str().and_then(|word| word.parse().ok());
                self.secrets.push(word.ok_or("must be a number")?);
            }
            "--memory"
            | "--cpu-s"
            | "--files"
            | "--nice"
            | "--realtime"
            | "--realtime-optional"
            | "--pids"
            | "--cpu-share"
            | "--file-size" => {
                let value = value.to_str().ok_or("must be a number")?;
                set_limit(&mut self.limits, name, value).ok_or("must be a number")?;
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

/// The longest secret, in bytes.
pub const SECRET_MAX: usize = 64 << 10;

/// Adds a secret of at most [`SECRET_MAX`] bytes in the form of the standard input of a shim: the
/// length in four bytes, the lowest byte first, and then the secret.
pub fn secret(value: &[u8], to: &mut Vec<u8>) {
    let length = u32::try_from(value.len()).unwrap_or(u32::MAX);
    to.extend(length.to_le_bytes());
    to.extend(value);
}

fn limit_arguments(limits: &Limits) -> Vec<(&'static str, String)> {
    let realtime = limits.realtime.map(|Realtime { priority, is_optional }| {
        (if is_optional { "--realtime-optional" } else { "--realtime" }, priority.to_string())
    });
    let all = [
        limits.memory.map(|bytes| ("--memory", bytes.to_string())),
        limits.cpu.map(|time| ("--cpu-s", time.as_secs().to_string())),
        limits.files.map(|count| ("--files", count.to_string())),
        limits.nice.map(|nice| ("--nice", nice.to_string())),
        realtime,
        limits.pids.map(|count| ("--pids", count.to_string())),
        limits.cpu_share.map(|share| ("--cpu-share", share.to_string())),
        limits.file_size.map(|bytes| ("--file-size", bytes.to_string())),
    ];
    all.into_iter().flatten().collect()
}

fn set_limit(limits: &mut Limits, name: &str, value: &str) -> Option<()> {
    match name {
        "--memory" => limits.memory = Some(value.parse().ok()?),
        "--cpu-s" => limits.cpu = Some(Duration::from_secs(value.parse().ok()?)),
        "--files" => limits.files = Some(value.parse().ok()?),
        "--nice" => limits.nice = Some(value.parse().ok()?),
        "--pids" => limits.pids = Some(value.parse().ok()?),
        "--cpu-share" => limits.cpu_share = Some(value.parse().ok()?),
        "--file-size" => limits.file_size = Some(value.parse().ok()?),
        _ => {
            let is_optional = name == "--realtime-optional";
            limits.realtime = Some(Realtime { priority: value.parse().ok()?, is_optional });
        }
    }
    Some(())
}

/// Reads `UID:GID`, and more groups behind it.
fn account(text: &str) -> Option<Account> {
    let mut numbers = text.split(':').map(|number| number.parse().ok());
    let (uid, gid) = (numbers.next()??, numbers.next()??);
    Some(Account { uid, gid, groups: numbers.collect::<Option<_>>()? })
}

fn text(value: OsString) -> Result<String, ()> {
    value.into_string().map_err(drop)
}

#[cfg(test)]
mod tests {
    use super::super::{JudgedBy, Stamp};
    use super::*;

    fn stamp() -> Stamp {
        Stamp::of(&std::fs::metadata("/").unwrap())
    }

    #[test]
    fn start_round_trips() {
        let mut start = ShimStart {
            dir: "/run/dca/d/x".into(),
            working_directory: "/tmp".into(),
            gate: Gate::Exec,
            agent_loss_grace: Some(Duration::from_millis(20)),
            watchdog: WatchdogBounds {
                silence: Some(Duration::from_millis(500)),
                ready_within: Some(Duration::from_secs(3)),
            },
            limits: Limits {
                memory: Some(200_000_000),
                cpu: Some(Duration::from_secs(600)),
                files: Some(64),
                nice: Some(-5),
                realtime: Some(Realtime { priority: 40, is_optional: true }),
                pids: Some(32),
                cpu_share: Some(500),
                file_size: Some(10_000_000),
            },
            sandbox: Sandbox {
                level: SandboxLevel::Standard,
                user: Some(Account { uid: 61184, gid: 61184, groups: vec![20, 44] }),
                own: Some("/run/dca/c1+u/d/x".into()),
                judged: Some(Judged { path: "/opt/a b:c/d".into(), stamp: stamp(), by: JudgedBy::Hash }),
            },
            groups: vec!["/sys/fs/cgroup/pids/dca-program-7-70".into()],
            before: SoftLimits { descriptors: Some(1024), core: Some(u64::MAX) },
            environment: vec![("DCA_INSTANCE".into(), "main/a=b".into()), ("EMPTY".into(), String::new())],
            secrets: vec![2, 0],
            command: vec!["sleep".into(), "--".into(), "5".into()],
        };
        assert_eq!(ShimStart::parse(start.arguments()).as_ref(), Ok(&start));
        start.agent_loss_grace = None;
        assert_eq!(ShimStart::parse(start.arguments()), Ok(start));
    }

    #[test]
    fn start_refusals() {
        let check = |arguments: &[&str], expect: &str| {
            let error = ShimStart::parse(arguments.iter().map(OsString::from)).unwrap_err();
            assert_eq!(error.to_string(), expect);
        };
        check(&["--directory", "/d", "--"], "no program to start after `--`");
        check(&["--", "true"], "argument `--directory`: is needed");
        check(&["--gate", "open"], "argument `--gate`: must be `none` or `exec`");
        check(&["--agent-loss", "never"], "argument `--agent-loss`: must be `keep` or a number");
        check(&["--directory"], "argument `--directory`: needs a value");
        check(&["--nice", "very"], "argument `--nice`: must be a number");
        check(&["--sandbox", "strict"], "argument `--sandbox`: must be `none` or `standard`");
        check(&["--user", "root"], "argument `--user`: must be numbers: `UID:GID`, and more groups");
        for wrong in ["folder:1.2.3.4:/a", "hash:1.2.3.4.5:a", "name:1.2.3.4.5:/a", "hash"] {
            check(&["--judged", wrong], "argument `--judged`: must be `folder:STAMP:PATH` or `hash:…`");
        }
        check(&["--speed", "9"], "argument `--speed`: is unknown");
    }
}
