//! The canonical form of all data that is signed, sent or stored: fields in a fixed order, numbers big-endian, lengths in
//! front.
//!
//! Each form begins with its own name and version, such as `dca certificate 1`. A signature also covers that name, so no
//! signature of one form is valid for another. A value has exactly one form: bytes that would be written differently are
//! refused.

use thiserror::Error;

/// Why bytes are not the expected form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FormError {
    /// There are more bytes than the form may have.
    #[error("it is longer than {0} bytes")]
    TooLong(usize),
    /// The bytes end within a field.
    #[error("it ends too early")]
    Short,
    /// Bytes follow the last field.
    #[error("something follows its end")]
    Trailing,
    /// The bytes begin with another name or version.
    #[error("it is not a `{0}`")]
    Kind(&'static str),
    /// A field has a value that is not permitted, or is not in the canonical order.
    #[error("its field `{0}` has a value that is not allowed")]
    Field(&'static str),
}

/// Writes a form.
#[derive(Debug)]
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    /// Begins a form with its name.
    pub(crate) fn new(form: &'static str) -> Self {
        let mut writer = Self(Vec::new());
        writer.short(form.as_bytes());
        writer
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(crate) fn u64(&mut self, value: u64) {
        self.fixed(&value.to_be_bytes());
    }

    /// Writes the number of the following elements. Every list in this room has at most `u16::MAX` elements.
    pub(crate) fn count(&mut self, count: usize) {
        self.fixed(&u16::try_from(count).expect("a list was limited when it was made").to_be_bytes());
    }

    pub(crate) fn fixed(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    /// Writes at most 255 bytes, after their length.
    pub(crate) fn short(&mut self, bytes: &[u8]) {
        self.u8(u8::try_from(bytes.len()).expect("a short field was limited when it was made"));
        self.fixed(bytes);
    }

    /// Writes bytes with their length.
    pub(crate) fn long(&mut self, bytes: &[u8]) {
        self.fixed(&u32::try_from(bytes.len()).expect("a long field was limited when it was made").to_be_bytes());
        self.fixed(bytes);
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Reads a form.
#[derive(Debug)]
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Begins to read bytes. There may be at most `bytes_max`, and they have to begin with the name of the form.
    pub(crate) fn new(bytes: &'a [u8], form: &'static str, bytes_max: usize) -> Result<Self, FormError> {
        if bytes.len() > bytes_max {
            return Err(FormError::TooLong(bytes_max));
        }
        let mut reader = Self(bytes);
        match reader.short() {
            Ok(found) if found == form.as_bytes() => Ok(reader),
            _ => Err(FormError::Kind(form)),
        }
    }

    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], FormError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(FormError::Short)?;
        self.0 = rest;
        Ok(taken)
    }

    pub(crate) fn fixed<const N: usize>(&mut self) -> Result<[u8; N], FormError> {
        let (taken, rest) = self.0.split_first_chunk::<N>().ok_or(FormError::Short)?;
        self.0 = rest;
        Ok(*taken)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, FormError> {
        self.fixed::<1>().map(|[value]| value)
    }

    pub(crate) fn u64(&mut self) -> Result<u64, FormError> {
        self.fixed().map(u64::from_be_bytes)
    }

    /// Reads the number of the following elements, which may be at most `most`.
    pub(crate) fn count(&mut self, most: usize, field: &'static str) -> Result<usize, FormError> {
        let count = usize::from(u16::from_be_bytes(self.fixed()?));
        if count > most { Err(FormError::Field(field)) } else { Ok(count) }
    }

    pub(crate) fn short(&mut self) -> Result<&'a [u8], FormError> {
        let length = self.u8()?;
        self.take(usize::from(length))
    }

    /// Reads bytes with their length in front, which may be at most `most`.
    pub(crate) fn long(&mut self, most: usize, field: &'static str) -> Result<&'a [u8], FormError> {
        let length = usize::try_from(u32::from_be_bytes(self.fixed()?)).unwrap_or(usize::MAX);
        if length > most { Err(FormError::Field(field)) } else { self.take(length) }
    }

    /// Returns the number of unread bytes.
    pub(crate) const fn left(&self) -> usize {
        self.0.len()
    }

    /// Returns all unread bytes.
    pub(crate) fn rest(self) -> &'a [u8] {
        self.0
    }

    /// Ends the form.
    pub(crate) fn finish(self) -> Result<(), FormError> {
        if self.0.is_empty() { Ok(()) } else { Err(FormError::Trailing) }
    }
}
