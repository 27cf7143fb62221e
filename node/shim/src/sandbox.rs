//! The rights of a program: it runs as a user of its own, has no capability, and gets none from what it executes. What the kernel offers
//! beyond that is taken, too: with Landlock it writes nothing into the folders of the system, and with seccomp it makes no call that
//! only who runs the machine needs. [`levels`] says what that is here.

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

/// Gives up the rights that the sandbox takes. In its `own` folders a program writes wherever they are. The process has one thread, whose rights are those of what it becomes.
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

/// Takes every capability from what this process executes, root included. Who may not take them has none to give on, and is kept from
/// getting any by `no_new_privs`.
fn empty_bounding_set() -> Result<(), Errno> {
    for number in 0..u64::BITS {
        match remove_capability_from_bounding_set(CapabilitySet::from_bits_retain(1 << number)) {
            Ok(()) => {}
            // The kernel knows none of this number, nor of a higher one.
            Err(Errno::INVAL) => return Ok(()),
            Err(Errno::PERM) if !rustix::process::geteuid().is_root() => return Ok(()),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
