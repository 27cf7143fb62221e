//! Soft limits of this process. A process may change them up to the hard limits.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Sets the soft limit of a resource; `None` sets no limit.
pub(super) fn set(resource: Resource, current: Option<u64>) {
    let Rlimit { maximum, .. } = getrlimit(resource);
    if let Err(error) = setrlimit(resource, Rlimit { current, maximum }) {
        tracing::debug!(?resource, %error, "a soft limit is not changed");
    }
}
