//! The control channel between a node and the programs on its host: frames of envelopes on a Unix socket.
//!
//! The node's side is asynchronous, the program's side blocks. Both refuse a peer that runs as another user. There are
//! two exceptions: a node accepts the user that it starts programs as, and a program accepts root.

mod program;

pub use program::{NoticeSender, OrderReceiver, Received, connect, notice_frame};

use crate::logic::codec::{self, CodecError, Enveloped, WIRE_VERSION};
use crate::logic::control::{Notice, Order};
use crate::logic::frame::{self, Decoder, FrameError};
use crate::logic::port::{Policy, Pushed, Queue};
use rustix::net::{Shutdown, shutdown};
use std::io::{self, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use thiserror::Error;
use tokio::io::Interest;
use tokio::io::unix::{AsyncFd, AsyncFdReadyGuard};
use tokio::net::UnixListener;
use tokio::sync::Notify;
use zeroize::Zeroizing;

/// The most orders that the program has not taken yet, or notices that the node has not taken yet.
const FRAMES_MAX: usize = 256;
/// How much is read at once.
const READ_SIZE: usize = 16 << 10;

/// Why a control channel cannot be used any more.
#[derive(Debug, Error)]
pub enum ControlError {
    /// The socket cannot be made.
    #[error("cannot listen on `{path}`: {cause}")]
    Bind {
        /// The path.
        path: PathBuf,
        /// The system's words.
        cause: io::Error,
    },
    /// No process listens.
    #[error("no node listens on `{path}`: {cause}")]
    Connect {
        /// The path.
        path: PathBuf,
        /// The system's words.
        cause: io::Error,
    },
    /// The other side belongs to another user.
    #[error("the other side runs as user {uid}, not as the user of this program")]
    Stranger {
        /// Its user id.
        uid: u32,
    },
    /// Reading or writing failed.
    #[error("the control channel broke: {0}")]
    Broken(#[from] io::Error),
    /// The other side breaks the protocol.
    #[error("the other side of the control channel: {0}")]
    Frame(#[from] FrameError),
    /// The other side breaks the protocol.
    #[error("the other side of the control channel: {0}")]
    Codec(CodecError),
    /// The other side was built with another version of DCA.
    #[error(
        "the other side speaks version {found} of the control protocol, this one version {WIRE_VERSION}; build the controller \
         again with the library of its node's DCA"
    )]
    Version {
        /// Of the other side.
        found: u16,
    },
    /// The other side does not read.
    #[error("the other side of the control channel does not read: {FRAMES_MAX} messages are waiting")]
    Stuck,
}

impl From<CodecError> for ControlError {
    fn from(error: CodecError) -> Self {
        if let CodecError::Version { found, .. } = error { Self::Version { found } } else { Self::Codec(error) }
    }
}

/// A node's control socket. Its file remains when the listener is dropped; the next [`Self::bind`] replaces it.
#[derive(Debug)]
pub struct Listener {
    listener: UnixListener,
    /// Another user who may connect.
    user: Option<u32>,
}

/// Sends orders to one program.
#[derive(Clone, Debug)]
pub struct ControlSender {
    channel: Arc<Channel>,
}

/// Receives the notices of one program, and writes what its [`ControlSender`] could not write at once. The channel closes
/// when it is dropped.
#[derive(Debug)]
pub struct ControlReceiver {
    channel: Arc<Channel>,
    decoder: Decoder,
    /// A second descriptor of the channel's socket, while the socket has no room for more bytes.
    full: Option<AsyncFd<UnixStream>>,
}

#[derive(Debug)]
struct Channel {
    /// Registered only for reading: with a registration for writing, each read of the other side would wake a task.
    stream: AsyncFd<UnixStream>,
    outbox: Mutex<Outbox>,
    filled: Notify,
}

/// The bytes that the socket has not taken yet.
#[derive(Debug)]
struct Outbox {
    frames: Queue<Zeroizing<Vec<u8>>>,
    /// A frame on its way out, and how much of it is written.
    writing: (Zeroizing<Vec<u8>>, usize),
}

impl Listener {
    /// Listens on `path`, and replaces an earlier listener. Only this user can connect.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn bind(path: &Path) -> Result<Self, ControlError> {
        let failed = |cause| ControlError::Bind { path: path.to_owned(), cause };
        match std::fs::remove_file(path) {
            Err(cause) if cause.kind() != io::ErrorKind::NotFound => return Err(failed(cause)),
            Ok(()) | Err(_) => {}
        }
        let listener = UnixListener::bind(path).map_err(failed)?;
        // Before this line, only the directory's mode and the user check keep other users out.
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)).map_err(failed)?;
        Ok(Self { listener, user: None })
    }

    /// Listens like [`Self::bind`], for programs that run as another user: that user can connect as well.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn bind_for(path: &Path, uid: u32, gid: u32) -> Result<Self, ControlError> {
        let bound = Self::bind(path)?;
        let given = std::os::unix::fs::chown(path, Some(uid), Some(gid));
        given.map_err(|cause| ControlError::Bind { path: path.to_owned(), cause })?;
        Ok(Self { user: Some(uid), ..bound })
    }

    /// Waits for the next program.
    ///
    /// # Errors
    /// If the system refuses, or a process of another user connects. The listener can still accept after an error.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn accept(&self) -> Result<(ControlSender, ControlReceiver), ControlError> {
        let (stream, _) = self.listener.accept().await?;
        let uid = stream.peer_cred()?.uid();
        if self.user != Some(uid) {
            check_user(uid)?;
        }
        let stream = register(stream.into_std()?, Interest::READABLE)?;
        let channel = Arc::new(Channel { stream, outbox: Outbox::new(), filled: Notify::new() });
        let sender = ControlSender { channel: Arc::clone(&channel) };
        Ok((sender, ControlReceiver { channel, decoder: Decoder::new(Notice::SIZE_MAX), full: None }))
    }
}

