//! Reads values from bytes. The reader never takes more memory or time than the length of the bytes justifies.

use super::{Field, LENGTH_BYTES_MAX, Layout};

/// Makes the values that are read; inner values are made first.
pub trait Build {
    /// A value.
    type Value;

    /// Returns a number, which may be infinite or NaN.
    fn number(&mut self, number: f64) -> Self::Value;
    /// Returns a truth value.
    fn truth(&mut self, truth: bool) -> Self::Value;
    /// Returns a text.
    fn text(&mut self, text: &str) -> Self::Value;
    /// Returns the value of type `of` in `bytes`; none if the bytes are not such a value.
    fn piece(&mut self, of: &str, bytes: &[u8]) -> Option<Self::Value>;
    /// Returns a record with the values of these fields, in their order.
    fn record(&mut self, fields: &[Field], values: Vec<Self::Value>) -> Self::Value;
    /// Returns a list of these elements.
    fn list(&mut self, elements: Vec<Self::Value>) -> Self::Value;
}

/// Returns the value in `bytes`; none if the bytes do not have exactly this layout.
pub fn read<B: Build>(layout: &Layout, bytes: &[u8], build: &mut B) -> Option<B::Value> {
    let mut reader = Reader::new(bytes);
    let value = value(layout, &mut reader, build)?;
    reader.rest.is_empty().then_some(value)
}

fn value<B: Build>(layout: &Layout, reader: &mut Reader<'_>, build: &mut B) -> Option<B::Value> {
    Some(match layout {
        Layout::Number { .. } => build.number(reader.number()?),
        Layout::Truth => build.truth(reader.truth()?),
        Layout::Text => build.text(reader.text()?),
        Layout::Piece { of } => build.piece(of, reader.piece()?)?,
        Layout::Record(fields) => {
            let values = fields.iter().map(|field| value(&field.layout, reader, build)).collect::<Option<_>>()?;
            build.record(fields, values)
        }
        Layout::List { of, count } => {
            let count = reader.count(*count)?;
            let elements = (0..count).map(|_| value(of, reader, build)).collect::<Option<_>>()?;
            build.list(elements)
        }
    })
}

/// Reads encoded values from the beginning of bytes. Each function returns none if the bytes do not begin with such a
/// value.
#[derive(Debug)]
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Returns a reader of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// Returns the unread bytes.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// Takes a number.
    pub fn number(&mut self) -> Option<f64> {
        let (number, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(f64::from_le_bytes(*number))
    }

    /// Takes a truth value.
    pub fn truth(&mut self) -> Option<bool> {
        match self.bytes(1)? {
            [0] => Some(false),
            [1] => Some(true),
            _ => None,
        }
    }

    /// Takes a text.
    pub fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.piece()?).ok()
    }

    /// Reads bytes that are sent with their length.
    pub fn piece(&mut self) -> Option<&'a [u8]> {
        let length = self.length()?;
        self.bytes(length)
    }

    /// Reads the number of elements of a list, unless its type fixes the number. None if it exceeds the number of
    /// unread bytes: an element has at least one byte.
    pub fn count(&mut self, count: Option<usize>) -> Option<usize> {
        let count = count.map_or_else(|| self.length(), Some)?;
        (count <= self.rest.len()).then_some(count)
    }

    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(bytes)
    }

    fn length(&mut self) -> Option<usize> {
        self.natural().and_then(|length| usize::try_from(length).ok())
    }

    /// Reads a whole number of variable length, like a `u64` of a device: seven bits per byte, the lowest first.
    pub fn natural(&mut self) -> Option<u64> {
        let mut length = 0_u64;
        for place in 0..LENGTH_BYTES_MAX {
            let [byte] = *self.bytes(1)? else { return None };
            length |= u64::from(byte & 0x7f).checked_shl(u32::try_from(7 * place).ok()?)?;
            if byte < 0x80 {
                return Some(length);
            }
        }
        None
    }
}
