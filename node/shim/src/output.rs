//! The program's output: from a pipe through a bounded queue into a file that is rotated.
//!
//! The program must never wait for a disk: one thread empties the pipe as fast as the program fills it, another writes.
//! Output that finds the queue full is dropped and counted, and the count is written where the output is missing.

use comms::io::file::{self, Privacy};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::pipe::{PipeFlags, pipe_with};
use shim::protocol::{OUTPUT_FILE, OUTPUT_FILE_OLD, OUTPUT_SIZE_MAX};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How much is read at once: the capacity of a pipe.
const CHUNK_SIZE: usize = 64 << 10;
/// How much waits for the disk.
const QUEUE_SIZE_MAX: usize = 1 << 20;

/// The output of one program.
pub(crate) struct Output {
    writer: Mutex<Option<OwnedFd>>,
    reader: OwnedFd,
    queue: Arc<Queue>,
}

#[derive(Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    chunks: VecDeque<Vec<u8>>,
    size: usize,
    dropped: u64,
    /// Whether bytes are between the pipe and the queue, or between the queue and the file.
    reading: bool,
    writing: bool,
    ended: bool,
}

impl Output {
    /// Checks that the name of the output file belongs to a regular file or to nothing. It makes no file.
    pub(crate) fn check(dir: &Path) -> io::Result<()> {
        file::check_itself(&dir.join(OUTPUT_FILE))
    }

    /// Opens the output file of the instance in `dir`, and starts the threads that fill it.
    pub(crate) fn open(dir: &Path) -> io::Result<Self> {
        let (reader, writer) = pipe_with(PipeFlags::CLOEXEC)?;
        let file = LogFile::open(dir)?;
        let queue = Arc::new(Queue::default());
        let (filling, writing) = (Arc::clone(&queue), Arc::clone(&queue));
        let pipe = File::from(reader.try_clone()?);
        std::thread::Builder::new().name("output".into()).spawn(move || fill(pipe, &filling))?;
        std::thread::Builder::new().name("disk".into()).spawn(move || write(file, &writing))?;
        Ok(Self { writer: Mutex::new(Some(writer)), reader, queue })
    }

    /// Returns the end of the pipe for the program.
    pub(crate) fn writer(&self) -> io::Result<OwnedFd> {
        let writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        writer.as_ref().map_or_else(|| Err(io::ErrorKind::BrokenPipe.into()), OwnedFd::try_clone)
    }

    /// The program has its end of the pipe: from now on the pipe ends with the program and its descendants.
    pub(crate) fn started(&self) {
        drop(self.writer.lock().unwrap_or_else(PoisonError::into_inner).take());
    }

    /// Waits until the output up to now is in the file, for at most `within`.
    pub(crate) fn settle(&self, within: Duration) {
        let busy = |state: &mut State| {
            // In this order: bytes that have left the pipe show in the state.
            let waiting = rustix::io::ioctl_fionread(&self.reader).unwrap_or(0);
            !state.ended && (waiting > 0 || state.reading) || state.size > 0 || state.writing
        };
        let state = self.queue.lock();
        drop(self.queue.changed.wait_timeout_while(state, within, busy));
    }
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing in a critical section of this file can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn update(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.lock());
        self.changed.notify_all();
    }
}

/// Empties the pipe into the queue until no process can write to it any more.
fn fill(mut pipe: File, queue: &Queue) {
    let mut chunk = vec![0; CHUNK_SIZE];
    loop {
        let ready = poll(&mut [PollFd::new(&pipe.as_fd(), PollFlags::IN)], None);
        queue.update(|state| state.reading = true);
        let read = ready.map_err(io::Error::from).and_then(|_| pipe.read(&mut chunk));
        let size = match read {
            Ok(0) => break,
            Ok(size) => size,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => 0,
            Err(_) => break,
        };
        queue.update(|state| {
            state.reading = false;
            if state.size + size > QUEUE_SIZE_MAX {
                state.dropped += size as u64;
            } else if size > 0 {
                let mut bytes = gap(std::mem::take(&mut state.dropped));
                bytes.extend(&chunk[..size]);
                state.size += bytes.len();
                state.chunks.push_back(bytes);
            }
        });
    }
    queue.update(|state| state.ended = true);
}

/// Writes the queue into the file until the pipe has ended.
fn write(mut file: LogFile, queue: &Queue) {
    loop {
        let idle = |state: &mut State| state.chunks.is_empty() && state.dropped == 0 && !state.ended;
        let mut state = queue.changed.wait_while(queue.lock(), idle).unwrap_or_else(PoisonError::into_inner);
        let bytes = match state.chunks.pop_front() {
            Some(chunk) => chunk,
            None if state.dropped > 0 => gap(std::mem::take(&mut state.dropped)),
            None => return,
        };
        state.writing = true;
        state.size = state.chunks.iter().map(Vec::len).sum();
        drop(state);
        file.append(&bytes);
        queue.update(|state| state.writing = false);
    }
}

/// Returns the text for a gap in the output.
fn gap(dropped: u64) -> Vec<u8> {
    if dropped == 0 {
        return Vec::new();
    }
    format!("\n[dca: {dropped} bytes of output were dropped here]\n").into_bytes()
}

/// The output file, and the previous one: together they never have more than twice [`OUTPUT_SIZE_MAX`], even if others
/// write to them.
struct LogFile {
    dir: PathBuf,
    /// None while the disk refuses one.
    file: Option<File>,
}

impl LogFile {
    fn open(dir: &Path) -> io::Result<Self> {
        let file = file::appended_itself(&dir.join(OUTPUT_FILE), Privacy::Usual)?;
        Ok(Self { dir: dir.to_owned(), file: Some(file) })
    }

    /// Appends, and drops output that does not fit on the disk: the program continues.
    fn append(&mut self, bytes: &[u8]) {
        let path = self.dir.join(OUTPUT_FILE);
        // A removed file can no longer be read, and would grow without end.
        drop(self.file.take_if(|file| !file::is_in_place(file, &path)));
        if self.file.is_none() {
            self.file = file::appended_itself(&path, Privacy::Usual).ok();
        }
        let length = |file: &File| file.metadata().map_or(0, |file| file.len());
        if self.file.as_ref().is_some_and(|file| length(file) >= OUTPUT_SIZE_MAX) {
            self.rotate(&path);
        }
        if let Some(mut file) = self.file.as_ref() {
            // Output that the disk refuses is lost.
            file.write_all(bytes).unwrap_or_default();
        }
    }

    /// Puts the file aside. Where that is not possible it begins again.
    fn rotate(&mut self, path: &Path) {
        let moved = std::fs::rename(path, self.dir.join(OUTPUT_FILE_OLD));
        if let Ok(fresh) = moved.and_then(|()| file::appended_itself(path, Privacy::Usual)) {
            self.file = Some(fresh);
            return;
        }
        // If the old part cannot be put aside, the file is emptied to make room.
        let in_place = self.file.take().filter(|file| file::is_in_place(file, path));
        self.file = in_place.filter(|file| file.set_len(0).is_ok());
    }
}
