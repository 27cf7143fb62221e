//! Reads the bytes of a record part by part, and skips damaged parts.
//!
//! All recorded data is in chunks and attachments, which have checksums. The bytes between them are covered by one
//! checksum over all bytes up to the end. After a part whose length is damaged, reading continues at the next whole
//! chunk. Source: the MCAP format specification, <https://mcap.dev/spec>: Records, Chunk, Attachment, Data End, Footer.

use mcap::records::op;
use std::ops::Range;

/// The size of an opcode and a length.
const HEAD: usize = 1 + 8;
/// The size of a chunk's own fields: two times, size, checksum, empty name of a compression, size again.
const CHUNK_HEAD: usize = 8 + 8 + 8 + 4 + 4 + 8;

/// The opcode and the length of a footer. Its fields are the begin of the summary, the begin of the offsets, and a checksum.
const FOOTER_HEAD: [u8; HEAD] = [op::FOOTER, 8 + 8 + 4, 0, 0, 0, 0, 0, 0, 0];
const FOOTER_SIZE: usize = HEAD + 8 + 8 + 4;

/// A part of the file. The format calls it a record.
#[derive(Clone, Debug)]
pub(super) struct Part<'a> {
    pub(super) opcode: u8,
    pub(super) body: &'a [u8],
    /// The position of the part in the file.
    place: Range<usize>,
}

/// The next part of a record.
#[derive(Debug)]
pub(super) enum Next<'a> {
    /// A complete part. If the part has a checksum, it fits.
    Whole(Part<'a>),
    /// The bytes at this position are damaged.
    Damaged(Range<usize>),
    /// The data ends here, and the end of the file is complete.
    End,
    /// The data ends, but the rest of the file after this byte is cut or damaged. Other readers need this rest.
    EndLost(usize),
    /// The file ends at this byte, before the end of the data.
    Cut(usize),
}

/// Goes through all parts of a file, up to the end of its data. In place of a chunk, `take` gets the parts in it.
pub(super) fn each<'a>(bytes: &'a [u8], mut take: impl FnMut(Next<'a>)) {
    let mut parts = Parts::new(bytes);
    loop {
        match parts.next() {
            Next::Whole(chunk) if chunk.opcode == op::CHUNK => {
                in_chunk(&chunk).for_each(|part| take(Next::Whole(part)));
            }
            next @ (Next::Whole(_) | Next::Damaged(_)) => take(next),
            end @ (Next::Cut(_) | Next::EndLost(_) | Next::End) => return take(end),
        }
    }
}

/// Reads the bytes of a file part by part.
#[derive(Debug)]
struct Parts<'a> {
    bytes: &'a [u8],
    at: usize,
    is_damaged: bool,
}

impl<'a> Parts<'a> {
    /// Begins after the file's magic.
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: mcap::MAGIC.len(), is_damaged: false }
    }

    /// Returns the next part. After `End` and `Cut`, further results have no meaning.
    fn next(&mut self) -> Next<'a> {
        let from = self.at;
        let Some(part) = part_at(self.bytes, from) else {
            let Some(next) = (from + 1..self.bytes.len()).find(|at| is_chunk_at(self.bytes, *at)) else {
                return Next::Cut(from);
            };
            return self.damaged(from..next);
        };
        match part.opcode {
            op::DATA_END => match number(part.body, 0) {
                Some(saved) if self.is_damaged || saved == 0 || saved == crc32fast::hash(&self.bytes[..from]) => {
                    let end = part.place.end;
                    if is_whole_end(self.bytes, end) { Next::End } else { Next::EndLost(end) }
                }
                // Each part with a checksum of its own is whole. So the damage is in the bytes between them.
                _ => self.damaged(0..from),
            },
            op::CHUNK if !is_whole_chunk(part.body) => self.damaged(part.place),
            op::ATTACHMENT if !is_whole_attachment(part.body) => self.damaged(part.place),
            _ => {
                self.at = part.place.end;
                Next::Whole(part)
            }
        }
    }

    fn damaged(&mut self, place: Range<usize>) -> Next<'a> {
        self.is_damaged = true;
        self.at = place.end;
        Next::Damaged(place)
    }
}

/// Returns the parts of a whole chunk.
fn in_chunk<'a>(chunk: &Part<'a>) -> impl Iterator<Item = Part<'a>> {
    let bytes = &chunk.body[CHUNK_HEAD..];
    let mut at = 0;
    std::iter::from_fn(move || {
        let part = part_at(bytes, at)?;
        at = part.place.end;
        Some(part)
    })
}

/// Returns the part that begins at this position. Returns nothing if its kind is not known, or if it is longer than the file.
fn part_at(bytes: &[u8], at: usize) -> Option<Part<'_>> {
    let (opcode, length) = (*bytes.get(at)?, bytes.get(at + 1..at + HEAD)?);
    let length = usize::try_from(u64::from_le_bytes(length.try_into().ok()?)).ok()?;
    let place = at..(at + HEAD).checked_add(length)?;
    let body = bytes.get(at + HEAD..place.end)?;
    (op::HEADER..=op::DATA_END).contains(&opcode).then_some(Part { opcode, body, place })
}

fn is_chunk_at(bytes: &[u8], at: usize) -> bool {
    bytes[at] == op::CHUNK && part_at(bytes, at).is_some_and(|part| is_whole_chunk(part.body))
}

fn is_whole_chunk(body: &[u8]) -> bool {
    let Some(data) = body.get(CHUNK_HEAD..) else { return false };
    // The recorder does not compress, so both sizes are the size of the following data.
    let size = u64::try_from(data.len()).ok().map(u64::to_le_bytes);
    let sizes = [body.get(16..24), body.get(32..40)];
    sizes.iter().all(|found| found.is_some() && *found == size.as_ref().map(<[u8; 8]>::as_slice))
        && number(body, 28) == Some(0)
        && number(body, 24) == Some(crc32fast::hash(data))
}

fn is_whole_attachment(body: &[u8]) -> bool {
    let data = body.len().checked_sub(4).map(|end| &body[..end]);
    data.is_some_and(|data| number(body, data.len()) == Some(crc32fast::hash(data)))
}

/// Checks what readers need after the end of the data: an optional summary, the footer, and the magic.
fn is_whole_end(bytes: &[u8], data_end: usize) -> bool {
    let Some(footer) = bytes.len().checked_sub(mcap::MAGIC.len() + FOOTER_SIZE).filter(|at| *at >= data_end) else {
        return false;
    };
    let mut at = data_end;
    while at < footer {
        match part_at(bytes, at) {
            Some(part) => at = part.place.end,
            None => return false,
        }
    }
    let body = footer + HEAD;
    let start = bytes.get(body..body + 8).and_then(|bytes| Some(u64::from_le_bytes(bytes.try_into().ok()?)));
    let start = start.and_then(|start| usize::try_from(start).ok());
    let (has_summary, saved) = (footer > data_end, number(bytes, body + 16));
    // The checksum covers the summary and the beginning of the footer.
    let found = crc32fast::hash(&bytes[data_end..body + 16]);
    at == footer
        && bytes.get(footer..body) == Some(&FOOTER_HEAD)
        && start == Some(if has_summary { data_end } else { 0 })
        && saved.is_some_and(|saved| if has_summary { saved == found } else { saved == 0 || saved == found })
        && bytes.ends_with(mcap::MAGIC)
}

fn number(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}
