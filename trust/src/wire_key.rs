//! The keys of wires: values between two programs are sealed with a key that only these two have.
//!
//! Each program makes its own keys when it starts, and gives the public keys to others through its node. A key agreement (X25519) of
//! one end's secret key and the other end's public key gives the same bytes at both ends. From these, one key for each wire and
//! direction is derived. So no secret is sent, no node knows one, and a restarted program has new keys.

use crate::identity::{Entropy, PUBLIC_LEN, PublicKeys, SecretKeys};
use crate::wire::FormError;
use std::fmt;
use zeroize::Zeroizing;

/// The length of a key that seals a wire, in bytes.
pub const WIRE_KEY_LEN: usize = 32;

const WIRE_KEY: &str = "dca wire key 1";

/// The keys of a program, from its start to its end.
pub struct ProgramKeys(SecretKeys);

/// The end of a wire that seals a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sealing {
    /// This end seals messages for the other end.
    Here,
    /// The other end seals messages for this one.
    There,
}

impl ProgramKeys {
    /// Makes new keys.
    pub fn generate(entropy: &mut Entropy) -> Self {
        Self(SecretKeys::generate(entropy))
    }

    /// Returns the public keys, for other programs.
    pub fn public(&self) -> [u8; PUBLIC_LEN] {
        self.0.public().to_bytes()
    }

    /// Returns the secret Ed25519 key by which linked programs recognise this program, and its public key.
    pub fn signing(&self) -> (Zeroizing<[u8; 32]>, [u8; 32]) {
        (self.0.signing(), *self.0.public().signing())
    }

    /// Returns the Ed25519 key from the public keys of a program; none if the bytes are not such keys.
    pub fn signing_of(public: &[u8]) -> Option<[u8; 32]> {
        let public = <&[u8; PUBLIC_LEN]>::try_from(public).ok()?;
        PublicKeys::from_bytes(public).ok().map(|keys| *keys.signing())
    }

    /// Returns the key for sealing messages to another program, or from it. `about` names the wire and the use; each combination has
    /// a separate key.
    ///
    /// # Errors
    /// If the bytes are not the public keys of a program.
    pub fn wire(
        &self,
        theirs: &[u8],
        sealing: Sealing,
        about: &str,
    ) -> Result<Zeroizing<[u8; WIRE_KEY_LEN]>, FormError> {
        let theirs = <&[u8; PUBLIC_LEN]>::try_from(theirs).map_err(|_other_length| FormError::Field("key"))?;
        let keys = PublicKeys::from_bytes(theirs)?;
        let shared = self.0.shared(keys.seal()).ok_or(FormError::Field("key to seal"))?;
        let ours = self.public();
        let (from, to) = if sealing == Sealing::Here { (&ours, theirs) } else { (theirs, &ours) };
        let mut hasher = blake3::Hasher::new_derive_key(WIRE_KEY);
        // All fields but the last have a fixed length.
        hasher.update(&*shared).update(from).update(to).update(about.as_bytes());
        Ok(Zeroizing::new(hasher.finalize().into()))
    }
}

impl fmt::Debug for ProgramKeys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ProgramKeys").field(&self.0.public().id()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_have_the_same_key_and_nobody_else() {
        let keys = |seed| ProgramKeys::generate(&mut Entropy::new(&[seed; 32]));
        let (a, b, other) = (keys(1), keys(2), keys(3));
        let sealed = a.wire(&b.public(), Sealing::Here, "w/1").unwrap();
        assert_eq!(sealed, b.wire(&a.public(), Sealing::There, "w/1").unwrap());
        let others = [
            a.wire(&b.public(), Sealing::Here, "w/2"),
            // The way back.
            a.wire(&b.public(), Sealing::There, "w/1"),
            a.wire(&other.public(), Sealing::Here, "w/1"),
            other.wire(&b.public(), Sealing::Here, "w/1"),
            other.wire(&a.public(), Sealing::There, "w/1"),
        ];
        assert!(others.into_iter().all(|key| key.unwrap() != sealed));
        // The other direction with the same program also has a different key.
        assert!(a.wire(&a.public(), Sealing::Here, "w/1").unwrap() != sealed);
    }

    #[test]
    fn weak_and_short_keys_are_refused() {
        let a = ProgramKeys::generate(&mut Entropy::new(&[1; 32]));
        let mut weak = a.public();
        weak[32..].fill(0);
        for theirs in [&[][..], &[7; 63], &weak] {
            assert!(a.wire(theirs, Sealing::Here, "w/1").is_err());
        }
        assert!(format!("{a:?}").starts_with("ProgramKeys(KeyId("));
    }
}
