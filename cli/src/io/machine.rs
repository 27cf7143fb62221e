//! Examines the machine that this command runs on.

use super::interpreter;
use crate::logic::checkup::{Folder, FoundPolicy, Installed, Machine};
use comms::io::clock;
use comms::io::session;
use comms::logic::human::cause;
use node::io::folder::no_folder;
use node::io::programs::ANSWER_WITHIN;
use node::io::run_dir::RunDir;
use node::io::{cgroup, kernel, policy, programs, run_dir};
use rustix::fs::{Access, access, statvfs};
use rustix::process::{Resource, getrlimit};
use std::io;
use std::net::{IpAddr, Ipv4Addr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The command that gives a program a real-time priority. Source: chrt(1), util-linux.
const CHRT: &str = "chrt";

/// Returns the present state of this machine. `run` and `state` are the folders that nodes would use; `state` is
/// missing if the system has no such folder.
pub async fn look(run: &Path, state: Option<&Path>) -> Machine {
    let (interfaces, discovery) = session::discovery().await;
    let folders = vec![("sockets", sockets(run)), ("database", state.map_or_else(no_database, folder))];
    Machine {
        kernel: kernel::check(),
        has_groups: cgroup::is_possible(),
        clock: clock::belief(),
        interfaces,
        discovery,
        listening: listen().map_err(|error| cause(&error)),
        files: getrlimit(Resource::Nofile).maximum,
        realtime: realtime(),
        folders,
        installed: Installed {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            shim: shim(&programs::beside("dca-shim")),
            controllers: controllers(&programs::beside("dca-controller")),
            interpreters: interpreter::found(),
        },
        nodes: run_dir::running(run).unwrap_or_default().into_iter().map(|(name, _)| name).collect(),
        policies: policies(state),
    }
}

/// Returns the policy of this machine, or the policies of the nodes whose states are below this folder.
fn policies(state: Option<&Path>) -> Vec<Result<FoundPolicy, String>> {
    let found = |node: Option<&Path>| {
        let found = policy::find(node).map_err(|error| format!("{error:#}")).transpose()?;
        Some(found.map(|found| FoundPolicy {
            path: found.path.display().to_string(),
            could_be_changed_by: found.could_be_changed_by(),
        }))
    };
    let own = found(None);
    if own.is_some() {
        return own.into_iter().collect();
    }
    let mut nodes: Vec<PathBuf> =
        state.and_then(|state| state.read_dir().ok()).into_iter().flatten().flatten().map(|node| node.path()).collect();
    nodes.sort();
    nodes.iter().filter_map(|node| found(Some(node))).collect()
}

fn listen() -> io::Result<()> {
    TcpListener::bind((IpAddr::from(Ipv4Addr::UNSPECIFIED), 0)).map(drop)
}

/// Tries to give a real-time priority to a program that does nothing.
fn realtime() -> Result<(), String> {
    match asked(Path::new(CHRT), &["--fifo", "1", "true"], ANSWER_WITHIN) {
        Ok((_, true)) => Ok(()),
        Ok((_, false)) => Err("the kernel refuses it to this user".to_owned()),
        Err(why) => Err(format!("{why} (the program belongs to util-linux)")),
    }
}

/// Examines the folder for the sockets of nodes. The name of a node has at least one letter.
fn sockets(run: &Path) -> Folder {
    let found = folder(run);
    match RunDir::path_of(run, "n") {
        Ok(_) => found,
        Err(error) => Folder { writing: Err(error.to_string()), ..found },
    }
}

/// Returns the result for a node that has no folder for its database: the user named none, and the system has no default.
fn no_database() -> Folder {
    let why = "the variable `HOME` is not set; name a folder with `--state`".to_owned();
    Folder { path: "$HOME/.local/state/dca".to_owned(), free: None, writing: Err(why) }
}

/// Examines a folder. If it does not exist yet, examines the folder in which it would be made.
fn folder(path: &Path) -> Folder {
    let there = path.ancestors().find(|path| path.exists()).unwrap_or(path);
    let path = path.display().to_string();
    if !there.is_dir() {
        return Folder { path, free: None, writing: Err(no_folder(there)) };
    }
    let free = statvfs(there).ok().map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize));
    let writing = access(there, Access::WRITE_OK | Access::EXEC_OK).map_err(|error| cause(&error.into()));
    Folder { path, free, writing }
}

fn shim(path: &Path) -> Result<String, String> {
    let (said, _) = asked(path, &["--version"], ANSWER_WITHIN)?;
    let version = said.trim().strip_prefix("dca-shim ").map(str::to_owned);
    version.ok_or_else(|| format!("`{}` does not say its version", path.display()))
}

/// Runs a program. Returns its output, and whether it ended without an error.
fn asked(program: &Path, arguments: &[&str], within: Duration) -> Result<(String, bool), String> {
    let (text, status) = programs::ask(program, arguments, within)
        .map_err(|error| format!("`{}`: {}", program.display(), cause(&error)))?;
    Ok((text, status.success()))
}

fn controllers(path: &Path) -> Result<usize, String> {
    let text = programs::interfaces(path).map_err(|error| error.to_string())?;
    Ok(text.lines().filter(|line| line.trim_start().starts_with("module ")).count())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_not_there_yet_is_judged_by_the_one_above() {
        let base = std::env::temp_dir();
        let found = folder(&base.join("dca-not-there/at/all"));
        assert!(found.writing.is_ok() && found.free.is_some_and(|free| free > 0), "{found:?}");
        // Even root cannot write to this place.
        assert!(folder(Path::new("/proc/1/dca")).free.is_some_and(|free| free == 0));
        for file in ["/dev/null", "/dev/null/below"] {
            let why = folder(Path::new(file)).writing.unwrap_err();
            assert_eq!(why, "`/dev/null` is a file, where a folder is expected");
        }
    }

    #[test]
    fn a_folder_that_a_node_would_refuse_is_no_good_one() {
        assert_eq!(sockets(&std::env::temp_dir()).writing, Ok(()));
        let deep = std::env::temp_dir().join("x".repeat(90));
        assert!(sockets(&deep).writing.unwrap_err().contains("too deep"), "its sockets have no room");
        assert!(no_database().writing.is_err());
    }

    #[test]
    fn a_program_that_hangs_is_not_waited_for() {
        let hangs = asked(Path::new("sleep"), &["3600"], Duration::from_millis(20));
        assert_eq!(hangs, Err("`sleep`: no answer within 20 ms".to_owned()));
    }

    #[test]
    fn a_shim_that_is_missing_or_silent_is_told() {
        assert!(shim(Path::new("/nowhere/dca-shim")).unwrap_err().contains("no such file"));
        assert!(shim(Path::new("/bin/true")).unwrap_err().contains("does not say its version"));
    }
}
