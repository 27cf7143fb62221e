//! Writes the record of a run, on a separate thread.
//!
//! The queue to the thread is bounded, and no producer ever waits for it. If the queue is full, samples are dropped and
//! counted. Reports may use twice the length, so that many samples at once cannot displace them. Values of wires have a
//! limit of their own, in bytes. Data older than a second is in the file, in whole chunks and followed by an end. So a
//! recorder that is killed loses at most the last second, and any reader opens the rest.

mod disk;
mod queue;

use crate::io::named_file;
use crate::logic::record::{Entry, Header, ReadError, Row, Rows, Run, Timeline};
use comms::io::clock;
use comms::logic::human::cause;
use comms::logic::time::Time;
use disk::Disk;
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use mcap::{Attachment, McapError, WriteOptions, Writer};
use queue::{Queue, Work};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Name of a record in the folder of its run.
pub const FILE: &str = "run.mcap";
/// The largest record that is read, in bytes. Reading it takes as much memory again.
const RECORD_MAX: usize = 1 << 30;
/// The last part of a record that may be lost if the recorder is killed.
pub const FLUSH_EVERY: Duration = Duration::from_secs(1);

/// An error of the recorder.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The folder or the file cannot be made.
    #[error("creating the record `{path}`: {cause}")]
    Create {
        /// The path of the record.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
    },
    /// The file cannot be written.
    #[error("writing the record `{path}`: {}", reason(cause))]
    Write {
        /// The path of the record.
        path: PathBuf,
        /// The error of the library that writes the format.
        cause: McapError,
    },
    /// The file cannot be opened.
    #[error("reading the record `{path}`: {cause}")]
    Open {
        /// The path of the record.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
    },
    /// The file is not a record.
    #[error("reading the record `{path}`: {cause}")]
    Read {
        /// The path of the record.
        path: PathBuf,
        /// The reason.
        cause: ReadError,
    },
}

impl RecordError {
    /// Returns whether the error is about a record that exists but cannot be read completely: it is damaged, cut, or of a later version.
    pub fn is_of_a_record(&self) -> bool {
        match self {
            Self::Read { cause, .. } => !matches!(cause, ReadError::Foreign(_)),
            Self::Create { .. } | Self::Write { .. } | Self::Open { .. } => false,
        }
    }
}

/// Returns the message of the system, if there is one: the library leaves it out.
fn reason(error: &McapError) -> String {
    if let McapError::Io(error) = error { cause(error) } else { error.to_string() }
}

/// Returns the path of a record: `named` itself, or the record in this folder.
pub fn file(named: &Path) -> PathBuf {
    if named.is_dir() { named.join(FILE) } else { named.to_owned() }
}

/// Reads the readable part of a record.
///
/// # Errors
/// There is no such file, or the file does not name its run.
pub fn read(path: &Path) -> Result<Run, RecordError> {
    read_as(path, Run::from_bytes)
}

/// Reads the readable part of a record, including the values of wires.
///
/// # Errors
/// The same as for [`read`].
pub fn read_with_values(path: &Path) -> Result<Run, RecordError> {
    read_as(path, Run::with_values)
}

/// Reads the messages in the readable part of a record.
///
/// # Errors
/// There is no such file, or it has no whole message.
pub(crate) fn read_timeline(path: &Path) -> Result<Timeline, RecordError> {
    read_as(path, Timeline::from_bytes)
}

fn read_as<T>(path: &Path, read: impl Fn(&[u8]) -> Result<T, ReadError>) -> Result<T, RecordError> {
    let bytes =
        named_file::bytes(path, RECORD_MAX).map_err(|cause| RecordError::Open { path: path.to_owned(), cause })?;
    read(&bytes).map_err(|cause| RecordError::Read { path: path.to_owned(), cause })
}

/// A record that is being written. If it is dropped, it is ended without a message.
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    queue: Arc<Queue>,
    thread: Option<JoinHandle<Result<(), McapError>>>,
    /// When the record began: as the time since 1970, which may be wrong, and on a clock that does not jump.
    begun: (Duration, Time),
}

impl Recorder {
    /// Begins the record `run.mcap` in `folder`, and makes the folder if necessary. An existing record is replaced.
    ///
    /// # Errors
    /// The file cannot be made, or the header cannot be written.
    pub fn create(folder: &Path, header: &Header) -> Result<Self, RecordError> {
        let path = folder.join(FILE);
        let made = fs::create_dir_all(folder).and_then(|()| File::create(&path));
        let file = made.map_err(|cause| RecordError::Create { path: path.clone(), cause })?;
        let written = Log::begin(file, header);
        let log = written.map_err(|cause| RecordError::Write { path: path.clone(), cause })?;
        let queue = Arc::new(Queue::default());
        let theirs = Arc::clone(&queue);
        let thread = thread::Builder::new().name("recorder".to_owned()).spawn(move || log.run(&theirs));
        let thread = Some(thread.map_err(|cause| RecordError::Create { path: path.clone(), cause })?);
        Ok(Self { path, queue, thread, begun: (clock::unix_time(), clock::now()) })
    }

