//! Shared memory without DCA. Each side has a buffer that the other side reads, and a Unix socket announces the
//! content.

use crate::raw::{obey, ready};
use anyhow::{Context, ensure};
use comms::io::clock::now;
use comms::io::direct::memory::{Buffer, Mapping};
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage, SendFlags,
    recvmsg, sendmsg,
};
use std::io::{IoSlice, IoSliceMut, Read, Write};
use std::mem::MaybeUninit;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;

/// The longest message.
const SIZE_MAX: usize = 16 << 20;

/// One side: the buffer that it fills, the buffer that the other side fills, and the socket for announcements.
struct Side {
    own: Buffer,
    other: Mapping,
    stream: UnixStream,
}

impl Side {
    fn new(stream: UnixStream) -> anyhow::Result<Self> {
        let own = Buffer::new(SIZE_MAX)?;
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let (mut control, files) = (SendAncillaryBuffer::new(&mut space), [own.file()]);
        control.push(SendAncillaryMessage::ScmRights(&files));
        sendmsg(&stream, &[IoSlice::new(b"f")], &mut control, SendFlags::empty())?;
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut control = RecvAncillaryBuffer::new(&mut space);
        let (mut byte, mut file) = ([0], None);
        recvmsg(&stream, &mut [IoSliceMut::new(&mut byte)], &mut control, RecvFlags::CMSG_CLOEXEC)?;
        for message in control.drain() {
            if let RecvAncillaryMessage::ScmRights(files) = message {
                file = files.last();
            }
        }
        let other = Mapping::of(&file.context("no file has come")?)?;
        Ok(Self { own, other, stream })
    }

    fn send(&mut self, bytes: &[u8]) -> anyhow::Result<()> {
        ensure!(self.own.write(bytes), "the message is too long");
        Ok(self.stream.write_all(&u32::try_from(bytes.len())?.to_le_bytes())?)
    }

    /// Returns the next message, or none at the end.
    fn receive(&mut self) -> anyhow::Result<Option<Vec<u8>>> {
        let mut size = [0; 4];
        if self.stream.read(&mut size)? == 0 {
            return Ok(None);
        }
        self.other.read(u32::from_le_bytes(size) as usize).context("the message is too long").map(Some)
    }
}

pub(crate) fn echo(path: &Path) -> anyhow::Result<()> {
    let listener = UnixListener::bind(path)?;
    ready()?;
    let mut side = Side::new(listener.accept()?.0)?;
    while let Some(bytes) = side.receive()? {
        side.send(&bytes)?;
    }
    Ok(())
}

pub(crate) fn ping(path: &Path) -> anyhow::Result<()> {
    let mut side = Side::new(UnixStream::connect(path)?)?;
    let mut bytes = Vec::new();
    obey(|size| {
        bytes.resize(size, 1);
        let sent = now();
        side.send(&bytes)?;
        bytes = side.receive()?.context("the other side has ended")?;
        Ok(now().since(sent))
    })
}
