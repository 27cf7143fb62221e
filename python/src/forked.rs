//! Child processes that a program makes with `os.fork`.
//!
//! A child has its parent's sockets, but none of its threads. If it continued the control loop, the node would take the child's
//! messages for messages of the parent.

use pyo3::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// The id of the process that runs a control loop; 0 if there is none, as in tests.
static PROGRAM: AtomicU32 = AtomicU32::new(0);

/// Notes that this process runs the control loop.
pub(crate) fn remember() {
    PROGRAM.store(std::process::id(), Ordering::Relaxed);
}

/// Calls Python. If the call has forked, and the child returns from it, the child process ends here.
pub(crate) fn call<T>(call: impl FnOnce(Python<'_>) -> T) -> T {
    Python::attach(|py| {
        let result = call(py);
        let program = PROGRAM.load(Ordering::Relaxed);
        if program != 0 && program != std::process::id() {
            end(py);
        }
        result
    })
}

fn tell(py: Python<'_>, told: &str) -> PyResult<()> {
    let errors = py.import("sys")?.getattr("stderr")?;
    errors.call_method1("write", (told,))?;
    errors.call_method0("flush").map(drop)
}

fn end(py: Python<'_>) {
    let told = "a child of os.fork() has come back to the control loop, and is ended: it ends itself with os._exit()\n";
    // If standard error is lost, this cannot be reported anywhere.
    drop(tell(py, told));
    let ended = py.import("os").and_then(|os| os.call_method1("_exit", (1,)));
    if ended.is_err() {
        std::process::abort();
    }
}
