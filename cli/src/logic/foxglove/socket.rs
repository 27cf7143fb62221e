//! A WebSocket without a socket: bytes go in, messages come out, and the other way round.
//!
//! The library reads and writes a buffer here, so the rules for frames are tested without a network, and the driver decides how
//! much waits. Source: RFC 6455.

use super::outbox::Frame;
use std::io::{self, Read, Write};
use tungstenite::protocol::frame::CloseFrame;
use tungstenite::protocol::frame::coding::CloseCode;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

/// The longest message of a client, in bytes. An argument of a call is the longest that makes sense.
pub(super) const MESSAGE_SIZE_MAX: usize = 1 << 20;

/// The end of a connection: the client has closed it, or has broken a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ended;

/// Bytes that have come and were not read, and bytes that are to be sent.
#[derive(Debug, Default)]
struct Buffers {
    come: Vec<u8>,
    read: usize,
    leaving: Vec<u8>,
}

/// The server's end of a WebSocket.
#[derive(Debug)]
pub(crate) struct Socket {
    inner: WebSocket<Buffers>,
}

impl Read for Buffers {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let rest = &self.come[self.read..];
        if rest.is_empty() {
            self.come.clear();
            self.read = 0;
            return Err(io::ErrorKind::WouldBlock.into());
        }
        let count = rest.len().min(into.len());
        into[..count].copy_from_slice(&rest[..count]);
        self.read += count;
        Ok(count)
    }
}

impl Write for Buffers {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.leaving.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Socket {
    /// Begins behind the handshake.
    pub(crate) fn new() -> Self {
        let limits = WebSocketConfig::default()
            .read_buffer_size(16 << 10)
            .max_message_size(Some(MESSAGE_SIZE_MAX))
            .max_frame_size(Some(MESSAGE_SIZE_MAX));
        Self { inner: WebSocket::from_raw_socket(Buffers::default(), Role::Server, Some(limits)) }
    }

    /// Takes bytes in; calls `take` with each message that they complete.
    ///
    /// # Errors
    /// When the connection ends. [`Socket::leaving`] may still have the reason for the client.
    pub(crate) fn take(&mut self, bytes: &[u8], mut take: impl FnMut(Frame)) -> Result<(), Ended> {
        self.inner.get_mut().come.extend(bytes);
        loop {
            match self.inner.read() {
                Ok(Message::Text(text)) => take(Frame::Text(text.as_str().to_owned())),
                Ok(Message::Binary(bytes)) => take(Frame::Binary(bytes.to_vec())),
                // The library answers pings and closes by itself.
                Ok(Message::Ping(_) | Message::Pong(_) | Message::Close(_) | Message::Frame(_)) => {}
                Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) => {
                    self.refuse(&error);
                    return Err(Ended);
                }
            }
        }
        self.inner.flush().map_err(|_closed| Ended)
    }

    /// Adds a message to the bytes that are to be sent.
    ///
    /// # Errors
    /// When the connection has ended.
    pub(crate) fn put(&mut self, frame: Frame) -> Result<(), Ended> {
        let message = match frame {
            Frame::Text(text) => Message::text(text),
            Frame::Binary(bytes) => Message::binary(bytes),
        };
        self.inner.send(message).map_err(|_closed| Ended)
    }

    /// Adds a ping, which a living client answers.
    pub(crate) fn ping(&mut self) -> Result<(), Ended> {
        self.inner.send(Message::Ping(Vec::new().into())).map_err(|_closed| Ended)
    }

    /// Adds the end, with a reason of at most 100 bytes.
    pub(crate) fn close(&mut self, reason: &'static str) {
        let frame = CloseFrame { code: CloseCode::Again, reason: reason.into() };
        // A connection that has ended needs no end.
        self.inner.close(Some(frame)).unwrap_or_default();
        self.inner.flush().unwrap_or_default();
    }

    /// Returns the bytes that are to be sent; the caller takes out those that it has sent.
    pub(crate) fn leaving(&mut self) -> &mut Vec<u8> {
        &mut self.inner.get_mut().leaving
    }

