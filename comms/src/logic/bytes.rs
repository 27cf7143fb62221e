//! Bytes that are encoded as one piece. A `Vec<u8>` is encoded byte by byte, at a hundredth of the speed. In postcard both
//! give the same bytes.

use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
use serde::ser::{Serialize, Serializer};
use std::fmt;
use zeroize::Zeroizing;

/// The most bytes for which memory is reserved before any of them has arrived.
const ROOM_MAX: usize = 4 << 10;

/// Bytes of any meaning.
#[derive(Clone, Default, PartialEq, Eq, Hash)]
pub struct Bytes(pub Vec<u8>);

impl fmt::Debug for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Bytes({})", self.0.len())
    }
}

impl From<Vec<u8>> for Bytes {
    fn from(bytes: Vec<u8>) -> Self {
        Self(bytes)
    }
}

impl Serialize for Bytes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_byte_buf(BytesVisitor).map(Self)
    }
}

/// Secret bytes: they are never shown in debug output, and are wiped when they are dropped.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct SecretBytes(Zeroizing<Vec<u8>>);

impl SecretBytes {
    /// Takes over bytes.
    pub fn new(bytes: Vec<u8>) -> Self {
        Self(Zeroizing::new(bytes))
    }

    /// Returns the bytes. A copy of them is not wiped automatically.
    pub fn expose(&self) -> &[u8] {
        &self.0
    }
}

impl From<Zeroizing<Vec<u8>>> for SecretBytes {
    fn from(bytes: Zeroizing<Vec<u8>>) -> Self {
        Self(bytes)
    }
}

impl fmt::Debug for SecretBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SecretBytes(..)")
    }
}

impl Serialize for SecretBytes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for SecretBytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_byte_buf(BytesVisitor).map(Self::new)
    }
}

struct BytesVisitor;

impl<'de> Visitor<'de> for BytesVisitor {
    type Value = Vec<u8>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("bytes")
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<u8>, E> {
        Ok(bytes.to_vec())
    }

    fn visit_byte_buf<E: Error>(self, bytes: Vec<u8>) -> Result<Vec<u8>, E> {
        Ok(bytes)
    }

    /// Takes bytes from a text format, which represents them as a list.
    fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<Vec<u8>, A::Error> {
        let mut all = Vec::with_capacity(bytes.size_hint().unwrap_or(0).min(ROOM_MAX));
        while let Some(byte) = bytes.next_element()? {
            all.push(byte);
        }
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn they_are_the_bytes_of_a_list_of_bytes(bytes: Vec<u8>) {
            let encoded = postcard::to_stdvec(&Bytes(bytes.clone())).unwrap();
            prop_assert_eq!(&encoded, &postcard::to_stdvec(&bytes).unwrap());
            prop_assert_eq!(postcard::from_bytes::<Bytes>(&encoded).unwrap().0, bytes);
        }
    }

    #[test]
    fn a_secret_travels_and_is_not_shown() {
        let secret = SecretBytes::new(b"hunter2".to_vec());
        let encoded = postcard::to_stdvec(&secret).unwrap();
        assert_eq!(postcard::from_bytes::<SecretBytes>(&encoded).unwrap(), secret);
        assert_eq!((format!("{secret:?}").as_str(), secret.expose()), ("SecretBytes(..)", &b"hunter2"[..]));
    }

    #[test]
    fn a_length_without_bytes_is_refused() {
        assert!(postcard::from_bytes::<Bytes>(&[0xff, 0xff, 0xff, 0xff, 0x0f, 1]).is_err());
    }
}
