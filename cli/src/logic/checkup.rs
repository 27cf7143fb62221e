//! Checks whether a machine is ready for a robot. Returns findings, each with a hint if there is a remedy.

use comms::io::clock::ClockQuality;
use serde::Serialize;
use std::fmt;

/// If a process may open fewer files and sockets than this, a node of a small robot runs out of them. Each program takes about ten.
const FILES_FEW: u64 = 4096;
/// If a process may open fewer files than this, not even the tutorial runs.
const FILES_MIN: u64 = 256;
/// If a disk has less free space than this, a person should know it, in bytes.
const SPACE_LOW: u64 = 1 << 30;
/// If a disk has less free space than this, output and journals will soon be refused, in bytes.
const SPACE_MIN: u64 = 64 << 20;

/// How serious a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Nothing is wrong.
    Ok,
    /// Something will not work, or will work less well.
    Warning,
    /// Programs cannot run here.
    Failed,
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Failed => "FAILED",
        })
    }
}

/// One finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// The subject of the check, in one word.
    pub name: &'static str,
    /// How serious the result is.
    pub level: Level,
    /// The result, in a sentence.
    pub finding: String,
    /// The remedy, if there is one.
    pub hint: Option<&'static str>,
}

/// The present state of a machine.
#[derive(Clone, Debug)]
pub struct Machine {
    /// An error says why the kernel does not let a node end its programs.
    pub kernel: Result<(), String>,
    /// Whether a process can have its own control group of version 2.
    pub has_groups: bool,
    /// How far the calendar clock can be trusted.
    pub clock: ClockQuality,
    /// The interfaces on which nodes of other machines can be found.
    pub interfaces: Vec<String>,
    /// An error says why no announcement of a node can be received on the interfaces.
    pub discovery: Result<(), String>,
    /// An error says why no port can be listened on.
    pub listening: Result<(), String>,
    /// How many files and sockets a process may open; nothing without a limit.
    pub files: Option<u64>,
    /// An error says why no program can have a real-time priority.
    pub realtime: Result<(), String>,
    /// The folders that nodes write to: their purpose, and their state.
    pub folders: Vec<(&'static str, Folder)>,
    /// The installed programs of DCA.
    pub installed: Installed,
    /// The nodes that run on this machine, of this user.
    pub nodes: Vec<String>,
    /// The execution policies of this machine and its nodes: their files, or why one cannot be used.
    pub policies: Vec<Result<FoundPolicy, String>>,
}

/// The programs of DCA on a machine, which have to be of one version.
#[derive(Clone, Debug)]
pub struct Installed {
    /// The version of these programs.
    pub version: String,
    /// The version of the shim, or why there is none.
    pub shim: Result<String, String>,
    /// How many controller types the `dca-controller` beside this program offers, or why it offers none.
    pub controllers: Result<usize, String>,
    /// The interpreters that would run programs in Python here.
    pub interpreters: Vec<Interpreter>,
}

/// An interpreter of Python.
#[derive(Clone, Debug)]
pub struct Interpreter {
    /// The path with which it is started.
    pub path: String,
    /// Whether it belongs to a virtual environment.
    pub is_of_venv: bool,
    /// Its version, or why it does not start.
    pub version: Result<String, String>,
    /// The package `dca` that it loads, or why it cannot load the package.
    pub package: Result<Package, String>,
}

/// The package `dca` of an interpreter.
#[derive(Clone, Debug)]
pub struct Package {
    /// Its version.
    pub version: String,
    /// The folder that it was loaded from.
    pub folder: String,
}

/// An execution policy that is valid.
#[derive(Clone, Debug)]
pub struct FoundPolicy {
    /// Its file.
    pub path: String,
    /// The user that programs run as, if this user could change the policy.
    pub could_be_changed_by: Option<String>,
}

/// A folder, or the existing folder in which it would be made.
#[derive(Clone, Debug)]
pub struct Folder {
    /// Its path.
    pub path: String,
    /// Free space on its disk, in bytes.
    pub free: Option<u64>,
    /// An error says why the folder cannot be written.
    pub writing: Result<(), String>,
}

/// Returns every finding of a machine.
pub fn findings(machine: &Machine) -> Vec<Check> {
    let mut checks = vec![kernel(machine), containment(machine), clock(machine), discovery(machine)];
    checks.extend([listening(machine), files(machine), realtime(machine)]);
    checks.extend(machine.folders.iter().map(|(name, folder)| space(name, folder)));
    let installed = &machine.installed;
    checks.extend([shim(installed), controllers(installed)]);
    checks.extend(installed.interpreters.iter().map(|one| python(one, &installed.version)));
    checks.extend([policy(machine), nodes(machine)]);
    checks
}

fn check(name: &'static str, level: Level, finding: impl Into<String>, hint: &'static str) -> Check {
    let hint = (level != Level::Ok).then_some(hint);
    Check { name, level, finding: finding.into(), hint }
}

fn kernel(machine: &Machine) -> Check {
    let (level, finding) = match &machine.kernel {
        Ok(()) => (Level::Ok, "the kernel has the system calls that a node needs to end programs".to_owned()),
        Err(why) => (Level::Failed, why.clone()),
    };
    check("kernel", level, finding, "no node starts here; use Linux 5.3 or later, and in a container a newer runtime")
}

fn containment(machine: &Machine) -> Check {
    let (level, finding) = if machine.has_groups {
        (
            Level::Ok,
            "a control group (version 2): all processes that programs start are found and ended, even after a crash",
        )
    } else {
        (
            Level::Warning,
            "no control group of its own: a node finds the daemons of a program only while the shim of the program runs",
        )
    };
    let hint = "`dca-node install` makes a service with a group of its own (`Delegate=yes`); in a container, mount a writable \
                cgroup2. It needs Linux 5.14";
    check("containment", level, finding, hint)
}

fn clock(machine: &Machine) -> Check {
    let (level, finding) = match machine.clock {
        ClockQuality::Kept => (Level::Ok, "it is synchronised"),
        ClockQuality::Plausible => {
            (Level::Warning, "it is not synchronised with other clocks: records of several hosts cannot be compared")
        }
        ClockQuality::Unset => (Level::Failed, "it shows a date that cannot be right: it was never set"),
    };
    check("clock", level, finding, "run chrony, systemd-timesyncd or ptp4l")
}

fn discovery(machine: &Machine) -> Check {
    let hint = "name other nodes: `dca-node --peer tcp/ADDRESS:PORT`; or let UDP port 7999 and the groups 224.0.0.231 and \
                ff02::dca:231 through";
    let (level, finding) = match &machine.discovery {
        Err(why) => (Level::Warning, format!("nodes cannot find each other by multicast: {why}")),
        Ok(()) if machine.interfaces.is_empty() => {
            (Level::Warning, "no network interface is up that takes part in multicast".to_owned())
        }
        Ok(()) => (Level::Ok, format!("multicast on {}", machine.interfaces.join(", "))),
    };
    check("discovery", level, finding, hint)
}

fn listening(machine: &Machine) -> Check {
    let (level, finding) = match &machine.listening {
        Ok(()) => (Level::Ok, "TCP ports can be listened on".to_owned()),
        Err(why) => (Level::Failed, format!("no TCP port can be listened on: {why}")),
    };
    check("ports", level, finding, "possible reasons: a sandbox, a security module, or a container without a network")
}

fn files(machine: &Machine) -> Check {
    let (level, finding) = match machine.files {
        None => (Level::Ok, "no limit on open files".to_owned()),
        Some(files) => {
            let level = match files {
                ..FILES_MIN => Level::Failed,
                FILES_MIN..FILES_FEW => Level::Warning,
                FILES_FEW.. => Level::Ok,
            };
            (level, format!("a process may have {files} open files and sockets"))
        }
    };
    check("files", level, finding, "raise the hard limit: `LimitNOFILE=` of a service, `ulimit -Hn` or limits.conf")
}

fn realtime(machine: &Machine) -> Check {
    let (level, finding) = match &machine.realtime {
        Ok(()) => (Level::Ok, "programs can have a real-time priority".to_owned()),
        Err(why) => (Level::Warning, format!("no program can have a real-time priority: {why}")),
    };
    check(
        "realtime",
        level,
        finding,
        "run the node as the service of `dca-node install` (`LimitRTPRIO=99`), or add an `rtprio` line to limits.conf",
    )
}

fn space(name: &'static str, folder: &Folder) -> Check {
    let path = &folder.path;
    let (level, finding) = match (&folder.writing, folder.free) {
        (Err(why), _) => (Level::Failed, format!("`{path}` cannot be written: {why}")),
        (Ok(()), None) => (Level::Ok, format!("`{path}` can be written")),
        (Ok(()), Some(free)) => {
            let level = match free {
                ..SPACE_MIN => Level::Failed,
                SPACE_MIN..SPACE_LOW => Level::Warning,
                SPACE_LOW.. => Level::Ok,
            };
            (level, format!("`{path}` has {} left", size(free)))
        }
    };
    check(name, level, finding, "choose another folder with `--run-dir` or `--state`, or make room")
}

/// Returns a size on a disk: `3.9 GiB`, `12 MiB`.
fn size(bytes: u64) -> String {
    const MIB: u64 = 1 << 20;
    match bytes / MIB {
        mib @ ..1024 => format!("{mib} MiB"),
        mib => format!("{}.{} GiB", mib / 1024, mib % 1024 * 10 / 1024),
    }
}

fn shim(installed: &Installed) -> Check {
    let (level, finding) = match &installed.shim {
        Ok(version) if *version == installed.version => (Level::Ok, format!("version {version}")),
        Ok(version) => (Level::Failed, format!("version {version}, and these programs have {}", installed.version)),
        Err(why) => (Level::Failed, why.clone()),
    };
    check("shim", level, finding, "put `dca-shim` of the same build into the folder of `dca-node`")
}

fn controllers(installed: &Installed) -> Check {
    let (level, finding) = match &installed.controllers {
        Ok(types) => (Level::Ok, format!("`dca-controller` offers {types} types")),
        Err(why) => (Level::Warning, why.clone()),
    };
    check(
        "controllers",
        level,
        finding,
        "put `dca-controller` into the folder of `dca-node`, or name your own program with `--controllers`",
    )
}

fn python(interpreter: &Interpreter, own: &str) -> Check {
    let Interpreter { path, is_of_venv, version, package } = interpreter;
    let hint = "programs with `python` in a spec need the package `dca` of this version: install `python3-dca`, or run `pip install` in \
                their environment with the folder `python` of DCA";
    let (level, finding) = match (version, package) {
        (Err(why), _) => (Level::Warning, format!("`{path}` does not start: {why}")),
        (Ok(version), Err(_)) if !is_of_venv => (Level::Ok, format!("`{path}` is Python {version}, without `dca`")),
        (Ok(version), Err(why)) => {
            (Level::Warning, format!("`{path}` is Python {version}, and `import dca` fails: {why}"))
        }
        (Ok(version), Ok(package)) => {
            let level = if package.version == own { Level::Ok } else { Level::Warning };
            let other = if level == Level::Ok { String::new() } else { format!("; these programs have {own}") };
            let Package { version: of, folder } = package;
            (level, format!("`{path}` is Python {version}, with `dca` {of} from `{folder}`{other}"))
        }
    };
    check("python", level, finding, hint)
}

fn policy(machine: &Machine) -> Check {
    let wrong: Vec<&str> = machine.policies.iter().filter_map(|one| one.as_ref().err().map(String::as_str)).collect();
    let files: Vec<&str> = machine.policies.iter().flatten().map(|one| one.path.as_str()).collect();
    let weak = |one: &FoundPolicy| {
        let user = one.could_be_changed_by.as_ref()?;
        Some(format!("`{user}`, as whom programs run, could change `{}`", one.path))
    };
    let weak: Vec<String> = machine.policies.iter().flatten().filter_map(weak).collect();
    if wrong.is_empty() && !weak.is_empty() {
        let hint = "keep the policy in `/etc/dca`, to which only root can write, and run programs as another user";
        return check("policy", Level::Warning, weak.join("; "), hint);
    }
    let (level, finding) = if !wrong.is_empty() {
        (Level::Failed, wrong.join("; "))
    } else if files.is_empty() {
        (Level::Ok, "no policy: every user who may deploy can start any program as the user of the node".to_owned())
    } else {
        (Level::Ok, format!("`{}` limits the programs", files.join("`, `")))
    };
    check(
        "policy",
        level,
        finding,
        "correct the file: with this policy, a node does not start, and a running node starts no more programs",
    )
}

fn nodes(machine: &Machine) -> Check {
    let finding = match &machine.nodes[..] {
        [] => "no node of this user runs here".to_owned(),
        nodes => format!("`{}`", nodes.join("`, `")),
    };
    check("nodes", Level::Ok, finding, "")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn python(version: &str) -> Interpreter {
        let package = Package { version: version.into(), folder: "/venv/dca".into() };
        Interpreter {
            path: ".venv/bin/python".into(),
            is_of_venv: true,
            version: Ok("3.12.1".into()),
            package: Ok(package),
        }
    }

    fn good() -> Machine {
        let folder = Folder { path: "/run/dca".into(), free: Some(4 << 30), writing: Ok(()) };
        Machine {
            kernel: Ok(()),
            has_groups: true,
            clock: ClockQuality::Kept,
            interfaces: vec!["eth0".into()],
            discovery: Ok(()),
            listening: Ok(()),
            files: Some(524_288),
            realtime: Ok(()),
            folders: vec![("sockets", folder)],
            installed: Installed {
                version: "1".into(),
                shim: Ok("1".into()),
                controllers: Ok(20),
                interpreters: vec![python("1")],
            },
            nodes: vec!["c1".into()],
            policies: vec![Ok(FoundPolicy { path: "/etc/dca/policy.toml".into(), could_be_changed_by: None })],
        }
    }

    #[test]
    fn a_good_machine_has_no_hints() {
        let checks = findings(&good());
        assert!(checks.iter().all(|check| check.level == Level::Ok && check.hint.is_none()), "{checks:#?}");
        assert_eq!(checks.len(), 13);
        let python = checks.iter().find(|check| check.name == "python").map(|check| check.finding.as_str());
        assert_eq!(python, Some("`.venv/bin/python` is Python 3.12.1, with `dca` 1 from `/venv/dca`"));
    }

    /// Checks that one finding about a machine with a flaw has this level and this text, and that all other findings are good.
    #[track_caller]
    fn check_flaw(flaw: impl FnOnce(&mut Machine), level: Level, name: &str, words: &str) {
        let mut machine = good();
        flaw(&mut machine);
        let bad: Vec<Check> = findings(&machine).into_iter().filter(|check| check.level != Level::Ok).collect();
        let [one] = &bad[..] else { panic!("{bad:#?}") };
        assert!(one.level == level && one.name == name && one.finding.contains(words), "{one:#?}");
        assert!(one.hint.is_some_and(|hint| !hint.is_empty()));
    }

    #[test]
    fn each_flaw_is_one_finding_with_a_hint() {
        let no = || Err("no".to_owned());
        check_flaw(|it| it.kernel = no(), Level::Failed, "kernel", "no");
        check_flaw(|it| it.has_groups = false, Level::Warning, "containment", "no control group");
        check_flaw(|it| it.clock = ClockQuality::Plausible, Level::Warning, "clock", "it is not synchronised");
        check_flaw(|it| it.clock = ClockQuality::Unset, Level::Failed, "clock", "cannot be right");
        check_flaw(|it| it.interfaces.clear(), Level::Warning, "discovery", "no network interface");
        check_flaw(|it| it.discovery = no(), Level::Warning, "discovery", "by multicast: no");
        check_flaw(|it| it.listening = no(), Level::Failed, "ports", "no TCP port");
        check_flaw(|it| it.files = Some(1024), Level::Warning, "files", "1024 open files");
        check_flaw(|it| it.files = Some(64), Level::Failed, "files", "64 open files");
        check_flaw(|it| it.realtime = no(), Level::Warning, "realtime", "priority: no");
        check_flaw(|it| it.folders[0].1.free = Some(100 << 20), Level::Warning, "sockets", "left");
        check_flaw(|it| it.folders[0].1.free = Some(1 << 20), Level::Failed, "sockets", "left");
        check_flaw(|it| it.folders[0].1.writing = no(), Level::Failed, "sockets", "cannot be written: no");
        check_flaw(
            |it| it.installed.shim = Ok("2".into()),
            Level::Failed,
            "shim",
            "version 2, and these programs have 1",
        );
        check_flaw(|it| it.installed.shim = Err("it is not there".into()), Level::Failed, "shim", "it is not there");
        check_flaw(|it| it.installed.controllers = Err("no".into()), Level::Warning, "controllers", "no");
        check_flaw(|it| it.policies.push(Err("line 3: no".into())), Level::Failed, "policy", "line 3: no");
        check_flaw(
            |it| it.installed.interpreters = vec![python("2")],
            Level::Warning,
            "python",
            "with `dca` 2 from `/venv/dca`; these programs have 1",
        );
        check_flaw(
            |it| it.installed.interpreters[0].package = Err("no".into()),
            Level::Warning,
            "python",
            "`import dca` fails: no",
        );
        check_flaw(
            |it| it.installed.interpreters[0].version = Err("no".into()),
            Level::Warning,
            "python",
            "does not start: no",
        );
        let weak = || Ok(FoundPolicy { path: "p".into(), could_be_changed_by: Some("ann".into()) });
        check_flaw(
            |it| it.policies.push(weak()),
            Level::Warning,
            "policy",
            "`ann`, as whom programs run, could change `p`",
        );
    }
}
