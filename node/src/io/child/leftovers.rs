//! Ends the leftovers of an earlier run: programs whose shims were killed.
//!
//! A leftover is found by several marks. Its control group: a process cannot leave it by itself. The record of its
//! shim: process ids, start times, the session. Its parents. The marks in its environment. After its node has died, a
//! daemon with an empty environment and its own session is found only by its control group.
//!
//! A program can write to its folder, so its record may name any process. A named process is ended only if it runs as
//! the user of this node or as the user of the program. So a program that is root in a sandbox cannot make its node
//! signal a process that the program itself must not signal.

use crate::io::{cgroup, run_dir};
use comms::io::clock::{Wakeup, now};
use comms::io::file;
use comms::logic::time::Time;
use rustix::process::{Pid, Signal, WaitOptions, getpid, getuid, waitpid};
use shim::process_record::{Process, ProcessRecord, RECORD_FILE};
use shim::processes::{self, Stat};
use shim::protocol::DIRECTORY;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The most rounds of stopping before processes are killed. A program may fork faster than it can be stopped; it is
/// then killed step by step.
const STOP_ROUNDS_MAX: usize = 20;
/// How long the kernel may take to remove killed processes.
const KILL_WITHIN: Duration = Duration::from_secs(5);
/// How much longer than the grace period of its program a shim may take.
const SHIM_MARGIN: Duration = Duration::from_secs(1);
/// The pause before processes are killed again that the kernel has not removed.
pub const END_AGAIN: Duration = Duration::from_secs(1);
/// The longest record of a program, in bytes.
const RECORD_MAX: usize = 1 << 20;
/// The period between two looks at all processes.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// The name of a shim in the kernel's list of processes.
const SHIM: &str = "dca-shim";
/// The names of processes that contain a node, in the kernel's list of processes.
const NODES: [&str; 2] = ["dca-node", "dca"];

/// Describes which processes are leftovers.
#[derive(Debug)]
struct Search {
    /// Folders of this node. A leftover has one of them, or a folder inside one, as its `DCA_DIR`.
    folders: BTreeSet<PathBuf>,
    records: Vec<Recorded>,
    /// The control group of the earlier run, if it had one.
    group: Option<PathBuf>,
    /// Whether processes without a shim count as well. If a shim is killed, its leftovers become children of the node
    /// that started it. If another node has adopted the shim, they stay in the control group of that node.
    adopts: bool,
}

/// The record of a program, and the users that it may run as.
#[derive(Debug)]
struct Recorded {
    record: ProcessRecord,
    users: [u32; 2],
}

/// Kills the leftovers of the program in `dir`, whose shim was killed. This is one of several rounds; returns whether
/// nothing is left. Blocks, for 5 s at most in the first round, `0`. The next round is due [`END_AGAIN`] later.
pub fn end_round(dir: &Path, round: u32) -> bool {
    let left = Search::instance(dir).kill(if round == 0 { KILL_WITHIN } else { Duration::ZERO });
    if round == 0 {
        tell_left(&left, dir);
    }
    left.is_empty()
}

/// Reports processes that could not be ended, if there are any.
pub fn tell_left(left: &[i32], whose: &Path) {
    if !left.is_empty() {
        tracing::error!(?left, ?whose, "processes without a shim cannot be ended: they may still move something");
    }
}

/// Returns the process id of a living node that has started programs of `folder`, although its lock was removed
/// together with the folder. A node that is being killed has no open file any more, not even its lock.
pub fn living_node(folder: &Path) -> Option<i32> {
    let this = getpid().as_raw_nonzero().get();
    let all: Vec<Stat> = processes::all().into_iter().filter(|stat| !stat.is_zombie).collect();
    let is_node = |pid: i32| comm(pid).is_some_and(|name| NODES.contains(&name.as_str()));
    let ours = all.iter().filter(|stat| comm(stat.process.pid).as_deref() == Some(SHIM));
    let ours = ours.filter(|shim| directory(shim.process.pid).is_some_and(|dir| dir.starts_with(folder)));
    // If the node of a shim is gone, the shim has another parent.
    ours.map(|shim| shim.parent)
        .find(|parent| *parent != this && is_node(*parent) && processes::has_open_files(*parent))
}

/// Stops the leftovers of earlier runs of the node in `folder`, and returns the processes that could not be ended. Each
/// program gets the grace period that it was started with. Then everything is killed. Blocks for as long as this takes.
pub fn end_all(folder: &Path) -> Vec<i32> {
    let boot = processes::kernel_boot();
    let records = instances(folder).filter_map(|dir| read_record(&dir)).filter(|one| one.record.boot == boot).collect();
    let folders = [folder.to_owned()].into();
    let search = Search { folders, records, group: cgroup::recorded(folder), adopts: false };
    let found = search.find();
    if !found.is_empty() {
        tracing::warn!(count = found.len(), "ending processes that an earlier run has left");
        search.stop();
    }
    let left = search.kill(KILL_WITHIN);
    search.group.iter().for_each(|group| cgroup::remove(group));
    left
}

