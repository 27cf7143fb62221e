//! The file of a record. It can be read at any time, because every write adds an end.
//!
//! Some readers refuse a record without an end, and a record that is being written has no end. So each write adds an end
//! after the present data, and the next write replaces this end. Source: the MCAP format specification,
//! <https://mcap.dev/spec>: Data End, Footer and Magic.

use mcap::records::op;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How many bytes may wait in memory before they are written. At most one chunk may come on top.
const WAITING_MAX: usize = 4 << 20;
/// Data End: opcode, length, and the checksum of all earlier bytes. Footer: opcode, length, no summary, no checksum. Magic.
const END_SIZE: usize = 50;

/// Returns the end of a file. `checksum` is the checksum of all earlier bytes.
fn end(checksum: u32) -> [u8; END_SIZE] {
    let mut end = [0; END_SIZE];
    (end[0], end[1]) = (op::DATA_END, 4);
    end[9..13].copy_from_slice(&checksum.to_le_bytes());
    (end[13], end[14]) = (op::FOOTER, 20);
    end[END_SIZE - mcap::MAGIC.len()..].copy_from_slice(mcap::MAGIC);
    end
}

/// A handle to the file. Its clones refer to the same file.
#[derive(Clone, Debug)]
pub(super) struct Disk(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    file: File,
    /// The position in the file where the waiting bytes belong.
    at: u64,
    waiting: Vec<u8>,
    /// The checksum of all data that was written.
    checksum: crc32fast::Hasher,
}

impl State {
    /// Returns the end for the data written so far.
    fn end(&self) -> [u8; END_SIZE] {
        end(self.checksum.clone().finalize())
    }
}

impl Disk {
    /// Begins at the beginning of an empty file.
    pub(super) fn new(file: File) -> Self {
        Self(Arc::new(Mutex::new(State { file, at: 0, waiting: Vec::new(), checksum: crc32fast::Hasher::new() })))
    }

    /// Writes the waiting bytes, followed by an end.
    pub(super) fn commit(&self) -> io::Result<()> {
        let mut state = self.lock();
        if state.waiting.is_empty() {
            return Ok(());
        }
        let (length, before) = (state.waiting.len(), state.checksum.clone());
        let State { waiting, checksum, .. } = &mut *state;
        checksum.update(waiting);
        let end = state.end();
        state.waiting.extend(end);
        let written = state.file.write_all_at(&state.waiting, state.at);
        state.waiting.clear();
        if written.is_ok() {
            state.at += length as u64;
        } else {
            // The disk is full, so the earlier data gets its end again.
            state.checksum = before;
            let (end, size) = (state.end(), state.at + END_SIZE as u64);
            drop(state.file.write_all_at(&end, state.at).and_then(|()| state.file.set_len(size)));
        }
        written
    }

    /// Returns whether enough bytes wait, so that they have to be written.
    pub(super) fn is_full(&self) -> bool {
        self.lock().waiting.len() >= WAITING_MAX
    }

    /// Writes the waiting bytes. They already contain the end of the file.
    pub(super) fn finish(&self) -> io::Result<()> {
        let mut state = self.lock();
        state.file.write_all_at(&state.waiting, state.at)?;
        state.at += state.waiting.len() as u64;
        state.waiting.clear();
        state.file.set_len(state.at)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code panics while it holds the lock, so the data is always consistent.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().waiting.extend(bytes);
        Ok(bytes.len())
    }

    /// Does nothing: the file has to end with a whole chunk. [`Disk::commit`] writes, and is called after a whole chunk.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
