//! The proof of a message's sender in a team: a signature, so that no relay can send a message in the name of another
//! program.

use super::codec::{Enveloped, Kind};
use serde::{Deserialize, Serialize};

/// The proof of a sender: its Ed25519 key, and its signature of the message's digest.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proof {
    /// The public key. Source: RFC 8032, section 5.1.5.
    pub key: [u8; 32],
    /// The signature, 64 bytes. Source: RFC 8032, section 5.1.6.
    pub signature: Vec<u8>,
    /// The credential that proves the owner of the key, in the form of [`crate::logic::tunnel::Introduction`]; left
    /// out if the receiver knows the key.
    pub credential: Option<Vec<u8>>,
}

impl Enveloped for Proof {
    const KIND: Kind = Kind::Proof;
    const SIZE_MAX: usize = 4 << 10;
}

#[cfg(test)]
mod tests {
    use super::super::codec::{decode, encode};
    use super::*;

    /// Bytes that other versions send and read.
    #[test]
    fn golden_proof() {
        let proof = Proof { key: [7; 32], signature: vec![8; 64], credential: Some(vec![9]) };
        let bytes = encode(&proof).unwrap();
        assert_eq!(bytes, [&b"DC\x01\x00\x13\x00"[..], &[7; 32], &[64], &[8; 64], &[1, 1, 9]].concat());
        assert_eq!(decode::<Proof>(&bytes).unwrap(), proof);
    }
}