/// Kills the leftovers of earlier runs of the node in `folder`. The programs with their folders in `known` stay if
/// their shims are alive. The processes are listed once for all folders. If the shim of a program has reported its end,
/// there is neither a record nor a shim, so nothing is searched for this program. Blocks.
pub fn end_others(folder: &Path, known: &BTreeSet<PathBuf>) {
    let (boot, shims) = (processes::kernel_boot(), Shims::find());
    let (mut kept, mut left, mut records) = (Vec::new(), BTreeSet::new(), Vec::new());
    for dir in instances(folder) {
        let recorded = read_record(&dir).filter(|one| one.record.boot == boot);
        // If the record was overwritten, it names no shim. The shim is then recognised by its command line.
        let named = recorded.as_ref().and_then(|one| one.record.shim).filter(|shim| processes::is_running(*shim));
        let shim = named.or_else(|| shims.of(&dir).first().copied());
        if let Some(shim) = shim.filter(|_| known.contains(&dir)) {
            kept.push(shim.pid);
        } else if shim.is_some() || recorded.is_some() {
            tracing::warn!(?dir, "ending a program without its shim, or without a deployment");
            records.extend(recorded);
            left.insert(dir);
        }
    }
    if !left.is_empty() {
        let search = Search { folders: left, records, group: None, adopts: true };
        tell_left(&search.kill(KILL_WITHIN), folder);
        for dir in &search.folders {
            std::fs::remove_file(dir.join(RECORD_FILE)).unwrap_or_default();
        }
    }
    if let Some(group) = cgroup::recorded(folder) {
        end_strays(&group, &kept);
    }
}

/// Returns the folders of the programs of a node.
fn instances(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let deployments = folders(folder).filter(|folder| folder.to_string_lossy().contains('.'));
    deployments.flat_map(|deployment| folders(&deployment).collect::<Vec<_>>())
}

/// Kills the processes in a control group that do not descend from these shims. Shims inherit all orphans of their programs.
fn end_strays(group: &Path, shims: &[i32]) {
    let (until, pause) = (now() + KILL_WITHIN, Wakeup::default());
    loop {
        let strays = strays(group, |_| shims.to_vec());
        if strays.is_empty() {
            return;
        }
        for signal in [Signal::STOP, Signal::KILL] {
            strays.iter().for_each(|stray| processes::signal(*stray, signal));
        }
        if now() >= until {
            let pids: Vec<i32> = strays.iter().map(|stray| stray.pid).collect();
            return tell_left(&pids, group);
        }
        pause.wait(Some(now() + LOOK_EVERY));
    }
}

/// Returns the processes in a control group that are not in `roots` and do not descend from these. `roots` chooses from
/// the members of the group. The group is read twice: while processes are listed, a process may change its parent and
/// seem to have none.
fn strays(group: &Path, roots: impl Fn(&BTreeSet<i32>) -> Vec<i32>) -> BTreeSet<Process> {
    let look = || {
        let members: BTreeSet<i32> = cgroup::members(group).into_iter().collect();
        let (all, roots) = (processes::all(), roots(&members));
        let mut ours: BTreeSet<i32> =
            processes::descendants(&all, roots.clone()).into_iter().map(|one| one.pid).collect();
        ours.extend(roots);
        let is_stray =
            |stat: &&Stat| !stat.is_zombie && members.contains(&stat.process.pid) && !ours.contains(&stat.process.pid);
        all.iter().filter(is_stray).map(|stat| stat.process).collect::<BTreeSet<Process>>()
    };
    let first = look();
    if first.is_empty() { first } else { first.intersection(&look()).copied().collect() }
}

/// Kills the shim of the program in `dir`, which does not obey orders, and then its program. A shim that is traced ends
/// only when its tracer lets it, and the tracer may be the program. The program is ended like any leftover of a killed
/// shim. Blocks, for 5 s at most.
pub fn kill_shim(dir: &Path) {
    for shim in Shims::find().of(dir) {
        tracing::warn!(?dir, "a shim has not ended its program in time: killing the shim");
        processes::signal(*shim, Signal::KILL);
    }
    end_round(dir, 0);
}

/// Collects the children that had already ended at the previous look, `seen`, and returns the children that have ended
/// since. If the parent of a process dies, the process becomes a child of the first process of a container, or of the
/// node that started it. The node waits for its own children at once, and a task waits for each shim. Blocks.
pub fn reap_orphans(seen: &BTreeSet<Process>) -> BTreeSet<Process> {
    let ended: BTreeSet<Process> =
        processes::ended_children().into_iter().filter(|child| !is_shim(child.pid)).collect();
    for orphan in ended.intersection(seen) {
        waitpid(Pid::from_raw(orphan.pid), WaitOptions::NOHANG).map(|_ended| ()).unwrap_or_default();
    }
    ended.difference(seen).copied().collect()
}

