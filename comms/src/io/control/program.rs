//! The program's end of the control channel. Reading an order blocks. Sending a notice never blocks.

use super::{ControlError, Outbox, READ_SIZE, check_user, is_gone, not_yet};
use crate::io::clock::now;
use crate::logic::codec::{self, Enveloped};
use crate::logic::control::{Notice, Order};
use crate::logic::frame::{self, Decoder};
use crate::logic::time::Time;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout, socket_peercred};
use rustix::net::{AddressFamily, Shutdown, SocketAddrUnix, SocketFlags, SocketType, shutdown, socket_with};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zeroize::Zeroizing;

/// How long a node may leave notices unread.
const WRITE_WITHIN: Duration = Duration::from_secs(2);

/// Sends notices to the node. Clones share one channel.
#[derive(Clone, Debug)]
pub struct NoticeSender {
    channel: Arc<Channel>,
}

/// Receives the node's orders, and writes what [`NoticeSender`] could not write at once. The channel closes when it is
/// dropped.
#[derive(Debug)]
pub struct OrderReceiver {
    channel: Arc<Channel>,
    decoder: Decoder,
    /// The time at which the node is treated as stuck, if it does not read the sent data before.
    stuck_at: Option<Time>,
}

/// The result of a wait for an order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Received {
    /// An order of the node.
    Order(Order),
    /// No order came in the given time.
    Nothing,
    /// The node has closed its side.
    Ended,
}

#[derive(Debug)]
struct Channel {
    /// Never blocks.
    stream: UnixStream,
    outbox: Mutex<Outbox>,
    /// Readable once a message waits in the outbox.
    filled: OwnedFd,
}

/// Connects a program to its node, which has `within` to accept the connection. While a node is suspended, the system
/// still accepts connections for it, up to the backlog.
///
/// # Errors
/// If no process listens on `path`, the listening process does not answer in time, or it belongs to another user.
pub fn connect(path: &Path, within: Duration) -> Result<(NoticeSender, OrderReceiver), ControlError> {
    let failed = |cause: Errno| ControlError::Connect { path: path.to_owned(), cause: cause.into() };
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC, None).map_err(failed)?;
    set_socket_timeout(&socket, Timeout::Send, Some(within)).map_err(failed)?;
    let address = SocketAddrUnix::new(path).map_err(failed)?;
    rustix::net::connect(&socket, &address).map_err(failed)?;
    let stream = UnixStream::from(socket);
    stream.set_nonblocking(true)?;
    let node = socket_peercred(&stream).map_err(io::Error::from)?.uid;
    // Root can do anything to the program, and starts programs as other users.
    if !node.is_root() {
        check_user(node.as_raw())?;
    }
    let filled = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK).map_err(io::Error::from)?;
    let channel = Arc::new(Channel { stream, outbox: Outbox::new(), filled });
    let sender = NoticeSender { channel: Arc::clone(&channel) };
    Ok((sender, OrderReceiver { channel, decoder: Decoder::new(Order::SIZE_MAX), stuck_at: None }))
}

/// Returns the frame of a notice, ready to be sent.
///
/// # Errors
/// If it is too long.
pub fn notice_frame(notice: &Notice) -> Result<Vec<u8>, ControlError> {
    Ok(frame::encode(&codec::encode(notice)?, Notice::SIZE_MAX)?)
}

impl NoticeSender {
    /// Sends a notice. It is written at once; bytes that the socket does not take are sent while
    /// [`OrderReceiver::recv`] waits.
    ///
    /// # Errors
    /// If the notice is too long, or 256 notices already wait. A node that has ended is not an error here:
    /// [`OrderReceiver::recv`] reports the end.
    pub fn send(&self, notice: &Notice) -> Result<(), ControlError> {
        self.send_frame(notice_frame(notice)?)
    }

    /// Sends a frame that [`notice_frame`] has returned, like [`NoticeSender::send`].
    ///
    /// # Errors
    /// If 256 notices already wait.
    pub fn send_frame(&self, frame: Vec<u8>) -> Result<(), ControlError> {
        if !Outbox::send(&self.channel.outbox, Zeroizing::new(frame), &self.channel.stream)? {
            // The write fails only when the counter overflows, after an endless number of unread writes.
            rustix::io::write(&self.channel.filled, &1_u64.to_ne_bytes()).unwrap_or_default();
        }
        Ok(())
    }