impl ControlSender {
    /// Sends an order. It is written at once: a hand-over to another task would cost as much as the way to the program.
    /// Bytes that the socket does not take are sent while [`ControlReceiver::recv`] is awaited.
    ///
    /// # Errors
    /// If the order is too long, or 256 orders already wait. An order to a program that has ended is not an error here:
    /// [`ControlReceiver::recv`] reports the end.
    pub fn send(&self, order: &Order) -> Result<(), ControlError> {
        // An order may hold a secret, and no copy of the secret may stay in memory.
        let body = Zeroizing::new(codec::encode_in(order, Vec::with_capacity(room_for(order)))?);
        let frame = Zeroizing::new(frame::encode(&body, Order::SIZE_MAX)?);
        let is_written = Outbox::send(&self.channel.outbox, frame, self.channel.stream.get_ref())?;
        // The receiver writes the rest. If the channel is broken, the receiver reports the reason.
        if !is_written {
            self.channel.filled.notify_one();
        }
        Ok(())
    }
}

impl ControlReceiver {
    /// Returns the next notice; none once the program has closed its side. From a program of another version, it returns
    /// [`Notice::Hello`] with only the version and the instance.
    ///
    /// # Errors
    /// If the channel breaks or the program breaks the protocol. The channel cannot be used afterwards.
    ///
    /// # Cancellation
    /// Safe: no byte is lost, read or written.
    pub async fn recv(&mut self) -> Result<Option<Notice>, ControlError> {
        loop {
            if let Some(body) = self.decoder.next_frame()? {
                return Ok(Some(codec::decode_notice(&body)?));
            }
            let stream = self.channel.stream.get_ref();
            if self.channel.outbox().is_empty() {
                self.full = None;
            } else if self.full.is_none() {
                self.full = Some(register(stream.try_clone()?, Interest::WRITABLE)?);
            }
            tokio::select! {
                ready = self.channel.stream.readable() => {
                    if read_some(ready?, &mut self.decoder)? == Some(0) {
                        return self.end();
                    }
                }
                ready = writable(self.full.as_ref()) => {
                    let mut ready = ready?;
                    if !self.channel.outbox().write(stream)? {
                        ready.clear_ready();
                    }
                }
                () = self.channel.filled.notified(), if self.full.is_none() => {}
            }
        }
    }

    fn end(&self) -> Result<Option<Notice>, ControlError> {
        if self.decoder.is_between_frames() {
            Ok(None)
        } else {
            Err(io::Error::from(io::ErrorKind::UnexpectedEof).into())
        }
    }
}

impl Drop for ControlReceiver {
    fn drop(&mut self) {
        // The senders share the socket, so it has to be closed for the program to notice that the receiver is gone.
        shutdown(self.channel.stream.get_ref(), Shutdown::Both).unwrap_or_default();
    }
}

impl Channel {
    fn outbox(&self) -> MutexGuard<'_, Outbox> {
        Outbox::lock(&self.outbox)
    }
}

