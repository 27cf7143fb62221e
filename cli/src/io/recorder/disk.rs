//! The file of a record. It can be read at any time, because every write ends it.
//!
//! A record without an end is refused by some readers, and there is none while it is being written. So an end is
//! written behind the present data, in the same call, and the next call begins where that end began. Source: the MCAP
//! format specification, <https://mcap.dev/spec>: Data End, Footer and Magic.

use mcap::records::op;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The bytes that wait in memory; at most a chunk more.
const WAITING_MAX: usize = 4 << 20;
/// Data End: opcode, length, the checksum of all bytes before it. Footer: opcode, length, no summary, no checksum. Magic.
const END_SIZE: usize = 50;

/// Returns the end of a file whose bytes up to there have a checksum.
fn end(checksum: u32) -> [u8; END_SIZE] {
    let mut end = [0; END_SIZE];
    (end[0], end[1]) = (op::DATA_END, 4);
    end[9..13].copy_from_slice(&checksum.to_le_bytes());
    (end[13], end[14]) = (op::FOOTER, 20);
    end[END_SIZE - mcap::MAGIC.len()..].copy_from_slice(mcap::MAGIC);
    end
}

/// A handle to the file; its clones are the same one.
#[derive(Clone, Debug)]
pub(super) struct Disk(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    file: File,
    /// The place in the file of the waiting bytes.
    at: u64,
    waiting: Vec<u8>,
    /// Of all that was written.
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

    /// Writes the waiting bytes, with an end behind them.
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
            // The disk is full: the earlier data gets its end back.
            state.checksum = before;
            let (end, size) = (state.end(), state.at + END_SIZE as u64);
            drop(state.file.write_all_at(&end, state.at).and_then(|()| state.file.set_len(size)));
        }
        written
    }

    /// Returns whether enough bytes wait to be written.
    pub(super) fn is_full(&self) -> bool {
        self.lock().waiting.len() >= WAITING_MAX
    }

    /// Writes the waiting bytes, which have their own end.
    pub(super) fn finish(&self) -> io::Result<()> {
        let mut state = self.lock();
        state.file.write_all_at(&state.waiting, state.at)?;
        state.at += state.waiting.len() as u64;
        state.waiting.clear();
        state.file.set_len(state.at)
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // No code here panics while it holds the lock, so its data is consistent in any case.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().waiting.extend(bytes);
        Ok(bytes.len())
    }

    /// Does nothing: the file has to end with a whole chunk, of which [`Disk::commit`] is told.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
