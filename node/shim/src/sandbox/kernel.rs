//! The rights that Landlock and seccomp take from a program, where the kernel has them. Without them the rest of the
//! sandbox still holds.

use landlock::{ABI, AccessFs, CompatLevel, Compatible, Ruleset, RulesetAttr, RulesetCreatedAttr, path_beneath_rules};
use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The program may not write, make or remove anything there. The same applies to the folders of
/// control groups, because a process that can move itself to another group has no limits, and to the files that
/// configure the kernel, because some of them name a program that the kernel starts as root. Each
/// other folder of the root stays unchanged.
const OF_THE_SYSTEM: [&str; 14] = [
    "bin",
    "boot",
    "etc",
    "lib",
    "lib32",
    "lib64",
    "libx32",
    "proc",
    "sbin",
    "sys/firmware",
    "sys/kernel",
    "sys/module",
    "sys/power",
    "usr",
];
/// The handled rights: to write, make, remove, move and cut files. Source: landlock(7), ABI 3, Linux 6.2; earlier
/// kernels handle a part of them.
const WRITES: ABI = ABI::V3;
/// EPERM of the calls that are refused. Source: errno(3), Linux.
const EPERM: u32 = 1;
/// ENOSYS of a call that a library replaces by an older one, as on an older kernel. Source: errno(3), Linux.
const ENOSYS: u32 = 38;
/// The flags with which `clone` makes a process in a new namespace. Source: clone(2).
const NEW_NAMESPACE: [libc::c_int; 7] = [
    libc::CLONE_NEWCGROUP,
    libc::CLONE_NEWIPC,
    libc::CLONE_NEWNET,
    libc::CLONE_NEWNS,
    libc::CLONE_NEWPID,
    libc::CLONE_NEWUSER,
    libc::CLONE_NEWUTS,
];
/// The bit in the number of a call of the x32 form, which a kernel for x86 may have in addition to its own. Source:
/// syscall(2).
const X32: libc::c_long = 0x4000_0000;
/// The numbers that only x32 has for refused calls: `ptrace`, `kexec_load`, `process_vm_readv`, `process_vm_writev`.
/// Source: syscall_64.tbl, Linux.
const OF_X32: [libc::c_long; 4] = [521, 528, 539, 540];

/// Refused calls: those that change the kernel, the mounts, the clock or the namespaces, look into other processes, or
/// have often been used to attack the kernel. Source: systemd.exec(5), groups
/// `@clock @module @mount @obsolete @raw-io @reboot @swap` and others.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
const REFUSED: [libc::c_long; 42] = [
    libc::SYS_acct,
    libc::SYS_add_key,
    libc::SYS_bpf,
    libc::SYS_clock_settime,
    libc::SYS_delete_module,
    libc::SYS_finit_module,
    libc::SYS_fsconfig,
    libc::SYS_fsmount,
    libc::SYS_fsopen,
    libc::SYS_fspick,
    libc::SYS_init_module,
    // A ring makes calls that no filter sees.
    libc::SYS_io_uring_enter,
    libc::SYS_io_uring_register,
    libc::SYS_io_uring_setup,
    libc::SYS_kcmp,
    libc::SYS_kexec_file_load,
    libc::SYS_kexec_load,
    libc::SYS_keyctl,
    libc::SYS_mount,
    libc::SYS_mount_setattr,
    libc::SYS_move_mount,
    libc::SYS_open_by_handle_at,
    libc::SYS_open_tree,
    libc::SYS_perf_event_open,
    libc::SYS_pidfd_getfd,
    libc::SYS_pivot_root,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_ptrace,
    libc::SYS_quotactl,
    libc::SYS_quotactl_fd,
    libc::SYS_reboot,
    libc::SYS_request_key,
    libc::SYS_setdomainname,
    libc::SYS_sethostname,
    libc::SYS_setns,
    libc::SYS_settimeofday,
    libc::SYS_swapoff,
    libc::SYS_swapon,
    libc::SYS_umount2,
    libc::SYS_unshare,
    libc::SYS_userfaultfd,
];
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
const REFUSED: [libc::c_long; 0] = [];

