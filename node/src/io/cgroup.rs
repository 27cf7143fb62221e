//! Makes a control group for this process and everything that it starts, if the system allows this.
//!
//! The process moves into its own group once, at its start. All of its children begin in this group. So starting a
//! program costs nothing extra. No program can leave the group by changing its parent, session or environment. After a
//! crash, the next run finds the group by the file with its name, and kills its processes. Only the second version of
//! control groups is used (`cgroup.kill`: Linux 5.14). Source: Documentation/admin-guide/cgroup-v2.rst.

use crate::logic::protocol::Containment;
use comms::io::file;
use shim::process_record::Process;
use shim::processes;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The file in a node's folder with the name of the node's group.
const GROUP_FILE: &str = "cgroup";
/// The beginning of a group's name. The number and the start time of the group's process follow.
const PREFIX: &str = "dca-";

/// The longest name of a group, in bytes.
const NAME_MAX: usize = 4096;

/// The group of this process, once it has one.
static OWN: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Moves this process into its own control group, unless it is already in such a group, and writes the group's name into `folder`.
/// Does nothing if the system does not allow it: in containers, and in sessions without delegation.
pub fn enter(folder: &Path) {
    let mut own = OWN.lock().unwrap_or_else(PoisonError::into_inner);
    if own.is_none() {
        *own = make();
    }
    let written = own.as_ref().map(|group| file::write(&folder.join(GROUP_FILE), group.to_string_lossy().as_bytes()));
    if let Some(Err(error)) = written {
        let file = folder.join(GROUP_FILE);
        tracing::warn!(file = %file.display(), %error, "cannot store the name of the control group");
    }
}

/// Returns whether a process that starts in the present group could get its own group. Tries this by making and removing one.
pub fn is_possible() -> bool {
    let own = OWN.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(place) = place().filter(|_| own.is_none()) else { return own.is_some() };
    let trial = place.join(format!("{PREFIX}trial-{}", std::process::id()));
    // If `cgroup.kill` is missing, the kernel is too old.
    let is_made = takes_groups(&place) && std::fs::create_dir(&trial).is_ok();
    let is_possible = is_made && trial.join("cgroup.kill").exists();
    if is_made {
        remove(&trial);
    }
    is_possible
}

/// Moves this process into the group of the earlier run in `folder`, whose programs this process adopts.
pub fn enter_recorded(folder: &Path) {
    let mut own = OWN.lock().unwrap_or_else(PoisonError::into_inner);
    if own.is_none() {
        *own = recorded(folder).filter(|group| join(group).is_ok());
    }
}

