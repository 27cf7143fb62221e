//! Soft limits of this process, which it may change up to the hard ones.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Sets the soft limit of a resource; none is without a limit.
pub(super) fn set(resource: Resource, current: Option<u64>) {
    let Rlimit { maximum, .. } = getrlimit(resource);
    if let Err(error) = setrlimit(resource, Rlimit { current, maximum }) {
        tracing::debug!(?resource, %error, "a soft limit is not changed");
    }
}
