//! The control group of one program that has limits which only a group can hold: memory, processes, processor share.
//!
//! The shim makes the group before the gate, so that a host that cannot hold a limit refuses while nothing
//! runs. The program joins the group before it is executed, so that all its child processes begin in the
//! group. The second version of control groups is used where its controllers are delegated, the first where
//! it is mounted and writable. Sources: cgroup-v2.rst, cgroup-v1/{memory,pids}.rst and sched-bwc.rst in
//! Documentation of Linux.

use comms::logic::human::cause;
use shim::process_record::Process;
use shim::processes;
use shim::protocol::{EndReason, LimitKind, Limits, ProgramEnd, ShimStart};
use std::io;
use std::path::{Path, PathBuf};

/// How the name of a group begins; the number and the start time of its shim follow.
const PREFIX: &str = "dca-program-";
/// The period of a share of the processor, in microseconds: the kernel's own default.
const PERIOD_US: u64 = 100_000;

/// A controller of control groups: the kind of limit that a group has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Controller {
    Memory,
    Pids,
    Cpu,
}

impl Controller {
    const fn name(self) -> &'static str {
        match self {
            Self::Memory => "memory",
            Self::Pids => "pids",
            Self::Cpu => "cpu",
        }
    }
}

/// Where groups for one controller can be made.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Place {
    folder: PathBuf,
    is_unified: bool,
}

/// The groups of the program, one for each hierarchy.
#[derive(Debug, Default)]
pub(crate) struct Group {
    folders: Vec<PathBuf>,
    memory: Option<(Place, u64)>,
    pids: Option<(Place, u64)>,
}

impl Group {
    /// Makes the groups that the limits need. Without a group for it, memory is limited as address space by the launch.
    ///
    /// # Errors
    /// A limit that this host cannot hold, for a person.
    pub(crate) fn make(limits: &Limits) -> Result<Self, String> {
        let mut group = Self::default();
        if let Some(count) = limits.pids {
            let (file, value) = ("pids.max", count.to_string());
            let made = group.limit(Controller::Pids, |_| vec![(file, value.clone())]);
            group.pids =
                Some((made.map_err(|why| refused(&format!("{count} processes"), Controller::Pids, &why))?, count));
        }
        if let Some(share) = limits.cpu_share {
            let quota = PERIOD_US * u64::from(share) / 1000;
            let files = |is_unified: bool| {
                if is_unified {
                    vec![("cpu.max", format!("{quota} {PERIOD_US}"))]
                } else {
                    vec![("cpu.cfs_period_us", PERIOD_US.to_string()), ("cpu.cfs_quota_us", quota.to_string())]
                }
            };
            let what = format!("{} processors", f64::from(share) / 1000.0);
            group.limit(Controller::Cpu, files).map_err(|why| refused(&what, Controller::Cpu, &why))?;
        }
        if let Some(bytes) = limits.memory {
            let files = |is_unified: bool| {
                let file = if is_unified { "memory.max" } else { "memory.limit_in_bytes" };
                vec![(file, bytes.to_string())]
            };
            group.memory = group.limit(Controller::Memory, files).ok().map(|place| (place, bytes));
            if let Some((place, _)) = &group.memory {
                // Without swap the limit covers all memory; a kernel without swap has no such file.
                let (file, value) =
                    if place.is_unified { ("memory.swap.max", 0) } else { ("memory.memsw.limit_in_bytes", bytes) };
                std::fs::write(place.folder.join(file), value.to_string()).unwrap_or_default();
            }
        }
        Ok(group)
    }

    /// Returns how the program is started in its groups. The launch does not set the limits that the groups enforce.
    pub(crate) fn start(&self, start: &ShimStart) -> ShimStart {
        let mut start = ShimStart { groups: self.folders.clone(), ..start.clone() };
        start.limits.memory = start.limits.memory.filter(|_| self.memory.is_none());
        start
    }

    /// Makes the group of a controller, and writes its limits; `files` returns them for the second or the first
    /// version.
    fn limit(
        &mut self,
        controller: Controller,
        files: impl Fn(bool) -> Vec<(&'static str, String)>,
    ) -> Result<Place, String> {
        let place = place(controller)?;
        let this = processes::this().ok_or("its shim cannot be named")?;
        let folder = place.folder.join(format!("{PREFIX}{}-{}", this.pid, this.started));
        if !self.folders.contains(&folder) {
            remove_abandoned(&place.folder);
            std::fs::create_dir(&folder).map_err(|error| cannot("make", &folder, &error))?;
            self.folders.push(folder.clone());
        }
        for (file, value) in files(place.is_unified) {
            let path = folder.join(file);
            std::fs::write(&path, value).map_err(|error| cannot("write", &path, &error))?;
        }
        Ok(Place { folder, ..place })
    }

    /// Returns the limit that a program with this end has reached. None if the program reached no limit.
    pub(crate) fn reason(&self, end: ProgramEnd) -> Option<EndReason> {
        let count = |place: &Place, file: &str, name: &str| {
            let text = std::fs::read_to_string(place.folder.join(file)).unwrap_or_default();
            text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse::<u64>().ok()).unwrap_or(0)
        };
        if end == ProgramEnd::Exit(0) {
            return None;
        }
        if let Some((place, bytes)) = &self.memory {
            let file = if place.is_unified { "memory.events" } else { "memory.oom_control" };
            if count(place, file, "oom_kill ") > 0 {
                return Some(EndReason::OutOfMemory(*bytes));
            }
        }
        // A killed program has not ended because it could not start a process.
        let (place, most) = self.pids.as_ref().filter(|_| end != ProgramEnd::Signal(9))?;
        (count(place, "pids.events", "max ") > 0).then_some(EndReason::Limit(LimitKind::Pids, *most))
    }
}