/// Confines this process, which has one thread, as far as the kernel supports it. It may always write in its `own`
/// folders.
///
/// # Errors
/// The kernel supports a level, and refuses it.
pub(super) fn confine(own: [&Path; 2]) -> Result<(), String> {
    if has_landlock() {
        write_nowhere_but(&places(own)).map_err(|error| format!("a sandbox with Landlock is refused: {error}"))?;
    }
    if has_seccomp() {
        for program in filters().map_err(|error| format!("a sandbox with seccomp cannot be made: {error}"))? {
            seccompiler::apply_filter(&program)
                .map_err(|error| format!("a sandbox with seccomp is refused: {error}"))?;
        }
    }
    Ok(())
}

/// Returns the supported levels of the sandbox, a word each.
pub(crate) fn levels() -> Vec<&'static str> {
    let found = [(has_landlock(), "landlock"), (has_seccomp(), "seccomp")];
    found.into_iter().filter_map(|(is_there, word)| is_there.then_some(word)).collect()
}

fn has_landlock() -> bool {
    let required = Ruleset::default().set_compatibility(CompatLevel::HardRequirement);
    required.handle_access(AccessFs::from_write(ABI::V1)).and_then(Ruleset::create).is_ok()
}

fn has_seccomp() -> bool {
    let actions = std::fs::read_to_string("/proc/sys/kernel/seccomp/actions_avail").unwrap_or_default();
    !REFUSED.is_empty() && actions.split_whitespace().any(|action| action == "errno")
}

/// Returns the folders in which a program may write: the whole root, except the folders of the system and of control
/// groups.
fn places(own: [&Path; 2]) -> Vec<PathBuf> {
    let root = Path::new("/");
    let mut closed: Vec<PathBuf> = OF_THE_SYSTEM.iter().map(|name| root.join(name)).collect();
    closed.extend(control_groups(&std::fs::read_to_string("/proc/self/mounts").unwrap_or_default()));
    let mut places = own.map(Path::to_owned).to_vec();
    open(root, &closed, &mut places);
    places
}

/// Adds a folder, or its entries if one of them is closed.
fn open(folder: &Path, closed: &[PathBuf], places: &mut Vec<PathBuf>) {
    if closed.iter().any(|closed| closed == folder) {
        return;
    }
    if !closed.iter().any(|closed| closed.starts_with(folder)) {
        return places.push(folder.to_owned());
    }
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        // A link leads to a place, and is not a place itself.
        if entry.file_type().is_ok_and(|kind| !kind.is_symlink()) {
            open(&entry.path(), closed, places);
        }
    }
}

/// Returns where control groups are mounted. Source: proc_pid_mounts(5).
fn control_groups(mounts: &str) -> Vec<PathBuf> {
    let fields = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
    let groups = fields.filter(|fields| matches!(fields.get(2), Some(&("cgroup" | "cgroup2"))));
    groups.filter_map(|fields| fields.get(1).map(PathBuf::from)).collect()
}

fn write_nowhere_but(places: &[PathBuf]) -> Result<(), landlock::RulesetError> {
    let writes = AccessFs::from_write(WRITES);
    let rules = Ruleset::default().set_compatibility(CompatLevel::BestEffort).handle_access(writes)?.create()?;
    rules.add_rules(path_beneath_rules(places, writes))?.restrict_self().map(drop)
}

/// Returns the filters: one for calls that are refused, and one for calls that seem not to exist.
fn filters() -> Result<[BpfProgram; 2], seccompiler::BackendError> {
    let always = REFUSED.into_iter().map(|call| (call, Vec::new()));
    let namespaces = || NEW_NAMESPACE.into_iter().map(makes_namespace).collect::<Result<Vec<_>, _>>();
    let mut refused: BTreeMap<i64, Vec<SeccompRule>> = always.chain([(libc::SYS_clone, namespaces()?)]).collect();
    // A filter sees the flags of `clone`. The flags of `clone3` are in memory. Without `clone3` libraries use `clone`.
    let mut missing = BTreeMap::from([(libc::SYS_clone3, Vec::new())]);
    if cfg!(target_arch = "x86_64") {
        for rules in [&mut refused, &mut missing] {
            rules.extend(rules.clone().into_iter().map(|(call, of_call)| (call | X32, of_call)));
        }
        refused.extend(OF_X32.into_iter().map(|call| (call | X32, Vec::new())));
    }
    let arch = std::env::consts::ARCH.try_into()?;
    let filter = |rules, error| -> Result<BpfProgram, seccompiler::BackendError> {
        SeccompFilter::new(rules, SeccompAction::Allow, SeccompAction::Errno(error), arch)?.try_into()
    };
    Ok([filter(refused, EPERM)?, filter(missing, ENOSYS)?])
}

