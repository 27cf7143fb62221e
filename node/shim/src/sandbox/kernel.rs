//! What Landlock and seccomp take from a program, where the kernel has them: without them the rest of the sandbox holds all the same.

use landlock::{ABI, AccessFs, CompatLevel, Compatible, Ruleset, RulesetAttr, RulesetCreatedAttr, path_beneath_rules};
use seccompiler::{BpfProgram, SeccompAction, SeccompFilter};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Nothing is written there, made or removed. Each other folder of the root is left as it is.
const OF_THE_SYSTEM: [&str; 9] = ["bin", "boot", "etc", "lib", "lib32", "lib64", "libx32", "sbin", "usr"];
/// What is handled: to write, to make, to remove, to move and to cut files. Source: landlock(7), ABI 3, Linux 6.2; earlier
/// kernels handle a part of it.
const WRITES: ABI = ABI::V3;
/// EPERM of the calls that are refused. Source: errno(3), Linux.
const EPERM: u32 = 1;

/// Calls that are refused: those that change the kernel, the mounts, the clock or the namespaces, look into other processes, or have been the way
/// into the kernel before. Source: systemd.exec(5), groups `@clock @module @mount @obsolete @raw-io @reboot @swap` and others.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
const REFUSED: [libc::c_long; 36] = [
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
    libc::SYS_kexec_file_load,
    libc::SYS_kexec_load,
    libc::SYS_keyctl,
    libc::SYS_mount,
    libc::SYS_mount_setattr,
    libc::SYS_move_mount,
    libc::SYS_open_by_handle_at,
    libc::SYS_open_tree,
    libc::SYS_perf_event_open,
    libc::SYS_pivot_root,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_ptrace,
    libc::SYS_quotactl,
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

/// Takes from this process, which has one thread, what the kernel lets it. In its `own` folders it writes wherever they are.
///
/// # Errors
/// The kernel has it, and refuses.
pub(super) fn confine(own: [&Path; 2]) -> Result<(), String> {
    if has_landlock() {
        write_nowhere_but(&places(own)).map_err(|error| format!("a sandbox with Landlock is refused: {error}"))?;
    }
    if has_seccomp() {
        let program = filter().map_err(|error| format!("a sandbox with seccomp cannot be made: {error}"))?;
        seccompiler::apply_filter(&program).map_err(|error| format!("a sandbox with seccomp is refused: {error}"))?;
    }
    Ok(())
}

/// Returns what of it this kernel has, a word each.
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

/// Returns all folders and files of the root, but for those of the system.
fn places(own: [&Path; 2]) -> Vec<PathBuf> {
    let root = std::fs::read_dir("/").into_iter().flatten().flatten();
    let of_system = |name: &std::ffi::OsStr| OF_THE_SYSTEM.iter().any(|system| name == *system);
    let others = root.filter(|entry| !of_system(&entry.file_name())).map(|entry| entry.path());
    others.chain(own.map(Path::to_owned)).collect()
}

fn write_nowhere_but(places: &[PathBuf]) -> Result<(), landlock::RulesetError> {
    let writes = AccessFs::from_write(WRITES);
    let rules = Ruleset::default().set_compatibility(CompatLevel::BestEffort).handle_access(writes)?.create()?;
    rules.add_rules(path_beneath_rules(places, writes))?.restrict_self().map(drop)
}

fn filter() -> Result<BpfProgram, seccompiler::BackendError> {
    let rules: BTreeMap<i64, Vec<_>> = REFUSED.into_iter().map(|call| (call, Vec::new())).collect();
    let arch = std::env::consts::ARCH.try_into()?;
    SeccompFilter::new(rules, SeccompAction::Allow, SeccompAction::Errno(EPERM), arch)?.try_into()
}
