//! The stack of the main thread of a program.

use rustix::process::{Resource, getrlimit};
use std::io;
use std::panic::resume_unwind;

/// The size of the stack, in bytes: the default of Linux.
const STACK: usize = 8 << 20;

/// Runs all work of a program on a separate thread if the stack of the calling thread is smaller than usual. The
/// parent process sets that limit (`ulimit -s`), and a process that exceeds it is killed without a message. Programs
/// that this process starts still get the parent's limit.
///
/// # Errors
/// If the system cannot start a thread.
pub fn on_own_stack<T: Send>(work: impl FnOnce() -> T + Send) -> io::Result<T> {
    let limit = getrlimit(Resource::Stack).current;
    if limit.is_none_or(|limit| limit >= STACK as u64) {
        return Ok(work());
    }
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("main".to_owned()).stack_size(STACK).spawn_scoped(scope, work)?;
        Ok(thread.join().unwrap_or_else(|panic| resume_unwind(panic)))
    })
}
