//! Core dumps: whether the kernel writes the memory of this process to the disk when it crashes. A node and a command hold keys
//! and secrets, so they set the soft limit of core dumps to 0. Programs that they start get the original limit back.

use super::soft_limit;
use rustix::process::{Resource, getrlimit};
use std::sync::OnceLock;

/// The value of a limit that is not set, as the kernel represents it.
const UNLIMITED: u64 = u64::MAX;

/// The soft limit that this process was started with.
static BEFORE: OnceLock<u64> = OnceLock::new();

/// Prevents core dumps of this process: sets the soft limit to 0.
pub fn forbid() {
    BEFORE.get_or_init(|| getrlimit(Resource::Core).current.unwrap_or(UNLIMITED));
    set(0);
}

/// Returns the soft limit that this process was started with, in bytes, if it was changed.
pub fn before() -> Option<u64> {
    BEFORE.get().copied()
}

/// Sets the soft limit of this process, for the programs that it starts.
pub fn set(bytes: u64) {
    soft_limit::set(Resource::Core, Some(bytes).filter(|bytes| *bytes != UNLIMITED));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::process::Rlimit;

    #[test]
    fn this_process_writes_no_core_and_remembers_its_limit() {
        let at_first = getrlimit(Resource::Core);
        forbid();
        assert_eq!(getrlimit(Resource::Core), Rlimit { current: Some(0), ..at_first });
        assert_eq!(before(), Some(at_first.current.unwrap_or(UNLIMITED)));
        set(at_first.current.unwrap_or(UNLIMITED));
        assert_eq!(getrlimit(Resource::Core), at_first);
    }
}
