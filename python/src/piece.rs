//! Bytes of a received value, which Python can view without a copy.
//!
//! This is the only module of this crate with `unsafe` code. A `memoryview` of a [`Piece`] keeps the piece alive, and the piece keeps the
//! bytes of its value alive. The bytes are not changed, and not freed before the last view has ended. Python has no way to end other views
//! and arrays that were made from a view. So ending a view together with its value would leave pointers to freed bytes. Instead, the number
//! of kept bytes is limited.

use pyo3::exceptions::{PyBufferError, PyMemoryError};
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::PyMemoryView;
use std::ffi::{c_int, c_void};
use std::ops::{Deref, Range};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The most bytes of values that views may keep in this process.
const KEPT_MAX: usize = 512 << 20;
/// How many bytes are kept now.
static KEPT: AtomicUsize = AtomicUsize::new(0);

/// The bytes of a received value. The bytes are treated as kept while there are views of them.
#[derive(Debug)]
pub(crate) struct Arrived {
    bytes: Vec<u8>,
    is_kept: AtomicBool,
}

impl Arrived {
    pub(crate) fn new(bytes: Vec<u8>) -> Arc<Self> {
        Arc::new(Self { bytes, is_kept: AtomicBool::new(false) })
    }

    /// Counts the bytes as kept. Returns false if the limit does not permit this.
    fn keep(&self) -> bool {
        if self.is_kept.swap(true, Ordering::Relaxed) {
            return true;
        }
        let size = self.bytes.len();
        let fits = KEPT.fetch_add(size, Ordering::Relaxed).saturating_add(size) <= KEPT_MAX;
        if !fits {
            self.is_kept.store(false, Ordering::Relaxed);
            KEPT.fetch_sub(size, Ordering::Relaxed);
        }
        fits
    }
}

impl Deref for Arrived {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Arrived {
    fn drop(&mut self) {
        if *self.is_kept.get_mut() {
            KEPT.fetch_sub(self.bytes.len(), Ordering::Relaxed);
        }
    }
}

/// A part of the bytes of a value.
#[pyclass(frozen, module = "dca")]
#[derive(Debug)]
pub(crate) struct Piece {
    whole: Arc<Arrived>,
    range: Range<usize>,
}

impl Piece {
    /// Returns the bytes that contain this piece, and its range in them.
    pub(crate) fn part(&self) -> (&Arc<Arrived>, Range<usize>) {
        (&self.whole, self.range.clone())
    }

    /// Returns a read-only view of a part of `whole`.
    ///
    /// # Errors
    /// If other views keep too many bytes.
    pub(crate) fn view<'py>(
        py: Python<'py>,
        whole: &Arc<Arrived>,
        range: Range<usize>,
    ) -> PyResult<Bound<'py, PyMemoryView>> {
        if !whole.keep() {
            // Views in reference cycles end only when Python collects garbage.
            py.import("gc")?.call_method0("collect")?;
            if !whole.keep() {
                return Err(PyMemoryError::new_err(format!(
                    "views keep {} MiB of values that have arrived: release views, or copy what is kept with bytes(view)",
                    KEPT_MAX >> 20
                )));
            }
        }
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
        // SAFETY: the view belongs to Python. It gets a reference to `slf`, which owns the bytes and never changes them, and it is marked
        // as read-only. So Python does not write through the pointer, and refuses a request for a writable view.
        let filled = unsafe {
            ffi::PyBuffer_FillInfo(view, slf.as_ptr(), bytes.as_ptr() as *mut c_void, length, READ_ONLY, flags)
        };
        if filled == 0 { Ok(()) } else { Err(PyErr::fetch(slf.py())) }
    }
}
