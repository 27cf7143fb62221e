//! Exceptions: the last line becomes the reason of an abort, and the traceback is written to the program's log.

use pyo3::exceptions::PyBaseException;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Returns the last line of an exception, and writes its traceback to standard error, which the node records.
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
    // If standard error is closed, the reason is still returned.
    told.ok().filter(|line| !line.is_empty()).unwrap_or(plain)
}

/// Returns the number of lines of the notes that were added to an exception.
fn note_lines(exception: &Bound<'_, PyBaseException>) -> usize {
    let notes = exception.getattr("__notes__").and_then(|notes| notes.extract::<Vec<String>>());
    notes.unwrap_or_default().iter().map(|note| note.split('\n').count()).sum()
}