impl Outbox {
    fn new() -> Mutex<Self> {
        Mutex::new(Self { frames: Queue::new(Policy::reject(FRAMES_MAX)), writing: (Zeroizing::default(), 0) })
    }

    fn lock(outbox: &Mutex<Self>) -> MutexGuard<'_, Self> {
        // Nothing in a critical section of this file can panic.
        outbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a frame, and writes as much as the socket takes at once. Returns whether everything is written, so that the
    /// receiver has nothing to do.
    fn send(outbox: &Mutex<Self>, frame: Zeroizing<Vec<u8>>, stream: &UnixStream) -> Result<bool, ControlError> {
        let mut outbox = Self::lock(outbox);
        let pushed = outbox.frames.push(frame);
        let written = outbox.write(stream);
        match pushed {
            Pushed::Stored | Pushed::Replaced(_) => Ok(matches!(written, Ok(true))),
            Pushed::Rejected(_) => Err(ControlError::Stuck),
        }
    }

    fn is_empty(&self) -> bool {
        self.frames.is_empty() && self.writing.0.len() == self.writing.1
    }

    /// Writes as much as the socket takes; returns whether that was everything.
    fn write(&mut self, mut stream: &UnixStream) -> io::Result<bool> {
        loop {
            if self.writing.1 == self.writing.0.len() {
                // This wipes the previous frame.
                self.writing = (Zeroizing::default(), 0);
                let Some(next) = self.frames.pop() else { return Ok(true) };
                self.writing = (next, 0);
            }
            let (frame, done) = &mut self.writing;
            match not_yet(stream.write(&frame[*done..])) {
                Ok(Some(written)) => *done += written,
                Ok(None) => return Ok(false),
                // A program that ends reads nothing more, but may have sent notices before. The node still reads these
                // notices.
                Err(cause) if is_gone(&cause) => *done = frame.len(),
                Err(cause) => return Err(cause),
            }
        }
    }
}

#[expect(unsafe_code, reason = "tokio cannot know of every type that it keeps its descriptor")]
fn register(stream: UnixStream, interest: Interest) -> io::Result<AsyncFd<UnixStream>> {
    // SAFETY: a stream owns its descriptor, which is open and the same one until the stream is dropped.
    Ok(unsafe { AsyncFd::register_with_interest(stream, interest) }?)
}

/// Waits until a socket takes more; for ever without a socket.
async fn writable(full: Option<&AsyncFd<UnixStream>>) -> io::Result<AsyncFdReadyGuard<'_, UnixStream>> {
    match full {
        Some(stream) => stream.writable().await,
        None => std::future::pending().await,
    }
}

/// Reads the bytes that have arrived; returns their number, or none if nothing had arrived after all.
fn read_some(mut ready: AsyncFdReadyGuard<'_, UnixStream>, decoder: &mut Decoder) -> io::Result<Option<usize>> {
    let mut bytes = [0; READ_SIZE];
    let read = match not_yet(ready.get_inner().read(&mut bytes)) {
        Err(cause) if is_gone(&cause) => Some(0),
        read => read?,
    };
    // The read did not fill the buffer, so the socket is empty.
    if read.is_none_or(|read| read < READ_SIZE) {
        ready.clear_ready();
    }
    decoder.push(&bytes[..read.unwrap_or(0)]);
    Ok(read)
}

/// Returns how much room an order with a secret needs. A buffer that grows would leave copies of the secret in memory.
fn room_for(order: &Order) -> usize {
    const ROOM: usize = 64;
    if let Order::Secret { parameter, value } = order {
        2 * ROOM + parameter.len() + value.expose().len()
    } else {
        ROOM
    }
}

fn check_user(uid: u32) -> Result<(), ControlError> {
    if uid == rustix::process::geteuid().as_raw() { Ok(()) } else { Err(ControlError::Stranger { uid }) }
}

/// Returns whether the other side has closed. A side that closes before it has read everything resets the connection.
fn is_gone(cause: &io::Error) -> bool {
    matches!(cause.kind(), io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset)
}

fn not_yet(done: io::Result<usize>) -> io::Result<Option<usize>> {
    match done {
        Ok(count) => Ok(Some(count)),
        Err(cause) if cause.kind() == io::ErrorKind::WouldBlock => Ok(None),
        Err(cause) => Err(cause),
    }
}

#[cfg(test)]
mod tests;
