//! Packets on a Unix socket, with at most one descriptor each. Nothing here waits longer than the timeout of the
//! socket.

use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage, SendFlags,
    recvmsg, sendmsg,
};
use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

/// Whether a call waits for the other side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Waits {
    /// The call does not wait: it fails with `EAGAIN` instead.
    Never,
    /// The call waits for at most the timeout of the socket.
    UntilTimeout,
}

/// The result of sending a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sent {
    /// The packet was sent, and waits for the other side to read it.
    Whole,
    /// The socket has no room for it, or the system has no memory.
    NoRoom,
    /// The other side has ended.
    Gone,
}

/// Sends a packet in pieces; it never waits.
pub(super) fn send(socket: impl AsFd, pieces: &[&[u8]], file: Option<BorrowedFd<'_>>) -> Sent {
    match send_waiting(socket, pieces, file, Waits::Never) {
        Ok(()) => Sent::Whole,
        Err(Errno::PIPE | Errno::CONNRESET | Errno::NOTCONN | Errno::BADF | Errno::CONNREFUSED) => Sent::Gone,
        Err(_no_room) => Sent::NoRoom,
    }
}

/// Sends a packet in pieces.
pub(super) fn send_waiting(
    socket: impl AsFd,
    pieces: &[&[u8]],
    file: Option<BorrowedFd<'_>>,
    waits: Waits,
) -> Result<(), Errno> {
    let slices = [0, 1].map(|at| IoSlice::new(pieces.get(at).copied().unwrap_or_default()));
    let files = file.map(|file| [file]);
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    if let Some(files) = &files {
        control.push(SendAncillaryMessage::ScmRights(files));
    }
    let flags = if waits == Waits::Never { SendFlags::NOSIGNAL | SendFlags::DONTWAIT } else { SendFlags::NOSIGNAL };
    loop {
        match sendmsg(&socket, &slices[..pieces.len().min(2)], &mut control, flags) {
            Err(Errno::INTR) => {}
            sent => return sent.map(drop),
        }
    }
}

/// Receives a packet. Returns its length, which is 0 at the end, and the descriptor that came with it.
pub(super) fn receive(socket: impl AsFd, buffer: &mut [u8], waits: Waits) -> Result<(usize, Option<OwnedFd>), Errno> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    let nothing = if waits == Waits::Never { RecvFlags::DONTWAIT } else { RecvFlags::empty() };
    let received = loop {
        match recvmsg(&socket, &mut [IoSliceMut::new(buffer)], &mut control, RecvFlags::CMSG_CLOEXEC | nothing) {
            Err(Errno::INTR) => {}
            received => break received?,
        }
    };
    let mut file = None;
    for message in control.drain() {
        if let RecvAncillaryMessage::ScmRights(files) = message {
            file = files.last();
        }
    }
    Ok((received.bytes, file))
}