    /// Returns the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Records an entry; returns false if the queue is full. Then a sample or a report is counted as dropped, and the
    /// caller counts a value. Never waits.
    pub fn push(&self, entry: Entry) -> bool {
        let (since_1970, since) = self.begun;
        self.queue.push(entry, since_1970 + (clock::now() - since))
    }

    /// Returns whether the record has broken off. Then nothing more is written, and [`Recorder::finish`] returns the reason.
    pub fn has_broken_off(&self) -> bool {
        self.thread.as_ref().is_some_and(JoinHandle::is_finished)
    }

    /// Writes the entries that are still in the queue, and ends the record. Returns its path, and the number of dropped samples and
    /// reports.
    ///
    /// # Errors
    /// Something could not be written, now or earlier. The record is readable up to that point.
    pub fn finish(mut self) -> Result<(PathBuf, u64), RecordError> {
        let path = self.path.clone();
        match self.end() {
            Ok(()) => Ok((path, self.queue.dropped())),
            Err(cause) => Err(RecordError::Write { path, cause }),
        }
    }

    /// Stops the recorder and removes the record. Also removes its folder if nothing else is in it.
    pub fn discard(mut self) {
        let ended = self.end().map_err(|error| reason(&error));
        let removed = fs::remove_file(&self.path).and_then(|()| self.path.parent().map_or(Ok(()), fs::remove_dir));
        if let Err(error) = ended.and(removed.map_err(|error| cause(&error))) {
            tracing::debug!(error, path = %self.path.display(), "the record of a mission that was refused stays");
        }
    }

    fn end(&mut self) -> Result<(), McapError> {
        self.queue.close();
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
            None => Ok(()),
        }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.queue.close();
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// The part of the recorder that writes, on its own thread.
struct Log {
    writer: Writer<NoSeek<Disk>>,
    disk: Disk,
    rows: Rows,
    /// The channel of each topic of `rows`.
    channels: Vec<u16>,
    entries: u64,
    flushed: Option<Duration>,
}

impl Log {
    fn begin(file: File, header: &Header) -> Result<Self, McapError> {
        // Without seeking, each chunk reaches the file in one piece. So the file never ends in a part of a chunk.
        let options = WriteOptions::new().compression(None).disable_seeking(true).profile("dca");
        let disk = Disk::new(file);
        let mut writer = options.create(NoSeek::new(disk.clone()))?;
        let time = nanos(header.started.unwrap_or_default());
        for (name, media_type, data) in header.attachments() {
            let (name, media_type, data) = (name.to_owned(), media_type.to_owned(), data.into());
            writer.attach(&Attachment { log_time: time, create_time: time, name, media_type, data })?;
        }
        let mut log = Self { writer, disk, rows: Rows::default(), channels: Vec::new(), entries: 0, flushed: None };
        log.flush()?;
        Ok(log)
    }

    fn flush(&mut self) -> Result<(), McapError> {
        self.writer.flush()?;
        self.disk.commit()?;
        Ok(())
    }

    fn run(mut self, queue: &Queue) -> Result<(), McapError> {
        let result = self.follow(queue);
        if result.is_err() {
            // Nothing takes entries out of the queue any more.
            queue.close();
        }
        result
    }

    fn follow(&mut self, queue: &Queue) -> Result<(), McapError> {
        loop {
            match queue.pop(FLUSH_EVERY) {
                Work::Entry(entry, arrived) => self.write(&entry, arrived)?,
                Work::Nothing => self.flush()?,
                Work::Closed => {
                    self.writer.finish()?;
                    self.disk.finish()?;
                    return Ok(());
                }
            }
        }
    }

    fn write(&mut self, entry: &Entry, arrived: Duration) -> Result<(), McapError> {
        let Row { topic, at, data } = self.rows.row(entry, arrived);
        for topic in &self.rows.topics()[self.channels.len()..] {
            let (encoding, schema_encoding) = topic.form.encodings();
            let schema = self.writer.add_schema(&topic.schema_name, schema_encoding, &topic.schema)?;
            self.channels.push(self.writer.add_channel(schema, &topic.name, encoding, &topic.metadata)?);
        }
        let log_time = nanos(at);
        let sequence = u32::try_from(self.entries % (u64::from(u32::MAX) + 1)).unwrap_or_default();
        let header = MessageHeader { channel_id: self.channels[topic], sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, &data)?;
        self.entries += 1;
        // The arrival times of entries are enough as a clock. When no entries arrive, the timeout of the queue is the clock.
        if arrived.saturating_sub(*self.flushed.get_or_insert(arrived)) >= FLUSH_EVERY {
            self.flush()?;
            self.flushed = Some(arrived);
        } else if self.disk.is_full() {
            self.disk.commit()?;
        }
        Ok(())
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests;