/// Returns the program in `dir`, according to the record of its shim.
pub(super) fn program_of(dir: &Path) -> Option<Process> {
    read_record(dir)?.record.program
}

/// Makes the shim of the program in `dir` report: its program has ended without a report. A suspended shim is resumed.
/// If it still does not report, it is killed. Blocks.
pub fn press_shim(dir: &Path, is_urgent: bool) {
    for shim in Shims::find().of(dir) {
        if !processes::stat(shim.pid).is_some_and(|stat| stat.process == *shim && stat.is_stopped) {
            continue;
        }
        if is_urgent {
            tracing::warn!(?dir, "a shim is still suspended after the end of its program: killing the shim");
            processes::signal(*shim, Signal::KILL);
        } else {
            tracing::warn!(?dir, "a shim is suspended after the end of its program: resuming the shim");
            processes::signal(*shim, Signal::CONT);
        }
    }
}

/// Returns whether a shim of an earlier run exists for the program in `dir`, or is just being started.
pub fn has_shim(dir: &Path) -> bool {
    !Shims::find().of(dir).is_empty()
}

/// The shims of this machine, by the folders of their programs.
struct Shims(BTreeMap<PathBuf, Vec<Process>>);

impl Shims {
    /// Finds all shims by looking at every process once.
    fn find() -> Self {
        let mut found: BTreeMap<PathBuf, Vec<Process>> = BTreeMap::new();
        for stat in processes::all().into_iter().filter(|stat| !stat.is_zombie && is_shim(stat.process.pid)) {
            let folder = directory(stat.process.pid);
            folder.into_iter().for_each(|folder| found.entry(folder).or_default().push(stat.process));
        }
        Self(found)
    }

    /// Returns the shims of the program in `dir`.
    fn of(&self, dir: &Path) -> &[Process] {
        self.0.get(dir).map_or(&[], Vec::as_slice)
    }
}

/// Returns the folder of a shim's program, from the command line of the shim.
fn directory(pid: i32) -> Option<PathBuf> {
    let command = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
    let mut words = command.split(|byte| *byte == 0).skip_while(|word| *word != DIRECTORY.as_bytes());
    words.nth(1).map(|folder| PathBuf::from(OsStr::from_bytes(folder)))
}

impl Search {
    /// Returns the search for the leftovers of the program in `dir`, whose shim was killed.
    fn instance(dir: &Path) -> Self {
        let records = read_record(dir).into_iter().collect();
        Self { folders: [dir.to_owned()].into(), records, group: None, adopts: true }
    }

    /// Asks programs without a shim to stop. Waits until all programs have ended or their time is over.
    fn stop(&self) {
        let (began, pause) = (now(), Wakeup::default());
        for one in &self.records {
            let is_alone = !one.record.shim.is_some_and(processes::is_running);
            if let Some(program) = one.record.program.filter(|program| is_alone && one.may_be(program.pid)) {
                processes::signal(program, Signal::TERM);
                // A stopped process reacts to the first signal only after the second one.
                processes::signal(program, Signal::CONT);
            }
        }
        while self.records.iter().any(|one| is_stopping(&one.record, began)) {
            pause.wait(Some(now() + LOOK_EVERY));
        }
    }

    /// Kills all processes that are found, until none is found. Looks at least once. Returns the processes that are left after `within`.
    fn kill(&self, within: Duration) -> Vec<i32> {
        let (until, pause) = (now() + within, Wakeup::default());
        loop {
            let found = self.freeze();
            if found.is_empty() {
                return Vec::new();
            }
            self.group.iter().for_each(|group| cgroup::kill(group));
            for process in &found {
                processes::signal(*process, Signal::KILL);
            }
            if now() >= until {
                return found.into_iter().map(|process| process.pid).collect();
            }
            self.reap();
            pause.wait(Some(now() + LOOK_EVERY));
            self.reap();
        }
    }

    /// Stops all processes that are found, so that none forks while others are killed. Returns these processes.
    fn freeze(&self) -> BTreeSet<Process> {
        let mut stopped = BTreeSet::new();
        for _ in 0..STOP_ROUNDS_MAX {
            let fresh: Vec<Process> = self.find().difference(&stopped).copied().collect();
            if fresh.is_empty() {
                break;
            }
            for process in fresh {
                processes::signal(process, Signal::STOP);
                stopped.insert(process);
            }
        }
        stopped
    }

