//! The bytes of a value that is waiting to be sent. Large pieces are not copied until they go to their consumers.

use crate::piece::{Arrived, Piece};
use comms::logic::layout::Writer;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyMemoryView};
use std::ops::Range;
use std::sync::Arc;

/// Pieces of at least this many bytes are not copied.
const LARGE: usize = 4096;

/// An encoded value.
#[derive(Debug)]
pub(crate) struct Encoded {
    bytes: Vec<u8>,
    /// Whether a number in the value may be infinite or NaN.
    pub(crate) allows_nan: bool,
    /// Pieces that belong into `bytes`, each with its position there, in order.
    pieces: Vec<(usize, Held)>,
}

/// Bytes that never change.
#[derive(Debug)]
enum Held {
    /// A `bytes` of Python.
    Python(PyBackedBytes),
    /// Bytes that were written for this value.
    Own(Vec<u8>),
    /// A part of a value that has arrived.
    Arrived(Arc<Arrived>, Range<usize>),
}

impl Held {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Python(bytes) => bytes,
            Self::Own(bytes) => bytes,
            Self::Arrived(whole, range) => whole.get(range.clone()).unwrap_or_default(),
        }
    }
}

impl Encoded {
    /// Returns an empty value; `allows_nan` tells whether its numbers may be infinite or NaN.
    pub(crate) fn new(allows_nan: bool) -> Self {
        Self { bytes: Vec::new(), allows_nan, pieces: Vec::new() }
    }

    /// Returns a writer that appends to the value.
    pub(crate) fn writer(&mut self) -> Writer<'_> {
        Writer::new(&mut self.bytes)
    }

    /// Writes the content of a buffer. A `bytes` object and a view of a received value never change, so a large one is not copied. Any
    /// other buffer is copied now.
    ///
    /// # Errors
    /// If `value` is not a buffer.
    pub(crate) fn buffer(&mut self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        if let Ok(bytes) = value.cast::<PyBytes>() {
            self.piece(bytes);
            return Ok(());
        }
        let view = PyMemoryView::from(value)?;
        if let Some((whole, range)) = arrived(&view) {
            self.writer().length(range.len());
            self.pieces.push((self.bytes.len(), Held::Arrived(whole, range)));
            return Ok(());
        }
        // The bytes of an array of objects would be addresses in this process.
        if view.getattr("format")?.extract::<String>()?.contains('O') {
            return Err(PyTypeError::new_err("objects have no bytes"));
        }
        // This also copies data that is not contiguous.
        self.piece(&view.call_method0("tobytes")?.cast_into::<PyBytes>()?);
        Ok(())
    }

    /// Writes bytes that were made for this value, with their length.
    pub(crate) fn own(&mut self, bytes: Vec<u8>) {
        self.writer().length(bytes.len());
        self.pieces.push((self.bytes.len(), Held::Own(bytes)));
    }

    fn piece(&mut self, bytes: &Bound<'_, PyBytes>) {
        if bytes.as_bytes().len() < LARGE {
            return self.writer().piece(bytes.as_bytes());
        }
        self.writer().length(bytes.as_bytes().len());
        self.pieces.push((self.bytes.len(), Held::Python(bytes.clone().into())));
    }

    /// Calls `take` with the bytes, piece by piece; returns whether all pieces were taken.
    pub(crate) fn each(&self, take: &mut dyn FnMut(&[u8]) -> bool) -> bool {
        let mut from = 0;
        for (place, held) in &self.pieces {
            let before = self.bytes.get(from..*place).unwrap_or_default();
            if !take(before) || !take(held.bytes()) {
                return false;
            }
            from = *place;
        }
        take(self.bytes.get(from..).unwrap_or_default())
    }

    /// Returns all bytes in one piece.
    pub(crate) fn whole(self) -> Vec<u8> {
        if self.pieces.is_empty() {
            return self.bytes;
        }
        let mut whole = Vec::with_capacity(
            self.bytes.len() + self.pieces.iter().map(|(_, held)| held.bytes().len()).sum::<usize>(),
        );
        self.each(&mut |bytes| {
            whole.extend(bytes);
            true
        });
        whole
    }
}

/// Returns the data behind a view, if the view covers all of a large piece of a received value.
fn arrived(view: &Bound<'_, PyMemoryView>) -> Option<(Arc<Arrived>, Range<usize>)> {
    let piece = view.getattr("obj").ok()?.cast_into::<Piece>().ok()?;
    let (whole, range) = piece.get().part();
    let size: usize = view.getattr("nbytes").ok()?.extract().ok()?;
    let is_contiguous: bool = view.getattr("c_contiguous").ok()?.extract().ok()?;
    // A view of another part, or a reversed view, has another first byte.
    let is_whole = size == range.len() && size >= LARGE && is_contiguous;
    is_whole.then(|| (Arc::clone(whole), range))
}
