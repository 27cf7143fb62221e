//! The file of a record, which has an end at any time.
//!
//! A record that was not ended is refused by readers that look for its end, and there is none as long as it is written. So an
//! end is written behind what is there, in the same call, and the next call begins where that end began. Source: the MCAP
//! format specification, <https://mcap.dev/spec>: Data End, Footer and Magic.

use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How much waits in memory, in bytes; a chunk more at the most.
const WAITING_MAX: usize = 4 << 20;
/// Data End (opcode, length, no checksum), Footer (opcode, length, no summary, no checksum), Magic.
const END: [u8; 50] = {
    let mut end = [0; 50];
    end[0] = 0x0f;
    end[1] = 4;
    end[13] = 0x02;
    end[14] = 20;
    let mut index = 0;
    while index < mcap::MAGIC.len() {
        end[42 + index] = mcap::MAGIC[index];
        index += 1;
    }
    end
};

/// A handle to the file; its clones are the same one.
#[derive(Clone, Debug)]
pub(super) struct Disk(Arc<Mutex<Inside>>);

#[derive(Debug)]
struct Inside {
    file: File,
    /// Where what waits belongs.
    at: u64,
    waiting: Vec<u8>,
}

impl Inside {
    /// Returns how long the file is with an end.
    fn end(&self) -> u64 {
        self.at + END.len() as u64
    }
}

impl Disk {
    /// Begins at the beginning of an empty file.
    pub(super) fn new(file: File) -> Self {
        Self(Arc::new(Mutex::new(Inside { file, at: 0, waiting: Vec::new() })))
    }

    /// Writes what waits, with an end behind it.
    pub(super) fn commit(&self) -> io::Result<()> {
        let mut inside = self.lock();
        if inside.waiting.is_empty() {
            return Ok(());
        }
        let length = inside.waiting.len();
        inside.waiting.extend(END);
        let written = inside.file.write_all_at(&inside.waiting, inside.at);
        inside.waiting.clear();
        match written {
            Ok(()) => inside.at += length as u64,
            // The disk is full: what was there before gets its end back.
            Err(_) => drop(inside.file.write_all_at(&END, inside.at).and_then(|()| inside.file.set_len(inside.end()))),
        }
        written
    }

    /// Returns whether so much waits that it is to be written.
    pub(super) fn is_full(&self) -> bool {
        self.lock().waiting.len() >= WAITING_MAX
    }

    /// Writes what waits, which has its own end.
    pub(super) fn finish(&self) -> io::Result<()> {
        let mut inside = self.lock();
        inside.file.write_all_at(&inside.waiting, inside.at)?;
        inside.at += inside.waiting.len() as u64;
        inside.waiting.clear();
        inside.file.set_len(inside.at)
    }

    fn lock(&self) -> MutexGuard<'_, Inside> {
        // Nothing here panics while it holds the lock, so what is inside is whole in any case.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.lock().waiting.extend(bytes);
        Ok(bytes.len())
    }

    /// Does nothing: what is on the disk has to end with a whole chunk, which [`Disk::commit`] is told.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