    /// Returns all running processes that belong to the search.
    fn find(&self) -> BTreeSet<Process> {
        let this = getpid().as_raw_nonzero().get();
        let all: Vec<Stat> = processes::all().into_iter().filter(|stat| !stat.is_zombie).collect();
        let in_group: BTreeSet<i32> = self.group.iter().flat_map(|group| cgroup::members(group)).collect();
        let roots =
            |members: &BTreeSet<i32>| members.iter().copied().filter(|pid| *pid == this || is_shim(*pid)).collect();
        let strays = cgroup::own().filter(|_| self.adopts).map(|own| strays(&own, roots)).unwrap_or_default();
        let is_found = |stat: &&Stat| {
            in_group.contains(&stat.process.pid)
                || strays.contains(&stat.process)
                || self.records.iter().any(|one| is_of(&one.record, stat, &all) && one.may_be(stat.process.pid))
                || (self.adopts && stat.parent == this && !is_shim(stat.process.pid))
                || self.is_marked(stat.process.pid)
        };
        let mut found: BTreeSet<Process> =
            all.iter().filter(|stat| stat.process.pid != this).filter(is_found).map(|stat| stat.process).collect();
        found.extend(processes::descendants(&all, found.iter().map(|process| process.pid).collect::<Vec<_>>()));
        // If such a program has started this node, the node must not kill itself.
        found.retain(|process| process.pid != this);
        found
    }

    fn is_marked(&self, pid: i32) -> bool {
        let environment = processes::environment(pid);
        let mut named = environment.iter().filter_map(|entry| entry.strip_prefix(b"DCA_DIR="));
        named.any(|dir| Path::new(OsStr::from_bytes(dir)).ancestors().any(|dir| self.folders.contains(dir)))
    }

    /// Collects adopted processes that have ended. The kernel keeps them until then.
    fn reap(&self) {
        if !self.adopts {
            return;
        }
        let this = getpid().as_raw_nonzero().get();
        let ended = processes::all().into_iter().filter(|stat| stat.is_zombie && stat.parent == this);
        for pid in ended.map(|stat| stat.process.pid).filter(|pid| !is_shim(*pid)) {
            // The exit status of the process is not needed.
            waitpid(Pid::from_raw(pid), WaitOptions::NOHANG).map(|_ended| ()).unwrap_or_default();
        }
    }
}

/// Returns whether a program still has time to stop. Its shim may stop it, or the program itself.
fn is_stopping(record: &ProcessRecord, began: Time) -> bool {
    let since = now() - began;
    let runs = |process: Option<Process>| process.is_some_and(processes::is_running);
    runs(record.shim) && since < record.grace + SHIM_MARGIN || runs(record.program) && since < record.grace
}

/// Returns whether a process is the shim or the program of a record, or belongs to the session of the shim. The kernel
/// does not reuse the number of a session while it exists. So a session without its leader is the session of the shim.
fn is_of(record: &ProcessRecord, stat: &Stat, all: &[Stat]) -> bool {
    let is_named = record.shim == Some(stat.process) || record.program == Some(stat.process);
    let is_of_session = |shim: &Process| stat.session == shim.pid && stat.process.started >= shim.started;
    let has_session = record.shim.filter(is_of_session).is_some_and(|shim| {
        let leader = all.iter().find(|other| other.process.pid == shim.pid);
        leader.is_none_or(|leader| leader.process == shim)
    });
    is_named || has_session
}

/// Returns whether a child of this process is a shim, or is becoming one: until then it runs this executable.
fn is_shim(pid: i32) -> bool {
    let executable = |pid: &str| std::fs::read_link(format!("/proc/{pid}/exe")).ok();
    comm(pid).as_deref() == Some(SHIM) || executable(&pid.to_string()) == executable("self")
}

/// Returns the name of a process in the kernel's list of processes.
fn comm(pid: i32) -> Option<String> {
    std::fs::read_to_string(format!("/proc/{pid}/comm")).ok().map(|name| name.trim_end().to_owned())
}

fn read_record(dir: &Path) -> Option<Recorded> {
    let bytes = file::bytes_itself(&dir.join(RECORD_FILE), RECORD_MAX).ok()?;
    let own = getuid().as_raw();
    // If a program runs as another user, it has a folder of its own, because it may not enter this one.
    let other = dir.ancestors().nth(2).and_then(|node| run_dir::user_of(node, dir));
    let users = [own, other.map_or(own, |(user, _)| user)];
    Some(Recorded { record: ProcessRecord::parse(&String::from_utf8_lossy(&bytes)), users })
}

impl Recorded {
    /// Returns whether a process has a user that the recorded program may have.
    fn may_be(&self, pid: i32) -> bool {
        processes::user(pid).is_some_and(|user| self.users.contains(&user))
    }
}

fn folders(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir())).map(|entry| entry.path())
}
