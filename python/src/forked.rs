//! Children that a program makes with `os.fork`.
//!
//! A child has none of the threads of its parent, but its sockets. If it went on with the control loop, the node would take its
//! messages for those of its parent.

use pyo3::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// The process that runs a control loop; 0 if none does, as in tests.
static PROGRAM: AtomicU32 = AtomicU32::new(0);

/// Remembers this process as the one that runs the control loop.
pub(crate) fn remember() {
    PROGRAM.store(std::process::id(), Ordering::Relaxed);
}

/// Calls Python. Ends this process if it is a child that the call has made, and that has come back from it.
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
    // The loss of standard error cannot be reported anywhere.
    drop(tell(py, told));
    let ended = py.import("os").and_then(|os| os.call_method1("_exit", (1,)));
    if ended.is_err() {
        std::process::abort();
    }
}
