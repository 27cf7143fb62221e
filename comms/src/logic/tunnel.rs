//! The messages at the beginning of a tunnel between two hosts of a team. Each is a frame.

use super::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};

/// The first message of each end: its identity. The credential proves who owns the key of the handshake.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Introduction {
    /// The session that uses the tunnel.
    pub session: String,
    /// The proof of identity, in the form of [`crate::io::session::Identity`].
    pub credential: Vec<u8>,
}

/// The second message of each end: the revocations that it knows.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Revocations {
    /// The revocations, in the form of [`crate::io::session::Identity`].
    pub sets: Vec<u8>,
}

impl Enveloped for Introduction {
    const KIND: Kind = Kind::Introduction;
    const SIZE_MAX: usize = 4 << 10;
}

impl Enveloped for Revocations {
    const KIND: Kind = Kind::Revocations;
    const SIZE_MAX: usize = 4 << 20;
}

#[cfg(test)]
mod tests {
    use super::super::codec::encode;
    use super::*;

    /// Bytes that other versions send and read.
    #[test]
    fn golden_messages() {
        let introduction = Introduction { session: "a1".into(), credential: vec![7, 8] };
        assert_eq!(encode(&introduction).unwrap(), *b"DC\x01\x00\x0a\x00\x02a1\x02\x07\x08");
        assert_eq!(encode(&Revocations { sets: vec![9] }).unwrap(), *b"DC\x01\x00\x0b\x00\x01\x09");
    }
}
