//! The limit of open files and sockets of this process, and the descriptors that it has inherited.
//!
//! The soft limit of most systems is 1024, kept low for programs that use select(2). A process of DCA does not use
//! select and may have many connections, so it raises its limit to the hard limit. Programs that it starts get the
//! original limit back.

use super::soft_limit;
use rustix::process::{Resource, Rlimit, getrlimit};
use std::sync::OnceLock;

/// The soft limit that this process was started with.
static BEFORE: OnceLock<Option<u64>> = OnceLock::new();

/// Raises the soft limit of this process to the hard one.
pub fn raise() {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    BEFORE.get_or_init(|| current);
    set(maximum);
}

/// Returns the soft limit that this process was started with; none if it is unknown or was not set.
pub fn before() -> Option<u64> {
    BEFORE.get().copied().flatten()
}

/// Sets the soft limit of this process, for the programs it starts.
pub fn set(current: Option<u64>) {
    soft_limit::set(Resource::Nofile, current);
}

/// Closes all inherited descriptors except standard input, output and error. They were not meant for this process, and an
/// inherited pipe of a shell would stay open as long as the process runs. `main` calls this first, before it opens anything.
pub fn close_inherited() {
    let closed = close_from_third();
    if closed == 0 {
        return;
    }
    // The call is missing in Linux before 5.9, or forbidden by a filter of system calls.
    let Ok(open) = std::fs::read_dir("/proc/self/fd") else { return };
    let numbers: Vec<i32> = open.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect();
    numbers.into_iter().filter(|number| *number > libc::STDERR_FILENO).for_each(close);
}

#[expect(unsafe_code, reason = "what was inherited has no owner in this process, and can only be named by its number")]
fn close_from_third() -> libc::c_long {
    // SAFETY: no memory is passed. The caller runs before anything of this process has opened a descriptor, so none has an owner.
    unsafe { libc::syscall(libc::SYS_close_range, 3, libc::c_uint::MAX, 0) }
}

#[expect(unsafe_code, reason = "as above")]
fn close(number: libc::c_int) {
    // SAFETY: as above. A number whose descriptor is already closed, such as the descriptor of the folder that was read, has no effect.
    unsafe { libc::close(number) };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soft_limit_becomes_the_hard_one() {
        let at_first = getrlimit(Resource::Nofile);
        set(Some(300));
        assert_eq!(getrlimit(Resource::Nofile).current, Some(300));
        raise();
        assert_eq!(
            (getrlimit(Resource::Nofile), before()),
            (Rlimit { current: at_first.maximum, ..at_first }, Some(300))
        );
    }
}