/// Returns the rule that meets a `clone` with this flag.
fn makes_namespace(flag: libc::c_int) -> Result<SeccompRule, seccompiler::BackendError> {
    let flag = u64::from(flag.cast_unsigned());
    let has_flag = SeccompCmpOp::MaskedEq(flag);
    SeccompRule::new(vec![SeccompCondition::new(0, SeccompCmpArgLen::Qword, has_flag, flag)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Error;

    /// Makes a call without an argument in memory, and returns its error; a process that it creates ends at once.
    #[expect(unsafe_code, reason = "the library has no function for a call by its number")]
    fn error_of(call: libc::c_long, first: libc::c_int) -> Option<i32> {
        // SAFETY: the arguments are numbers. A child has a copy of the memory, and calls nothing but `_exit`.
        let made = unsafe { libc::syscall(call, libc::c_long::from(first), 0, 0, 0, 0) };
        if made == 0 && matches!(call, libc::SYS_clone | libc::SYS_clone3) {
            // SAFETY: as above.
            unsafe { libc::_exit(0) };
        }
        if made < 0 { Error::last_os_error().raw_os_error() } else { None }
    }

    /// This runs in a separate thread: a filter holds for the thread that takes it.
    #[test]
    fn no_namespace_is_made_and_processes_and_threads_are() {
        if !has_seccomp() {
            println!("skipped: this kernel has no seccomp");
            return;
        }
        let confined = || {
            rustix::thread::set_no_new_privs(true).unwrap();
            filters().unwrap().iter().for_each(|program| seccompiler::apply_filter(program).unwrap());
            for flag in NEW_NAMESPACE {
                assert_eq!(error_of(libc::SYS_clone, flag | libc::SIGCHLD), Some(libc::EPERM), "{flag:x}");
                assert_eq!(error_of(libc::SYS_unshare, flag), Some(libc::EPERM), "{flag:x}");
            }
            assert_eq!(error_of(libc::SYS_clone3, 0), Some(libc::ENOSYS));
            for call in [libc::SYS_setns, libc::SYS_io_uring_setup, libc::SYS_pidfd_getfd, libc::SYS_ptrace] {
                assert_eq!(error_of(call, 0), Some(libc::EPERM), "{call}");
            }
            if cfg!(target_arch = "x86_64") {
                let refused = [libc::SYS_unshare | X32, libc::SYS_setns | X32, OF_X32[0] | X32];
                assert!(refused.iter().all(|call| error_of(*call, 0) == Some(libc::EPERM)));
                assert_eq!(error_of(libc::SYS_clone | X32, libc::CLONE_NEWUSER), Some(libc::EPERM));
            }
            assert_eq!(std::thread::spawn(|| 7).join().unwrap(), 7);
            assert!(std::process::Command::new("true").status().unwrap().success());
        };
        std::thread::spawn(confined).join().unwrap();
    }

    #[test]
    fn what_is_closed_is_left_out_and_all_beside_it_is_open() {
        let mounts = "sysfs /sys sysfs rw 0 0\ncgroup2 /sys/fs/cgroup/unified cgroup2 rw 0 0\ncgroup /sys/fs/cgroup/pids cgroup rw,pids 0 0\n";
        assert_eq!(control_groups(mounts), ["/sys/fs/cgroup/unified", "/sys/fs/cgroup/pids"].map(PathBuf::from));
        let root = std::env::temp_dir().join(format!("dca-places-{}", std::process::id()));
        for folder in ["etc/a", "sys/class", "sys/fs/cgroup/pids/b", "sys/fs/cgroup/empty", "home/c"] {
            std::fs::create_dir_all(root.join(folder)).unwrap();
        }
        std::os::unix::fs::symlink(root.join("etc"), root.join("link")).unwrap();
        let mut places = Vec::new();
        open(&root, &[root.join("etc"), root.join("sys/fs/cgroup/pids")], &mut places);
        places.sort();
        assert_eq!(places, ["home", "sys/class", "sys/fs/cgroup/empty"].map(|open| root.join(open)));
        std::fs::remove_dir_all(root).unwrap();
    }
}
