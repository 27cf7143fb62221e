//! The bytes of a value that waits to be sent. Large pieces of bytes in it are not copied before they go to their consumers.

use crate::piece::{Arrived, Piece};
use comms::logic::layout::Writer;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyMemoryView};
use std::ops::Range;
use std::sync::Arc;

/// From so many bytes on, a piece stays where it is.
const LARGE: usize = 4096;

/// An encoded value.
#[derive(Debug)]
pub(crate) struct Encoded {
    bytes: Vec<u8>,
    /// Whether a number in it may be infinite, or not a number.
    pub(crate) allows_nan: bool,
    /// Pieces that belong into `bytes`, each with its place there, in order.
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
    /// Returns the beginning of a value; `allows_nan` says whether its numbers may be infinite, or not numbers.
    pub(crate) fn new(allows_nan: bool) -> Self {
        Self { bytes: Vec::new(), allows_nan, pieces: Vec::new() }
    }

    /// Returns a writer that appends to it.
    pub(crate) fn writer(&mut self) -> Writer<'_> {
        Writer::new(&mut self.bytes)
    }

    /// Writes the content of any buffer. A `bytes`, and a view of a value that has arrived, cannot change, so a large one is not copied. Any other buffer
    /// is copied once, at once.
    ///
    /// # Errors
    /// If it is not a buffer.
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
        // The bytes of an array of objects are addresses in this process.
        if view.getattr("format")?.extract::<String>()?.contains('O') {
            return Err(PyTypeError::new_err("objects have no bytes"));
        }
        // This also copies data that is not one piece.
        self.piece(&view.call_method0("tobytes")?.cast_into::<PyBytes>()?);
        Ok(())
    }

    /// Writes bytes that were written for this value, with their length.
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

    /// Hands its bytes over, piece by piece; returns whether all were taken.
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

    /// Returns its bytes as one piece.
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

/// Returns the data behind a view, if that is all of a large piece of a value that has arrived.
fn arrived(view: &Bound<'_, PyMemoryView>) -> Option<(Arc<Arrived>, Range<usize>)> {
    let piece = view.getattr("obj").ok()?.cast_into::<Piece>().ok()?;
    let (whole, range) = piece.get().part();
    let size: usize = view.getattr("nbytes").ok()?.extract().ok()?;
    let is_contiguous: bool = view.getattr("c_contiguous").ok()?.extract().ok()?;
    // A view of another part, or a reversed one, has its first byte elsewhere.
    let is_whole = size == range.len() && size >= LARGE && is_contiguous;
    is_whole.then(|| (Arc::clone(whole), range))
}
