//! Positions as editors count them: lines from 0, and columns in UTF-16 units, or in bytes if both sides agreed on bytes.

use lsp_types::{Position, Range};

/// The unit in which columns are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Units of UTF-16. Every editor supports these.
    #[default]
    Utf16,
    /// Bytes.
    Utf8,
}

/// The size of the blocks for counting units, in bytes.
const BLOCK: usize = 1024;

/// The beginning of each line of a text.
#[derive(Clone, Debug)]
pub(super) struct Lines {
    starts: Vec<usize>,
    /// The number of UTF-16 units before each block of bytes.
    units: Vec<usize>,
}

impl Lines {
    pub(super) fn new(text: &str) -> Self {
        let bytes = text.as_bytes();
        let is_end = |&at: &usize| bytes[at] == b'\n' || bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n');
        let starts: Vec<usize> = std::iter::once(0).chain((0..bytes.len()).filter(is_end).map(|at| at + 1)).collect();
        let counts = bytes.chunks(BLOCK).scan(0, |sum, block| {
            *sum += units(block);
            Some(*sum)
        });
        let units = std::iter::once(0).chain(counts).collect();
        Self { starts, units }
    }

    /// Returns the byte offset of a position. A position after the end of its line means the end of
    /// this line. A position after the end of the text means the end of the text.
    pub(super) fn offset(&self, text: &str, position: Position, encoding: Encoding) -> usize {
        let line = position.line as usize;
        let Some(&start) = self.starts.get(line) else { return text.len() };
        let end = self.starts.get(line + 1).copied().unwrap_or(text.len());
        let line = text.get(start..end).unwrap_or_default().trim_end_matches(['\n', '\r']);
        let wanted = position.character as usize;
        let mut counted = 0;
        for (at, c) in line.char_indices() {
            counted += width(c, encoding);
            if counted > wanted {
                return start + at;
            }
        }
        start + line.len()
    }

    /// Returns the position of a byte offset.
    pub(super) fn position(&self, text: &str, offset: usize, encoding: Encoding) -> Position {
        let offset = text.floor_char_boundary(offset);
        let line = self.starts.partition_point(|&start| start <= offset).saturating_sub(1);
        let start = self.starts.get(line).copied().unwrap_or(0);
        let column = match encoding {
            Encoding::Utf8 => offset - start,
            // Most lines are short, and most contain only ASCII.
            Encoding::Utf16 => match text.as_bytes().get(start..offset) {
                Some(line) if line.is_ascii() => line.len(),
                Some(line) if line.len() <= BLOCK => units(line),
                Some(_) | None => self.units_before(text, offset) - self.units_before(text, start),
            },
        };
        Position { line: number(line), character: number(column) }
    }

    fn units_before(&self, text: &str, offset: usize) -> usize {
        let block = (offset / BLOCK).min(self.units.len() - 1);
        self.units[block] + text.as_bytes().get(block * BLOCK..offset).map_or(0, units)
    }

    /// Returns the range of some bytes.
    pub(super) fn range(&self, text: &str, bytes: std::ops::Range<usize>, encoding: Encoding) -> Range {
        let start = self.position(text, bytes.start, encoding);
        Range { start, end: self.position(text, bytes.end.max(bytes.start), encoding) }
    }
}

/// Counts the UTF-16 units of the characters that begin in these bytes.
fn units(bytes: &[u8]) -> usize {
    bytes.iter().map(|byte| usize::from(byte & 0xc0 != 0x80) + usize::from(*byte >= 0xf0)).sum()
}

fn width(c: char, encoding: Encoding) -> usize {
    match encoding {
        Encoding::Utf16 => c.len_utf16(),
        Encoding::Utf8 => c.len_utf8(),
    }
}

/// Converts a number for the protocol.
pub(super) fn number(value: usize) -> u32 {
    u32::try_from(value).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "a𝄞ö\r\nb\rc\n\nd";

    #[test]
    fn columns_are_utf_16_units_or_bytes() {
        let lines = Lines::new(TEXT);
        let cases = [
            ((0, 0), 0, (0, 0)),
            ((0, 1), 1, (0, 1)),
            ((0, 3), 5, (0, 5)),
            ((0, 4), 7, (0, 7)),
            ((1, 0), 9, (1, 0)),
            ((2, 0), 11, (2, 0)),
            ((3, 0), 13, (3, 0)),
            ((4, 1), 15, (4, 1)),
        ];
        for ((line, character), offset, (_, byte)) in cases {
            let position = Position { line, character };
            assert_eq!(lines.offset(TEXT, position, Encoding::Utf16), offset);
            assert_eq!(lines.position(TEXT, offset, Encoding::Utf16), position);
            let position = Position { line, character: byte };
            assert_eq!(lines.offset(TEXT, position, Encoding::Utf8), offset);
            assert_eq!(lines.position(TEXT, offset, Encoding::Utf8), position);
        }
    }

    /// Finding a position takes the same time everywhere in a long line.
    #[test]
    fn long_lines_are_counted_in_blocks() {
        let text = "aö𝄞".repeat(1000);
        let lines = Lines::new(&text);
        for (place, (offset, _)) in text.char_indices().enumerate().step_by(7) {
            let units: usize = text[..offset].chars().map(char::len_utf16).sum();
            let position = lines.position(&text, offset, Encoding::Utf16);
            assert_eq!(position, Position { line: 0, character: number(units) }, "{place}");
        }
    }

    #[test]
    fn any_position_has_an_offset_and_any_offset_a_position() {
        let lines = Lines::new(TEXT);
        // These positions are after the end of the line, inside a pair of units, and after the end of the text.
        let offset = |line, character| lines.offset(TEXT, Position { line, character }, Encoding::Utf16);
        assert_eq!((offset(0, 99), offset(0, 2), offset(9, 9), offset(1, 7)), (7, 1, TEXT.len(), 10));
        assert_eq!(lines.position(TEXT, 2, Encoding::Utf16), Position { line: 0, character: 1 });
        assert_eq!(lines.position(TEXT, 999, Encoding::Utf16), Position { line: 4, character: 1 });
        let empty = Lines::new("");
        assert_eq!(empty.position("", 0, Encoding::Utf16), Position::default());
    }
}
