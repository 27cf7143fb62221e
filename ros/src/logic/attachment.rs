//! The attachment of each message, request and response: its number, its time, its sender.
//!
//! A process of ROS 2 drops a message without an attachment, and may end if the attachment is malformed. So there is only one form to write
//! it, and callers cannot make its bytes themselves. Source: `rmw_zenoh_cpp/src/detail/attachment_helpers.cpp`.

/// The length of an attachment, in bytes.
pub const LENGTH: usize = 33;
/// The length of the id of a sender, which is in the byte in front of the id.
const GID_LENGTH: u8 = 16;
/// The names of the fields, as Jazzy 0.2.0 to 0.2.3 write them.
const NAMES: [&[u8]; 3] = [b"sequence_number", b"source_timestamp", b"source_gid"];

/// The id of a publisher, a client or a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Gid(pub [u8; 16]);

impl Gid {
    /// Returns the id of the publisher, client or server with this token key. Source: `rmw_zenoh_cpp`, `liveliness_utils.cpp`, `hash_gid`:
    /// the low half of the hash comes first.
    pub fn of(token: &str) -> Self {
        let hash = xxhash_rust::xxh3::xxh3_128(token.as_bytes());
        Self(hash.to_le_bytes())
    }
}

/// The attachment of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// The number of the message among the messages of its sender, from 1.
    pub sequence: i64,
    /// The time at which it was sent, in nanoseconds since 1970.
    pub nanos: i64,
    /// The sender.
    pub sender: Gid,
}

impl Attachment {
    /// Returns the bytes of the attachment.
    pub fn encode(&self) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        let (sequence, rest) = bytes.split_at_mut(8);
        let (nanos, sender) = rest.split_at_mut(8);
        sequence.copy_from_slice(&self.sequence.to_le_bytes());
        nanos.copy_from_slice(&self.nanos.to_le_bytes());
        sender[0] = GID_LENGTH;
        sender[1..].copy_from_slice(&self.sender.0);
        bytes
    }

    /// Reads an attachment, with or without the names of its fields.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader { rest: bytes, is_named: bytes.len() > LENGTH };
        let sequence = i64::from_le_bytes(reader.field(NAMES[0])?);
        let nanos = i64::from_le_bytes(reader.field(NAMES[1])?);
        let [length, sender @ ..]: [u8; 17] = reader.field(NAMES[2])?;
        let is_whole = reader.rest.is_empty() && length == GID_LENGTH;
        is_whole.then_some(Self { sequence, nanos, sender: Gid(sender) })
    }
}

struct Reader<'a> {
    rest: &'a [u8],
    /// Whether each field has its name in front of it.
    is_named: bool,
}

impl Reader<'_> {
    fn field<const N: usize>(&mut self, name: &[u8]) -> Option<[u8; N]> {
        if self.is_named {
            let length = u8::try_from(name.len()).ok()?;
            self.rest = self.rest.strip_prefix(&[length])?.strip_prefix(name)?;
        }
        let (field, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*field)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const EXAMPLE: Attachment = Attachment { sequence: 1, nanos: 0x0102_0304, sender: Gid([7; 16]) };

    /// Returns the form of Jazzy 0.2.0 to 0.2.3.
    fn named(of: &Attachment) -> Vec<u8> {
        let plain = of.encode();
        let field = |name: &[u8], value: &[u8]| [&[u8::try_from(name.len()).unwrap()], name, value].concat();
        [field(NAMES[0], &plain[..8]), field(NAMES[1], &plain[8..16]), field(NAMES[2], &plain[16..])].concat()
    }

    #[test]
    fn an_id_is_the_hash_of_a_token() {
        let text = Gid::of("").0.map(|byte| format!("{byte:02x}")).concat();
        assert_eq!(text, "7f498d4624c30160d8984701d306aa99");
    }

    #[test]
    fn an_attachment_has_one_form() {
        let mut expected = vec![1, 0, 0, 0, 0, 0, 0, 0, 4, 3, 2, 1, 0, 0, 0, 0, 16];
        expected.extend([7; 16]);
        assert_eq!(EXAMPLE.encode().to_vec(), expected);
        assert_eq!((named(&EXAMPLE).len(), Attachment::decode(&named(&EXAMPLE))), (77, Some(EXAMPLE)));
    }

    #[test]
    fn damaged_attachments_are_refused() {
        for whole in [EXAMPLE.encode().to_vec(), named(&EXAMPLE)] {
            for end in 0..whole.len() {
                assert_eq!(Attachment::decode(&whole[..end]), None, "{end} bytes");
            }
            assert_eq!(Attachment::decode(&[&whole[..], &[0]].concat()), None, "a byte more");
        }
        let mut length = EXAMPLE.encode();
        length[16] = 15;
        assert_eq!(Attachment::decode(&length), None);
        let mut name = named(&EXAMPLE);
        name[3] ^= 1;
        assert_eq!(Attachment::decode(&name), None);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(sequence: i64, nanos: i64, sender: [u8; 16]) {
            let attachment = Attachment { sequence, nanos, sender: Gid(sender) };
            prop_assert_eq!(Attachment::decode(&attachment.encode()), Some(attachment));
            prop_assert_eq!(Attachment::decode(&named(&attachment)), Some(attachment));
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..100)) {
            if let Some(attachment) = Attachment::decode(&bytes) {
                prop_assert!(attachment.encode()[..] == bytes || named(&attachment) == bytes);
            }
        }
    }
}
