//! Reads values from the beginning of bytes.

use super::{CdrError, HEADER, PADDING_MAX};

/// Reads values one after the other.
#[derive(Debug)]
pub struct Reader<'a> {
    /// The bytes behind the header.
    body: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    /// Returns a reader of the value in `bytes`.
    ///
    /// # Errors
    /// If the bytes do not begin with the header of CDR in little endian. The last two bytes of the header are options, which are ignored.
    pub fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let (header, body) = bytes.split_at_checked(HEADER.len()).ok_or(CdrError::Header)?;
        if header[..2] == HEADER[..2] { Ok(Self { body, at: 0 }) } else { Err(CdrError::Header) }
    }

    /// Returns the number of remaining bytes.
    pub fn left(&self) -> usize {
        self.body.len().saturating_sub(self.at)
    }

    /// Checks that the value ends here.
    ///
    /// # Errors
    /// If more bytes follow than padding.
    pub fn end(&self) -> Result<(), CdrError> {
        if self.left() <= PADDING_MAX { Ok(()) } else { Err(CdrError::Rest(self.left())) }
    }

    /// Takes the `N` bytes of a number.
    ///
    /// # Errors
    /// If there are fewer bytes.
    pub fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = self.at.next_multiple_of(N);
        let (number, _) = self.body.get(self.at..).and_then(|rest| rest.split_first_chunk()).ok_or(CdrError::End)?;
        self.at += N;
        Ok(*number)
    }

    /// Takes `count` bytes.
    ///
    /// # Errors
    /// If there are fewer bytes.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let (bytes, _) = self.body.get(self.at..).and_then(|rest| rest.split_at_checked(count)).ok_or(CdrError::End)?;
        self.at += count;
        Ok(bytes)
    }

    /// Takes `count` numbers of `size` bytes each. The first one begins at a multiple of its size.
    ///
    /// # Errors
    /// If there are fewer bytes.
    pub fn numbers(&mut self, count: usize, size: usize) -> Result<&'a [u8], CdrError> {
        if count > 0 {
            self.at = self.at.next_multiple_of(size.max(1));
        }
        self.bytes(count.saturating_mul(size))
    }

    /// Takes a truth value.
    ///
    /// # Errors
    /// If the byte is neither 0 nor 1.
    pub fn truth(&mut self) -> Result<bool, CdrError> {
        match self.number()? {
            [0] => Ok(false),
            [1] => Ok(true),
            _ => Err(CdrError::Truth),
        }
    }

    /// Takes a text. Its length includes the zero byte at its end; some peers send an empty text without this byte.
    ///
    /// # Errors
    /// If the text is not UTF-8, or contains a zero byte.
    pub fn text(&mut self) -> Result<&'a str, CdrError> {
        let length = self.length()?;
        let bytes = self.bytes(length)?;
        let text = match bytes.split_last() {
            Some((0, text)) => text,
            Some(_) => return Err(CdrError::Text),
            None => bytes,
        };
        if text.contains(&0) {
            return Err(CdrError::Text);
        }
        std::str::from_utf8(text).map_err(|_not_utf8| CdrError::Text)
    }

    /// Takes the number of elements of a list.
    ///
    /// # Errors
    /// If `count` elements of at least `size_min` bytes do not fit into the remaining bytes.
    pub fn count(&mut self, size_min: usize) -> Result<usize, CdrError> {
        let count = self.length()?;
        self.fits(count, size_min)?;
        Ok(count)
    }

    /// Checks that `count` elements of at least `size_min` bytes fit into the remaining bytes.
    ///
    /// # Errors
    /// If they do not fit.
    pub fn fits(&self, count: usize, size_min: usize) -> Result<(), CdrError> {
        if count.saturating_mul(size_min) <= self.left() { Ok(()) } else { Err(CdrError::End) }
    }

    fn length(&mut self) -> Result<usize, CdrError> {
        usize::try_from(u32::from_le_bytes(self.number()?)).map_err(|_small| CdrError::End)
    }
}
