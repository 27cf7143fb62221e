//! The stack of the main thread of a program.

use rustix::process::{Resource, getrlimit};
use std::io;
use std::panic::resume_unwind;

/// How large it is, in bytes: what Linux gives, unless somebody limits it.
const STACK: usize = 8 << 20;

/// Does all the work of a program, on a thread of its own where the stack of the calling one may not become as large as usual: that is
/// what the caller of the process lets it be (`ulimit -s`), and a process that comes to its end is killed without a word. Programs that
/// it starts have the limit of the caller.
///
/// # Errors
/// The system gives no thread.
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
