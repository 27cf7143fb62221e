//! Exceptions: the last line of one is the reason of an abort, and its traceback is in the program's log.

use pyo3::exceptions::PyBaseException;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Returns the last line of an exception, and writes its traceback on standard error, which the node keeps.
pub(crate) fn told(py: Python<'_>, error: PyErr) -> String {
    let plain = error.to_string();
    let told: PyResult<String> = (|| {
        let (value, traceback) = (error.value(py), py.import("traceback")?);
        let arguments = (error.get_type(py), value, error.traceback(py));
        let lines: Vec<String> = traceback.call_method1("format_exception", arguments)?.extract()?;
        let stderr = py.import("sys")?.getattr("stderr")?;
        if !stderr.is_none() {
            stderr.call_method1("write", (lines.concat(),))?;
            stderr.call_method0("flush")?;
        }
        let last: Vec<String> =
            traceback.call_method1("format_exception_only", PyTuple::new(py, [value])?)?.extract()?;
        let own = last.len().saturating_sub(note_lines(value));
        Ok(last.get(..own).unwrap_or_default().last().map(|line| line.trim().to_owned()).unwrap_or_default())
    })();
    // A closed standard error is no reason to say less.
    told.ok().filter(|line| !line.is_empty()).unwrap_or(plain)
}

/// Returns how many lines behind an exception are notes that were added to it.
fn note_lines(exception: &Bound<'_, PyBaseException>) -> usize {
    let notes = exception.getattr("__notes__").and_then(|notes| notes.extract::<Vec<String>>());
    notes.unwrap_or_default().iter().map(|note| note.split('\n').count()).sum()
}
