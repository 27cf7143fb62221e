//! Bytes from values.

use super::{Field, Layout};

/// A value, or a part of a value, that is written with a layout.
pub trait Part: Sized {
    /// Why a value cannot be written.
    type Error;

    /// Writes a number, a truth value, a text or a piece.
    ///
    /// # Errors
    /// If the value does not have this layout.
    fn leaf(&self, layout: &Layout, writer: &mut Writer<'_>) -> Result<(), Self::Error>;

    /// Returns the value of a field.
    ///
    /// # Errors
    /// If the value is not a record with such a field.
    fn field(&self, field: &Field) -> Result<Self, Self::Error>;

    /// Returns the elements of a list; exactly `count` of them if the layout fixes their number.
    ///
    /// # Errors
    /// If the value is not a list, or does not have `count` elements.
    fn elements(&self, of: &Layout, count: Option<usize>) -> Result<Vec<Self>, Self::Error>;
}

/// Appends a value to the bytes.
///
/// # Errors
/// If the value does not have this layout. A part of it may have been written.
pub fn write<P: Part>(layout: &Layout, part: &P, writer: &mut Writer<'_>) -> Result<(), P::Error> {
    match layout {
        Layout::Number { .. } | Layout::Truth | Layout::Text | Layout::Piece { .. } => part.leaf(layout, writer),
        Layout::Record(fields) => fields.iter().try_for_each(|one| write(&one.layout, &part.field(one)?, writer)),
        Layout::List { of, count } => {
            let elements = part.elements(of, *count)?;
            if count.is_none() {
                writer.length(elements.len());
            }
            elements.iter().try_for_each(|element| write(of, element, writer))
        }
    }
}

/// Appends encoded values to bytes.
#[derive(Debug)]
pub struct Writer<'a> {
    bytes: &'a mut Vec<u8>,
}

impl<'a> Writer<'a> {
    /// Returns a writer that appends to `bytes`.
    pub fn new(bytes: &'a mut Vec<u8>) -> Self {
        Self { bytes }
    }

    /// Writes a number.
    pub fn number(&mut self, number: f64) {
        self.bytes.extend(number.to_le_bytes());
    }

    /// Writes a truth value.
    pub fn truth(&mut self, truth: bool) {
        self.bytes.push(u8::from(truth));
    }

    /// Writes a text.
    pub fn text(&mut self, text: &str) {
        self.piece(text.as_bytes());
    }

    /// Writes bytes with their length.
    pub fn piece(&mut self, bytes: &[u8]) {
        self.length(bytes.len());
        self.bytes.extend(bytes);
    }

    /// Writes the number of elements of a list, or the length of bytes.
    pub fn length(&mut self, length: usize) {
        self.natural(u64::try_from(length).unwrap_or(u64::MAX));
    }

    /// Writes a whole number of variable length, like a `u64` of a device: seven bits per byte, the lowest first.
    pub fn natural(&mut self, mut number: u64) {
        while number >= 0x80 {
            self.bytes.push(u8::try_from(number & 0x7f).unwrap_or(0) | 0x80);
            number >>= 7;
        }
        self.bytes.push(u8::try_from(number).unwrap_or(0));
    }
}
