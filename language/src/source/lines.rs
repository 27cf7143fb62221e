//! Finds the line and column of a place in logarithmic time.

use super::{Origin, Position, Source, Span};
use std::ops::Range;

/// The block size for counting characters, in bytes.
const BLOCK: usize = 1024;

/// The beginnings of a text's lines, and the number of characters before each block. So looking up a place takes the
/// same time everywhere, in a text of any length with any number of lines.
#[derive(Clone, Debug)]
pub struct Lines<'a> {
    source: &'a Source,
    starts: Vec<usize>,
    /// The number of characters before each block.
    characters: Vec<usize>,
}

impl<'a> Lines<'a> {
    /// Reads a text once.
    pub fn new(source: &'a Source) -> Self {
        let bytes = source.text.as_bytes();
        let ends = bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n').map(|(at, _)| at + 1);
        let starts = std::iter::once(0).chain(ends).collect();
        let counts = bytes.chunks(BLOCK).scan(0, |sum, block| {
            *sum += characters(block);
            Some(*sum)
        });
        let characters = std::iter::once(0).chain(counts).collect();
        Self { source, starts, characters }
    }

    /// Returns the text.
    pub fn source(&self) -> &'a Source {
        self.source
    }

    /// Returns the line and column of a byte offset. An offset after the end gives the end.
    pub fn position(&self, offset: u32) -> Position {
        let offset = self.boundary(offset as usize);
        let line = self.line_of(offset);
        Position { line: line + 1, column: self.before(offset) - self.before(self.starts[line]) + 1 }
    }

    /// Returns the bytes of the lines that a range of bytes touches, without the line end of the last line.
    pub(crate) fn around(&self, range: &Range<usize>) -> Range<usize> {
        let (first, last) = (self.line_of(range.start), self.line_of(range.end.max(range.start)));
        let end = self.starts.get(last + 1).map_or(self.source.text.len(), |next| next - 1);
        self.starts[first]..end.max(range.end)
    }

    /// Returns the nearest boundary of a character at or before an offset.
    pub(crate) fn boundary(&self, offset: usize) -> usize {
        self.source.text.floor_char_boundary(offset)
    }

    fn line_of(&self, offset: usize) -> usize {
        self.starts.partition_point(|&start| start <= offset).saturating_sub(1)
    }

    /// Returns how many characters begin before an offset.
    fn before(&self, offset: usize) -> usize {
        let block = offset / BLOCK;
        self.characters[block] + characters(&self.source.text.as_bytes()[block * BLOCK..offset])
    }
}

/// Returns how many characters begin in these bytes.
fn characters(bytes: &[u8]) -> usize {
    bytes.iter().filter(|&&byte| byte & 0xc0 != 0x80).count()
}

/// The texts that spans point into, each with its lines.
#[derive(Clone, Debug)]
pub struct Texts<'a> {
    spec: Lines<'a>,
    interfaces: Vec<Lines<'a>>,
}

impl<'a> Texts<'a> {
    /// Reads each text once.
    pub fn new(spec: &'a Source, interfaces: &'a [Source]) -> Self {
        Self { spec: Lines::new(spec), interfaces: interfaces.iter().map(Lines::new).collect() }
    }

    /// Returns the spec.
    pub fn spec(&self) -> &'a Source {
        self.spec.source
    }

    /// Returns the text that a span is in, or the spec if there is no such text.
    pub fn of(&self, span: Span) -> &Lines<'a> {
        self.get(span.origin).unwrap_or(&self.spec)
    }

    /// Returns a text, or none if there is no such text.
    pub fn get(&self, origin: Origin) -> Option<&Lines<'a>> {
        match origin {
            Origin::Spec => Some(&self.spec),
            Origin::Interface(index) => self.interfaces.get(index as usize),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The position, computed by its definition.
    fn counted(text: &str, offset: usize) -> Position {
        let before = &text[..offset];
        let start = before.rfind('\n').map_or(0, |newline| newline + 1);
        Position { line: before.matches('\n').count() + 1, column: before[start..].chars().count() + 1 }
    }

    #[test]
    fn positions_count_characters_from_one() {
        let source = Source::new("a.dca", "über\nb");
        let lines = Lines::new(&source);
        assert_eq!(lines.position(0), Position { line: 1, column: 1 });
        assert_eq!(lines.position(1), Position { line: 1, column: 1 });
        assert_eq!(lines.position(2), Position { line: 1, column: 2 });
        assert_eq!(lines.position(6), Position { line: 2, column: 1 });
        assert_eq!(lines.position(900), Position { line: 2, column: 2 });
        assert_eq!((lines.around(&(1..3)), lines.around(&(6..7)), lines.around(&(2..7))), (0..5, 6..7, 0..7));
    }

    proptest! {
        #[test]
        fn a_position_is_what_counting_gives(text in "(a|ö|𝄞|\n|b{300}|é{400}){0,20}") {
            let source = Source::new("any", text.as_str());
            let lines = Lines::new(&source);
            for (offset, _) in text.char_indices().chain([(text.len(), ' ')]) {
                prop_assert_eq!(lines.position(u32::try_from(offset).unwrap()), counted(&text, offset));
            }
        }
    }
}
