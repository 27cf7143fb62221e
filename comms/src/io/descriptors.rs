//! How many files and sockets this process may have open.
//!
//! The soft limit of most systems is 1024, kept low for programs that use select(2). A process of DCA uses no such thing and
//! has as many connections as somebody makes, so it takes what the hard limit allows. Programs that it starts get back what
//! it had.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::sync::OnceLock;

/// The soft limit that this process was started with.
static BEFORE: OnceLock<Option<u64>> = OnceLock::new();

/// Raises the soft limit of this process to the hard one.
pub fn raise() {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    BEFORE.get_or_init(|| current);
    set(maximum);
}

/// Returns the soft limit that this process was started with, if that is known and is a limit.
pub fn before() -> Option<u64> {
    BEFORE.get().copied().flatten()
}

/// Sets the soft limit of this process, for what it starts.
pub fn set(current: Option<u64>) {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    if let Err(error) = setrlimit(Resource::Nofile, Rlimit { current, maximum }) {
        tracing::debug!(%error, "the limit of descriptors stays as it is");
    }
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