    /// Waits until everything is written; at most 2 s, or until the channel breaks.
    pub fn flush(&self) {
        let until = now() + WRITE_WITHIN;
        let stream = &self.channel.stream;
        while matches!(Outbox::lock(&self.channel.outbox).write(stream), Ok(false)) && now() < until {
            if wait(&mut [PollFd::new(stream, PollFlags::OUT)], Some(until)).is_err() {
                return;
            }
        }
    }

    /// Closes the channel. Its receiver still gets the messages that have arrived, and then the end.
    pub fn close(&self) {
        shutdown(&self.channel.stream, Shutdown::Both).unwrap_or_default();
    }
}

impl OrderReceiver {
    /// Waits for the next order; none once the node has closed its side.
    ///
    /// # Errors
    /// If the channel breaks, the node breaks the protocol, or the node has read nothing for 2 s although messages
    /// wait. The channel cannot be used afterwards.
    pub fn recv(&mut self) -> Result<Option<Order>, ControlError> {
        loop {
            match self.recv_until(None)? {
                Received::Order(order) => return Ok(Some(order)),
                Received::Ended => return Ok(None),
                Received::Nothing => {}
            }
        }
    }

    /// Waits for the next order until `until`; without a time, for ever.
    ///
    /// # Errors
    /// The errors of [`OrderReceiver::recv`].
    pub fn recv_until(&mut self, until: Option<Time>) -> Result<Received, ControlError> {
        loop {
            if let Some(body) = self.decoder.next_frame()? {
                return Ok(Received::Order(codec::decode(&body)?));
            }
            let is_written = Outbox::lock(&self.channel.outbox).is_empty();
            self.stuck_at = if is_written { None } else { self.stuck_at.or_else(|| Some(now() + WRITE_WITHIN)) };
            if self.stuck_at.is_some_and(|at| at <= now()) {
                return Err(io::Error::from(io::ErrorKind::TimedOut).into());
            }
            // A blocking read would also wake whenever the node takes a notice.
            let flags = if is_written { PollFlags::IN } else { PollFlags::IN | PollFlags::OUT };
            let channel = &*self.channel;
            let mut ready = [PollFd::new(&channel.stream, flags), PollFd::new(&channel.filled, PollFlags::IN)];
            wait(&mut ready, until.into_iter().chain(self.stuck_at).min())?;
            let [stream, filled] = ready.map(|one| one.revents());
            if !filled.is_empty() {
                // After an error here, the descriptor is also no longer readable.
                rustix::io::read(&channel.filled, &mut [0; 8]).unwrap_or_default();
            }
            if stream.contains(PollFlags::OUT) {
                self.stuck_at = None;
                Outbox::lock(&channel.outbox).write(&channel.stream)?;
            }
            if stream.intersects(PollFlags::IN | PollFlags::HUP | PollFlags::ERR) {
                if self.read()? == Some(0) {
                    return self.end();
                }
            } else if until.is_some_and(|until| until <= now()) {
                return Ok(Received::Nothing);
            }
        }
    }

    /// Reads the bytes that have arrived; returns their number, or none if nothing had arrived after all.
    fn read(&mut self) -> io::Result<Option<usize>> {
        let mut bytes = [0; READ_SIZE];
        let read = match not_yet((&self.channel.stream).read(&mut bytes)) {
            Err(cause) if is_gone(&cause) => Some(0),
            read => read?,
        };
        self.decoder.push(&bytes[..read.unwrap_or(0)]);
        Ok(read)
    }

    fn end(&self) -> Result<Received, ControlError> {
        if self.decoder.is_between_frames() {
            Ok(Received::Ended)
        } else {
            Err(io::Error::from(io::ErrorKind::UnexpectedEof).into())
        }
    }
}

impl Drop for OrderReceiver {
    fn drop(&mut self) {
        // The senders share the socket, so it has to be closed for the node to notice that the receiver is gone.
        shutdown(&self.channel.stream, Shutdown::Both).unwrap_or_default();
    }
}

/// Waits until one of the descriptors is ready, or until `until`; without a time, for ever.
fn wait(ready: &mut [PollFd<'_>], until: Option<Time>) -> io::Result<()> {
    let left = until.map(|until| {
        let left = until.since(now());
        Timespec { tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX), tv_nsec: left.subsec_nanos().into() }
    });
    match poll(ready, left.as_ref()) {
        Err(Errno::INTR) => Ok(()),
        waited => Ok(waited.map(drop)?),
    }
}
