//! The direct path of a wire between two programs of one host: the messages over its Unix socket. Zenoh is not involved.
//!
//! The producer listens beside its data session, and publishes the address with the locators of that session ([`Place`]). The node
//! gives these locators only to programs that are wired to the producer. For each wire, the consumer connects a separate socket of
//! type `SOCK_SEQPACKET`, so each frame is one packet, and presents the token of the place ([`Hello`]). After the [`Welcome`], values
//! and boundaries are sent in frames:
//!
//! ```text
//! producer to consumer                                                     consumer to producer
//!   value    00 | header | bytes                                             release  10 | buffer: u32 LE
//!   word     01 | header | Boundary in its envelope
//!   shared   02 | header | buffer: u32 LE | size: u32 LE, and a descriptor if the buffer is new
//!   retired  03 | buffer: u32 LE
//!
//! header: life: u32 LE | number: u32 LE | order: u64 LE
//! ```
//!
//! In a team each end first proves that it is an end of this wire: [`Challenge`], [`Claim`] and [`Confirmation`] follow the
//! [`Hello`], before any value.
//!
//! A *life* is the time in which one producer's end of the wire exists: value numbers begin again with each life. The *order* numbers
//! all messages of a producer over all its wires. So a consumer with several of these wires takes the messages in the order of
//! sending. A shared value lies in a buffer of memory that both programs map. The producer writes there again once all its consumers
//! have released the buffer.

use super::codec::{Enveloped, Kind};
use super::object::TypeForm;
use serde::{Deserialize, Serialize};

/// The beginning of the locator of a direct path. No locator of zenoh begins like this.
const SCHEME: &str = "dca-direct/";
/// The length of the header before a value or a boundary, in bytes.
pub const HEADER_SIZE: usize = 17;
/// The longest frame with a value, in bytes. Longer values lie in shared memory.
pub const INLINE_MAX: usize = 16 << 10;

const VALUE: u8 = 0x00;
const WORD: u8 = 0x01;
const SHARED: u8 = 0x02;
const RETIRED: u8 = 0x03;
const RELEASE: u8 = 0x10;

/// The address where a producer accepts consumers on its host, and the token that a consumer presents there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The socket.
    pub path: String,
    /// The token. Only the producer, its node, and the programs wired to the producer know it.
    pub token: String,
}

impl Place {
    /// Returns the place as a locator.
    pub fn locator(&self) -> String {
        format!("{SCHEME}{}#{}", self.path, self.token)
    }

    /// Returns the place in a locator; none if it is a locator of zenoh.
    pub fn of(locator: &str) -> Option<Self> {
        let (path, token) = locator.strip_prefix(SCHEME)?.rsplit_once('#')?;
        Some(Self { path: path.to_owned(), token: token.to_owned() })
    }

    /// Returns whether a locator belongs to a direct path.
    pub fn is_meant(locator: &str) -> bool {
        locator.starts_with(SCHEME)
    }
}

/// The first packet of a consumer. It carries an eventfd, by which the producer asks the consumer to read waiting packets. In a team
/// the [`Claim`] carries the eventfd.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// The token of the [`Place`].
    pub token: String,
    /// The key of the wire, from the node's order.
    pub key: String,
    /// The consumer's type.
    pub form: TypeForm,
}

impl Enveloped for Hello {
    const KIND: Kind = Kind::DirectHello;
    const SIZE_MAX: usize = 64 << 10;
}

/// The answer to a [`Hello`]. A producer that does not accept the consumer closes the socket instead.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// A random number that is the same for all wires of one producer.
    pub process: u128,
}

impl Enveloped for Welcome {
    const KIND: Kind = Kind::DirectWelcome;
    const SIZE_MAX: usize = 1 << 10;
}

/// Random bytes that were never used before.
pub type Nonce = [u8; 32];

/// The answer to a [`Hello`] in a team. The consumer has to prove over these bytes that it is the other end of this wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Challenge {
    /// Random.
    pub nonce: Nonce,
}

impl Enveloped for Challenge {
    const KIND: Kind = Kind::DirectChallenge;
    const SIZE_MAX: usize = 64;
}

/// The consumer's proof. It carries the consumer's eventfd, which the [`Hello`] then does not carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claim {
    /// Random.
    pub nonce: Nonce,
    /// A hash that only a program with the secret of this direction of the wire can make.
    pub tag: [u8; 32],
}

impl Enveloped for Claim {
    const KIND: Kind = Kind::DirectClaim;
    const SIZE_MAX: usize = 128;
}

/// The producer's proof. In a team it is sent instead of a [`Welcome`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Confirmation {
    /// As in a [`Welcome`].
    pub process: u128,
    /// The hash of a [`Claim`], for the other direction.
    pub tag: [u8; 32],
}

impl Enveloped for Confirmation {
    const KIND: Kind = Kind::DirectConfirmation;
    const SIZE_MAX: usize = 128;
}

/// The beginning of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// The life of the producer's end.
    pub life: u32,
    /// How many values were sent in this life, including a value in this frame.
    pub number: u32,
    /// A number that grows with each frame of the producer, over all its wires.
    pub order: u64,
}

/// A message of a producer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame<'a> {
    /// A value.
    Value(Header, &'a [u8]),
    /// A boundary between values, in its envelope.
    Word(Header, &'a [u8]),
    /// A value in shared memory.
    Shared(Header, SharedValue),
    /// A buffer that the producer does not use again.
    Retired(u32),
}

/// The place of a value in shared memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedValue {
    /// The number of the buffer.
    pub buffer: u32,
    /// The length of the value in bytes; it is at the beginning of the buffer.
    pub size: u32,
}

