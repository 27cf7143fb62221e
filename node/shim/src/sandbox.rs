//! The rights of a program: it runs under a separate user, has no capability, and gets none from programs it executes.
//! Where the kernel supports them, Landlock keeps it from writing into the folders of the system, and seccomp refuses
//! calls that only an administrator needs. [`levels`] lists the supported ones.

mod kernel;

pub(crate) use kernel::levels;

use comms::logic::human::cause;
use rustix::io::Errno;
use rustix::process::{Gid, Uid};
use rustix::thread::{
    CapabilitySet, CapabilitySets, clear_ambient_capability_set, remove_capability_from_bounding_set, set_capabilities,
    set_no_new_privs, set_thread_groups, set_thread_res_gid, set_thread_res_uid,
};
use shim::protocol::{Account, Sandbox, SandboxLevel};
use std::path::Path;

/// Gives up the rights that the sandbox takes. In its `own` folders a program may always write. The process has one
/// thread, whose rights pass to the program it becomes.
///
/// # Errors
/// The kernel refuses a step, in a sentence.
pub(crate) fn enter(sandbox: &Sandbox, own: [&Path; 2]) -> Result<(), String> {
    let is_standard = sandbox.level == SandboxLevel::Standard;
    let refused = |what: &str, error: Errno| format!("{what} is refused: {}", cause(&error.into()));
    if is_standard {
        empty_bounding_set().map_err(|error| refused("a sandbox without capabilities", error))?;
    }
    if let Some(Account { uid, gid, groups }) = &sandbox.user {
        let (uid, gid) = (Uid::from_raw(*uid), Gid::from_raw(*gid));
        let groups: Vec<Gid> = groups.iter().map(|group| Gid::from_raw(*group)).collect();
        let become_user = || {
            set_thread_groups(&groups)?;
            set_thread_res_gid(gid, gid, gid)?;
            set_thread_res_uid(uid, uid, uid)
        };
        let failed = |error| refused(&format!("to run as user {}", uid.as_raw()), error);
        become_user().map_err(failed)?;
    }
    if is_standard {
        let nothing = CapabilitySet::empty();
        let give_up = || {
            clear_ambient_capability_set()?;
            set_capabilities(None, CapabilitySets { effective: nothing, permitted: nothing, inheritable: nothing })?;
            set_no_new_privs(true)
        };
        give_up().map_err(|error| refused("a sandbox without capabilities", error))?;
        kernel::confine(own)?;
    }
    Ok(())
}

/// Drops every capability from the bounding set, root included. A process that may not drop them has none to pass on,
/// and `no_new_privs` keeps it from getting any.
fn empty_bounding_set() -> Result<(), Errno> {
    for number in 0..u64::BITS {
        match remove_capability_from_bounding_set(CapabilitySet::from_bits_retain(1 << number)) {
            Ok(()) => {}
            // The kernel knows no capability of this number or of a higher one.
            Err(Errno::INVAL) => return Ok(()),
            Err(Errno::PERM) if !rustix::process::geteuid().is_root() => return Ok(()),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
