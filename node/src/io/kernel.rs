//! The system calls that a node needs to end programs. Without them, it could only start programs.

use rustix::process::{PidfdFlags, Signal, getpid, pidfd_open, pidfd_send_signal};

/// Checks that the kernel, and the filters around this process, let a node end its programs.
///
/// # Errors
/// Names the call that is refused, and the earliest kernel version that has it.
pub fn check() -> Result<(), String> {
    let lacks = |call: &str, error: rustix::io::Errno| {
        format!(
            "a node needs the call `{call}` to end programs, and the kernel refuses it ({error}): use Linux 5.3 or later, and in a \
             container a runtime whose seccomp filter allows this call (Docker 20.10)"
        )
    };
    let this = pidfd_open(getpid(), PidfdFlags::empty()).map_err(|error| lacks("pidfd_open", error))?;
    // This signal does nothing by default.
    pidfd_send_signal(&this, Signal::URG).map_err(|error| lacks("pidfd_send_signal", error))
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_kernel_that_runs_this_test_is_enough() {
        assert_eq!(super::check(), Ok(()));
    }
}