impl Header {
    /// Returns the beginning of a frame with a value.
    pub fn value(self) -> [u8; HEADER_SIZE] {
        self.with(VALUE)
    }

    /// Returns a frame with a word.
    pub fn word(self, word: &[u8]) -> Vec<u8> {
        [&self.with(WORD), word].concat()
    }

    /// Returns a frame for a value in shared memory.
    pub fn shared(self, value: SharedValue) -> Vec<u8> {
        [&self.with(SHARED)[..], &value.buffer.to_le_bytes(), &value.size.to_le_bytes()].concat()
    }

    fn with(self, tag: u8) -> [u8; HEADER_SIZE] {
        let mut bytes = [tag; HEADER_SIZE];
        let [_, rest @ ..] = &mut bytes;
        let fields = self.life.to_le_bytes().into_iter().chain(self.number.to_le_bytes());
        rest.iter_mut().zip(fields.chain(self.order.to_le_bytes())).for_each(|(to, from)| *to = from);
        bytes
    }
}

impl<'a> Frame<'a> {
    /// Returns the order of the message among all messages of its producer; none if it has no order.
    pub fn order(&self) -> Option<u64> {
        match self {
            Self::Value(header, _) | Self::Word(header, _) | Self::Shared(header, _) => Some(header.order),
            Self::Retired(_) => None,
        }
    }

    /// Reads a frame; none if the packet is not a frame.
    pub fn parse(packet: &'a [u8]) -> Option<Self> {
        let (tag, rest) = packet.split_first()?;
        if *tag == RETIRED {
            return only_number(rest).map(Self::Retired);
        }
        let (life, rest) = number(rest)?;
        let (sent, rest) = number(rest)?;
        let (order, rest) = rest.split_first_chunk()?;
        let header = Header { life, number: sent, order: u64::from_le_bytes(*order) };
        match *tag {
            VALUE => Some(Self::Value(header, rest)),
            WORD => Some(Self::Word(header, rest)),
            SHARED => {
                let (buffer, rest) = number(rest)?;
                let (size, rest) = number(rest)?;
                rest.is_empty().then_some(Self::Shared(header, SharedValue { buffer, size }))
            }
            _ => None,
        }
    }
}

/// Returns the packet by which a consumer releases a buffer.
pub fn release(buffer: u32) -> [u8; 5] {
    of_buffer(RELEASE, buffer)
}

/// Returns the packet by which a producer gives up a buffer.
pub fn retire(buffer: u32) -> [u8; 5] {
    of_buffer(RETIRED, buffer)
}

fn of_buffer(tag: u8, buffer: u32) -> [u8; 5] {
    let [a, b, c, d] = buffer.to_le_bytes();
    [tag, a, b, c, d]
}

/// Returns the buffer that a packet releases; none if it is another packet.
pub fn released(packet: &[u8]) -> Option<u32> {
    let (tag, rest) = packet.split_first()?;
    only_number(rest).filter(|_| *tag == RELEASE)
}

fn only_number(bytes: &[u8]) -> Option<u32> {
    number(bytes).filter(|(_, rest)| rest.is_empty()).map(|(number, _)| number)
}

fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEADER: Header = Header { life: 2, number: 0x0102_0304, order: 9 };
    const BYTES: [u8; 16] = [2, 0, 0, 0, 4, 3, 2, 1, 9, 0, 0, 0, 0, 0, 0, 0];

    #[test]
    fn golden_frames() {
        let with = |tag: u8, rest: &[u8]| [&[tag], &BYTES[..], rest].concat();
        assert_eq!(HEADER.value()[..], with(0, b""));
        assert_eq!(HEADER.word(b"w"), with(1, b"w"));
        let shared = SharedValue { buffer: 5, size: 0x10_0000 };
        assert_eq!(HEADER.shared(shared), with(2, &[5, 0, 0, 0, 0, 0, 0x10, 0]));
        assert_eq!((release(5), retire(5)), ([0x10, 5, 0, 0, 0], [3, 5, 0, 0, 0]));
        assert_eq!((released(&release(5)), released(b"\x10\x05\0\0\0\0"), released(b"")), (Some(5), None, None));
    }

    #[test]
    fn frames_are_read_as_they_were_written() {
        let value = [&HEADER.value()[..], b"v"].concat();
        assert_eq!(Frame::parse(&value), Some(Frame::Value(HEADER, b"v")));
        assert_eq!(Frame::parse(&HEADER.word(b"w")), Some(Frame::Word(HEADER, b"w")));
        let shared = SharedValue { buffer: 5, size: 7 };
        assert_eq!(Frame::parse(&HEADER.shared(shared)), Some(Frame::Shared(HEADER, shared)));
        assert_eq!(Frame::parse(&[&HEADER.shared(shared)[..], b"x"].concat()), None);
        assert_eq!(Frame::parse(&retire(5)), Some(Frame::Retired(5)));
        assert_eq!((Frame::parse(&[4; 17]), Frame::parse(&[0; 16])), (None, None));
        assert_eq!(Frame::parse(&HEADER.value()).and_then(|frame| frame.order()), Some(9));
    }

    #[test]
    fn a_place_is_a_locator() {
        let place = Place { path: "/run/a#b/data.wire".into(), token: "c0ffee".into() };
        assert_eq!(place.locator(), "dca-direct//run/a#b/data.wire#c0ffee");
        assert_eq!(Place::of(&place.locator()), Some(place));
        assert_eq!((Place::of("unixsock-stream//run/a#b"), Place::is_meant("tcp/a:1")), (None, false));
    }

    proptest! {
        #[test]
        fn any_packet_is_read_or_refused(packet: Vec<u8>) {
            prop_assert!(Frame::parse(&packet).is_none() || released(&packet).is_none());
        }
    }
}