    fn refuse(&mut self, error: &Error) {
        if matches!(error, Error::Capacity(_)) {
            let frame = CloseFrame { code: CloseCode::Size, reason: "a message may have 1 MiB".into() };
            self.inner.close(Some(frame)).unwrap_or_default();
            self.inner.flush().unwrap_or_default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    /// Returns a frame of a client.
    fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
        let mask = [1, 2, 3, 4];
        let length = match payload.len() {
            short @ 0..126 => vec![0x80 | u8::try_from(short).unwrap()],
            middle @ 126..65_536 => [&[0xfe][..], &u16::try_from(middle).unwrap().to_be_bytes()].concat(),
            long => [&[0xff][..], &u64::try_from(long).unwrap().to_be_bytes()].concat(),
        };
        let masked = payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask);
        [&[first][..], &length, &mask].concat().into_iter().chain(masked).collect()
    }

    fn taken(bytes: &[u8], step: usize) -> (Vec<Frame>, Result<(), Ended>, Vec<u8>) {
        let (mut socket, mut frames) = (Socket::new(), Vec::new());
        let mut result = Ok(());
        for piece in bytes.chunks(step) {
            result = result.and_then(|()| socket.take(piece, |frame| frames.push(frame)));
        }
        (frames, result, std::mem::take(socket.leaving()))
    }

    #[test]
    fn messages_come_out_whatever_pieces_their_bytes_come_in() {
        let long = "x".repeat(70_000);
        let bytes = [
            frame(0x81, b"one"),
            frame(0x01, b"tw"),
            // A ping may come between two fragments.
            frame(0x89, b"p"),
            frame(0x80, b"o"),
            frame(0x82, long.as_bytes()),
        ]
        .concat();
        let text = |text: &str| Frame::Text(text.to_owned());
        let expected = vec![text("one"), text("two"), Frame::Binary(long.into_bytes())];
        for step in [1, 3, 1000, 100_000] {
            assert_eq!(taken(&bytes, step), (expected.clone(), Ok(()), vec![0x8a, 1, b'p']), "{step}");
        }
    }

    #[test]
    fn a_client_that_breaks_a_rule_is_cut_off() {
        let unmasked = [0x81, 1, b'a'].to_vec();
        let huge = [&[0x82, 0xff][..], &u64::MAX.to_be_bytes(), &[0; 4]].concat();
        let too_long = frame(0x82, &vec![0; MESSAGE_SIZE_MAX + 1]);
        let fragments: Vec<u8> =
            std::iter::once(frame(0x02, &[0; 1000])).chain((0..1100).map(|_| frame(0, &[0; 1000]))).flatten().collect();
        let not_text = frame(0x81, &[0xff]);
        let reserved = frame(0xc1, b"a");
        let long_ping = frame(0x89, &[0; 200]);
        let without_begin = frame(0x80, b"a");
        let close = frame(0x88, &[3, 232]);
        for (name, bytes) in [
            ("unmasked", unmasked),
            ("huge", huge),
            ("too long", too_long),
            ("fragments", fragments),
            ("not text", not_text),
            ("reserved", reserved),
            ("long ping", long_ping),
            ("without begin", without_begin),
            ("close", close),
        ] {
            let (frames, result, _) = taken(&bytes, 4096);
            assert_eq!((frames, result), (vec![], Err(Ended)), "{name}");
        }
    }

    #[test]
    fn garbage_never_grows_and_never_panics() {
        for seed in 0..100 {
            let mut random = Random::new(seed);
            let (mut socket, mut heard) = (Socket::new(), 0);
            for _ in 0..64 {
                let bytes: Vec<u8> = (0..1024).map(|_| random.next().to_be_bytes()[0]).collect();
                if socket.take(&bytes, |_| heard += 1).is_err() {
                    break;
                }
            }
            assert!(socket.leaving().len() < 1 << 20 && heard < 70_000);
        }
    }

    #[test]
    fn messages_are_framed_for_the_client() {
        let mut socket = Socket::new();
        socket.put(Frame::Text("a".to_owned())).unwrap();
        socket.put(Frame::Binary(vec![0; 200])).unwrap();
        assert_eq!(&socket.leaving()[..7], [0x81, 1, b'a', 0x82, 126, 0, 200]);
        socket.leaving().clear();
        socket.close("enough");
        assert_eq!(&socket.leaving()[..4], [0x88, 8, 0x03, 0xf5]);
        assert_eq!(socket.put(Frame::Binary(vec![])), Err(Ended));
    }
}
