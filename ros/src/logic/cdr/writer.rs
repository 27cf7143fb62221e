//! Writes values one after the other.

use super::{CdrError, HEADER};

/// Writes a value after the header of CDR.
#[derive(Debug)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Default for Writer {
    fn default() -> Self {
        Self { bytes: HEADER.to_vec() }
    }
}

impl Writer {
    /// Returns a writer with room for so many bytes.
    pub fn with_capacity(capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(capacity.max(HEADER.len()));
        bytes.extend_from_slice(&HEADER);
        Self { bytes }
    }

    /// Returns the bytes of the value, with their header.
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    /// Writes a number at a multiple of its size.
    pub fn number<const N: usize>(&mut self, number: [u8; N]) {
        let at = self.bytes.len() - HEADER.len();
        self.bytes.resize(at.next_multiple_of(N) + HEADER.len(), 0);
        self.bytes.extend_from_slice(&number);
    }

    /// Makes room for `count` numbers of `size` bytes each. The first one begins at a multiple of its size. Returns their bytes, which are
    /// 0.
    pub fn numbers(&mut self, count: usize, size: usize) -> &mut [u8] {
        let at = self.bytes.len() - HEADER.len();
        let start = if count > 0 { at.next_multiple_of(size.max(1)) + HEADER.len() } else { self.bytes.len() };
        self.bytes.resize(start.saturating_add(count.saturating_mul(size)), 0);
        &mut self.bytes[start..]
    }

    /// Writes bytes without their number.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Writes a text, with its length and a zero byte.
    ///
    /// # Errors
    /// If the text contains a zero byte, which would end it for the reader, or if it is too long for the length field.
    pub fn text(&mut self, text: &str) -> Result<(), CdrError> {
        if text.contains('\0') {
            return Err(CdrError::Text);
        }
        self.count(text.len() + 1)?;
        self.bytes(text.as_bytes());
        self.bytes(&[0]);
        Ok(())
    }

    /// Writes the number of elements of a list.
    ///
    /// # Errors
    /// If the number is too large for the length field.
    pub fn count(&mut self, count: usize) -> Result<(), CdrError> {
        let count = u32::try_from(count).map_err(|_large| CdrError::Long(count))?;
        self.number(count.to_le_bytes());
        Ok(())
    }
}