impl Drop for Group {
    /// Removes the groups, once nothing of the program is left.
    fn drop(&mut self) {
        for folder in &self.folders {
            // A group that is not empty is removed by the next shim that makes a group there.
            std::fs::remove_dir(folder).unwrap_or_default();
        }
    }
}

fn refused(what: &str, controller: Controller, why: &str) -> String {
    format!("a limit of {what} is refused: it needs the control group `{}`, and {why}", controller.name())
}

fn cannot(action: &str, path: &Path, error: &io::Error) -> String {
    format!("this user cannot {action} `{}`: {}", path.display(), cause(error))
}

/// Removes the empty groups of shims that were killed.
fn remove_abandoned(place: &Path) {
    for folder in std::fs::read_dir(place).into_iter().flatten().flatten().map(|entry| entry.path()) {
        let name = folder.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_prefix(PREFIX));
        let process = name
            .and_then(|name| name.split_once('-'))
            .and_then(|(pid, started)| Some(Process { pid: pid.parse().ok()?, started: started.parse().ok()? }));
        if process.is_some_and(|process| !processes::is_running(process)) {
            std::fs::remove_dir(&folder).unwrap_or_default();
        }
    }
}

/// Returns where a group for the controller can be made, or why there is no such place.
fn place(controller: Controller) -> Result<Place, String> {
    let read = |file: &str| std::fs::read_to_string(file).unwrap_or_default();
    let nowhere = || "this host has none".to_owned();
    let mut place = find(controller, &read("/proc/self/mountinfo"), &read("/proc/self/cgroup")).ok_or_else(nowhere)?;
    if !place.is_unified {
        return Ok(place);
    }
    // The group of a node holds processes, so groups with controllers are made beside it.
    if place.folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with("dca-")) {
        place.folder.pop();
    }
    let has = |file: &str| {
        read(&place.folder.join(file).display().to_string()).split(' ').any(|one| one.trim() == controller.name())
    };
    if !has("cgroup.controllers") {
        return Err(nowhere());
    }
    let control = place.folder.join("cgroup.subtree_control");
    if !has("cgroup.subtree_control") {
        let wanted = format!("+{}", controller.name());
        std::fs::write(&control, wanted).map_err(|error| cannot("write", &control, &error))?;
    }
    Ok(place)
}

/// Returns the folder of the group that this process is in for a controller, from the texts of `/proc/self/mountinfo`
/// and `/proc/self/cgroup`. The first version is looked at first: a controller of the first version is not in the second. Sources:
/// proc_pid_mountinfo(5), cgroups(7).
fn find(controller: Controller, mounts: &str, groups: &str) -> Option<Place> {
    let path = |is_own: &dyn Fn(&str) -> bool| {
        groups.lines().find_map(|line| {
            let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
            is_own(controllers).then(|| path.to_owned())
        })
    };
    let folder = |kind: &str, option: Option<&str>, path: &str| {
        mounts.lines().find_map(|line| {
            let (before, after) = line.split_once(" - ")?;
            let (mut fields, mut after) = (before.split(' ').skip(3), after.split(' '));
            let (root, mount) = (fields.next()?, fields.next()?);
            let relative = Path::new(path).strip_prefix(root).ok()?;
            let is_kind = after.next() == Some(kind);
            let has = |option: &str| after.nth(1).is_some_and(|options| options.split(',').any(|one| one == option));
            (is_kind && option.is_none_or(has)).then(|| Path::new(mount).join(relative))
        })
    };
    let name = controller.name();
    let first = path(&|controllers| controllers.split(',').any(|one| one == name));
    if let Some(folder) = first.and_then(|path| folder("cgroup", Some(name), &path)) {
        return Some(Place { folder, is_unified: false });
    }
    let path = path(&str::is_empty)?;
    Some(Place { folder: folder("cgroup2", None, &path)?, is_unified: true })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controller_is_looked_for_in_both_versions() {
        let mounts = "32 31 0:29 / /sys/fs/cgroup/cpu,cpuacct rw,relatime - cgroup cgroup rw,cpu,cpuacct\n\
                      35 31 0:32 /box /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory\n\
                      41 31 0:38 / /sys/fs/cgroup/unified rw,relatime - cgroup2 cgroup2 rw\n";
        let groups = "4:memory:/box/7\n3:cpuset:/\n1:cpu,cpuacct:/\n0::/user/a\n";
        let check = |controller, folder: &str, is_unified| {
            let expected = Place { folder: folder.into(), is_unified };
            assert_eq!(find(controller, mounts, groups), Some(expected));
        };
        check(Controller::Memory, "/sys/fs/cgroup/memory/7", false);
        check(Controller::Cpu, "/sys/fs/cgroup/cpu,cpuacct/", false);
        check(Controller::Pids, "/sys/fs/cgroup/unified/user/a", true);
        assert_eq!(find(Controller::Pids, "", groups), None);
    }
}
