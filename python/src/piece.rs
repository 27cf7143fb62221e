//! Bytes of a value that has arrived, for Python to look at without a copy.
//!
//! The one module of this crate with `unsafe` code. A `memoryview` of a [`Piece`] keeps the piece, and the piece keeps the bytes of its value. The
//! bytes are not changed, and not freed before the last view is gone.

use pyo3::exceptions::PyBufferError;
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::PyMemoryView;
use std::ffi::{c_int, c_void};
use std::ops::Range;
use std::sync::Arc;

/// A part of the bytes of a value.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Piece {
    whole: Arc<Vec<u8>>,
    range: Range<usize>,
}

impl Piece {
    /// Returns the bytes that it is a part of, and which.
    pub(crate) fn part(&self) -> (&Arc<Vec<u8>>, Range<usize>) {
        (&self.whole, self.range.clone())
    }

    /// Returns a read-only view of a part of `whole`.
    pub(crate) fn view<'py>(
        py: Python<'py>,
        whole: &Arc<Vec<u8>>,
        range: Range<usize>,
    ) -> PyResult<Bound<'py, PyMemoryView>> {
        let piece = Bound::new(py, Self { whole: Arc::clone(whole), range })?;
        PyMemoryView::from(piece.as_any())
    }
}

#[pymethods]
impl Piece {
    /// Fills in a view of the bytes. Source: the buffer protocol of Python, `PyBuffer_FillInfo`.
    #[expect(unsafe_code, reason = "Python asks for the address of the bytes")]
    unsafe fn __getbuffer__(slf: Bound<'_, Self>, view: *mut ffi::Py_buffer, flags: c_int) -> PyResult<()> {
        const READ_ONLY: c_int = 1;
        let piece = slf.get();
        let bytes = piece.whole.get(piece.range.clone()).unwrap_or_default();
        let length = bytes.len().try_into().map_err(|_too_long| PyBufferError::new_err("too many bytes"))?;
        // SAFETY: the view is Python's own. It gets a reference to `slf`, which owns the bytes and never changes them, and it is
        // marked read-only: so Python does not write through the pointer, and refuses a view that asks to.
        let filled = unsafe {
            ffi::PyBuffer_FillInfo(view, slf.as_ptr(), bytes.as_ptr() as *mut c_void, length, READ_ONLY, flags)
        };
        if filled == 0 { Ok(()) } else { Err(PyErr::fetch(slf.py())) }
    }
}
