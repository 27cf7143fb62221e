//! Checks that this process was given a standard output that can be written.
//!
//! Before `main`, the runtime of Rust opens `/dev/null` in the place of a standard stream that is closed; and of one that is open
//! for reading alone it takes each write for done. So a result would be lost, and nobody would know. Once the runtime has begun, nothing
//! tells its `/dev/null` from one that the caller has given: Python's `subprocess.DEVNULL` has the same flags. So this is
//! looked at before: the loader calls what `.init_array` lists ahead of the runtime. Source: System V ABI, "Initialization and
//! Termination Functions"; `std::sys::pal::unix::init`.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether standard output cannot be written.
static IS_LOST: AtomicBool = AtomicBool::new(false);

#[used]
#[expect(unsafe_code, reason = "nothing else is called before the runtime of Rust begins")]
// SAFETY: the section holds addresses of functions of the C ABI, which are called once, in the only thread; this one needs nothing of
// the runtime.
#[unsafe(link_section = ".init_array")]
static LOOK: extern "C" fn() = look;

#[expect(unsafe_code, reason = "the number may be that of no open descriptor, so it cannot be borrowed")]
extern "C" fn look() {
    // SAFETY: it takes two numbers and touches no memory; for a descriptor that is not open it returns -1.
    let flags = unsafe { libc::fcntl(libc::STDOUT_FILENO, libc::F_GETFL) };
    let is_lost = flags == -1 || flags & libc::O_ACCMODE == libc::O_RDONLY;
    IS_LOST.store(is_lost, Ordering::Relaxed);
}

/// Checks that standard output was open for writing when this process began.
///
/// # Errors
/// It was not.
pub(super) fn check() -> io::Result<()> {
    if IS_LOST.load(Ordering::Relaxed) {
        return Err(io::Error::other("it is closed, or open for reading alone"));
    }
    Ok(())
}