/// Returns the group of this process, if the process has its own.
pub fn own() -> Option<PathBuf> {
    OWN.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Returns how the programs of this process are contained.
pub fn containment() -> Containment {
    let is_in_group = OWN.lock().unwrap_or_else(PoisonError::into_inner).is_some();
    if is_in_group { Containment::ControlGroup } else { Containment::Subreaper }
}

/// Moves this process out of its group. Removes the group if no other process is in it.
pub fn leave() {
    let Some(group) = OWN.lock().unwrap_or_else(PoisonError::into_inner).take() else { return };
    let parent = group.parent().unwrap_or(Path::new("/"));
    // If this process may not return to the parent, the group stays until the machine stops or the next run removes it.
    if std::fs::write(parent.join("cgroup.procs"), std::process::id().to_string()).is_ok() {
        remove(&group);
    }
}

/// Returns the group of the earlier run in `folder`. Returns nothing if there is none, or if the process of that run is alive.
pub fn recorded(folder: &Path) -> Option<PathBuf> {
    let name = file::bytes(&folder.join(GROUP_FILE), NAME_MAX).ok()?;
    let group = PathBuf::from(String::from_utf8(name).ok()?);
    let process = process_of(&group)?;
    // If the group also holds this process, it cannot be killed as a whole. In this case, a program of the earlier run
    // has started this process.
    let holds_this = place().is_none_or(|place| place.starts_with(&group));
    (group.join("cgroup.procs").is_file() && !processes::is_running(process) && !holds_this).then_some(group)
}

/// Returns the process ids of a group.
pub fn members(group: &Path) -> Vec<i32> {
    let text = std::fs::read_to_string(group.join("cgroup.procs")).unwrap_or_default();
    text.lines().filter_map(|line| line.parse().ok()).collect()
}

/// Kills every process of a group at once.
pub fn kill(group: &Path) {
    // Older kernels do not have this file; the caller also kills the processes one by one.
    std::fs::write(group.join("cgroup.kill"), "1").unwrap_or_default();
}

/// Removes an empty group.
pub fn remove(group: &Path) {
    if let Err(error) = std::fs::remove_dir(group) {
        tracing::debug!(%error, ?group, "a control group stays");
    }
}

fn make() -> Option<PathBuf> {
    let place = place().filter(|place| takes_groups(place))?;
    let this = processes::this()?;
    remove_abandoned(&place);
    let group = place.join(format!("{PREFIX}{}-{}", this.pid, this.started));
    let moved = std::fs::create_dir(&group).and_then(|()| join(&group));
    if let Err(error) = moved {
        tracing::debug!(%error, "no control group of its own");
        return None;
    }
    Some(group)
}

/// Returns whether groups can be made in this group. If controllers are enabled in it, another group would change the share
/// of the machine that this process gets. Controllers for limits do not count: this node or an earlier one has enabled them
/// for programs.
fn takes_groups(place: &Path) -> bool {
    let of_limits = ["memory", "pids", "cpu"];
    let controllers = std::fs::read_to_string(place.join("cgroup.subtree_control"));
    controllers.is_ok_and(|controllers| controllers.split_whitespace().all(|one| of_limits.contains(&one)))
}

/// Removes empty groups whose processes were killed and had no successor.
fn remove_abandoned(place: &Path) {
    let groups = std::fs::read_dir(place).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_over = |group: &PathBuf| process_of(group).is_some_and(|process| !processes::is_running(process));
    groups.filter(is_over).filter(|group| members(group).is_empty()).for_each(|group| remove(&group));
}

/// Returns the process that a group was made for.
fn process_of(group: &Path) -> Option<Process> {
    let (pid, started) = group.file_name()?.to_str()?.strip_prefix(PREFIX)?.split_once('-')?;
    Some(Process { pid: pid.parse().ok()?, started: started.parse().ok()? })
}

fn join(group: &Path) -> io::Result<()> {
    let joined = std::fs::write(group.join("cgroup.procs"), std::process::id().to_string());
    if joined.is_err() {
        remove(group);
    }
    joined
}

/// Returns the folder of the group that contains this process.
fn place() -> Option<PathBuf> {
    let groups = std::fs::read_to_string("/proc/self/cgroup").ok()?;
    let path = groups.lines().find_map(|line| line.strip_prefix("0::"))?.to_owned();
    let mounts = std::fs::read_to_string("/proc/self/mountinfo").ok()?;
    mounts.lines().find_map(|line| below_mount(line, &path))
}

/// If a line of `/proc/self/mountinfo` is a mount that shows the group `path`, returns the folder of the group. Source:
/// proc_pid_mountinfo(5): fields 4 and 5 are the root and the place of the mount, the type follows ` - `.
fn below_mount(line: &str, path: &str) -> Option<PathBuf> {
    let (before, after) = line.split_once(" - ")?;
    let mut fields = before.split(' ').skip(3);
    let (root, mount) = (fields.next()?, fields.next()?);
    let relative = Path::new(path).strip_prefix(root).ok()?;
    (after.split(' ').next() == Some("cgroup2")).then(|| Path::new(mount).join(relative))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_of_a_group_is_found_below_its_mount() {
        let check = |line: &str, path: &str, expected: Option<&str>| {
            assert_eq!(below_mount(line, path), expected.map(PathBuf::from));
        };
        let unified = "30 23 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate";
        check(unified, "/user.slice/a.scope", Some("/sys/fs/cgroup/user.slice/a.scope"));
        check(unified, "/", Some("/sys/fs/cgroup"));
        let inside = "30 23 0:26 /docker/7 /sys/fs/cgroup rw - cgroup2 cgroup rw";
        check(inside, "/docker/7/app", Some("/sys/fs/cgroup/app"));
        check(inside, "/other", None);
        check("31 23 0:27 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu", "/", None);
    }
}
