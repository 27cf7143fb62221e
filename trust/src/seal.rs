//! Secrets that are sealed for the nodes that may read them. Other nodes only store unreadable bytes.
//!
//! A value is encrypted with a separate key (XChaCha20-Poly1305), and that key is encrypted once for each reader, as in
//! age. The wrapping key comes from a key agreement (X25519) with a single-use key. The team, the path in the database,
//! the generation and the list of readers are authenticated as well. So a value cannot be moved to another path, and no
//! reader can be added. The seal does not prove the writer. The signature of the transaction proves the writer.

use crate::identity::{Entropy, KeyId, PublicKeys, SecretKeys, sealing_key, shared};
use crate::wire::{FormError, Reader, Writer};
use chacha20poly1305::aead::{Aead, Payload};
use chacha20poly1305::{KeyInit as _, XChaCha20Poly1305, XNonce};
use std::fmt;
use thiserror::Error;
use zeroize::Zeroizing;

/// The most bytes of a secret: 64 KiB.
pub const SECRET_MAX: usize = 64 << 10;
/// The most readers of a secret.
pub const READERS_MAX: usize = 256;
/// The longest path, in bytes.
pub const PATH_MAX: usize = 1024;
/// The most bytes of a sealed value.
pub const SEALED_MAX: usize = SECRET_MAX + 256 + READERS_MAX * WRAP;

const SEALED: &str = "dca sealed 1";
const TAG: usize = 16;
/// The length of one reader's entry in bytes: the reader's id, the single-use key, and the wrapped key with its tag.
const WRAP: usize = 32 + 32 + 32 + TAG;

/// An unencrypted secret. It is wiped when it is dropped, and `Debug` does not show it.
pub struct Secret(Zeroizing<Vec<u8>>);

impl Secret {
    /// Takes a secret of at most [`SECRET_MAX`] bytes.
    ///
    /// # Errors
    /// If the secret is longer.
    pub fn new(bytes: Zeroizing<Vec<u8>>) -> Result<Self, SealError> {
        if bytes.len() > SECRET_MAX { Err(SealError::TooLong) } else { Ok(Self(bytes)) }
    }

    /// Returns the secret itself, for the code that has to use it.
    #[must_use]
    pub fn expose(&self) -> &[u8] {
        &self.0
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

/// Where a secret belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place<'a> {
    /// The team.
    pub team: KeyId,
    /// The path of the key in the database.
    pub path: &'a str,
}

/// Why a secret cannot be sealed or opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum SealError {
    /// The secret is too long.
    #[error("a secret has at most {SECRET_MAX} bytes")]
    TooLong,
    /// The path is too long.
    #[error("the path of a secret has at most {PATH_MAX} bytes")]
    Path,
    /// The secret has no reader, too many readers, or one reader twice.
    #[error("a secret needs 1 to {READERS_MAX} different readers")]
    Readers,
    /// The secret was rotated too often.
    #[error("the generations of this key are used up")]
    Generation,
    /// The secret is not sealed for this reader.
    #[error("the secret is not sealed for this key")]
    NotForUs,
    /// The secret was changed, belongs to another path or team, or was sealed incorrectly.
    #[error("the secret was sealed for another path or team, or it was changed")]
    Damaged,
}

#[derive(Clone, PartialEq, Eq)]
struct Wrap {
    reader: KeyId,
    once: [u8; 32],
    wrapped: [u8; 32 + TAG],
}

/// A sealed secret.
#[derive(Clone, PartialEq, Eq)]
pub struct Sealed {
    generation: u64,
    /// In the order of their ids.
    wraps: Vec<Wrap>,
    nonce: [u8; 24],
    ciphertext: Vec<u8>,
}

impl Sealed {
    /// Seals a secret for these readers, as its first generation.
    ///
    /// # Errors
    /// If a limit is exceeded.
    pub fn seal(
        secret: &Secret,
        place: &Place<'_>,
        readers: &[PublicKeys],
        entropy: &mut Entropy,
    ) -> Result<Self, SealError> {
        Self::generation(1, secret, place, readers, entropy)
    }

    /// Seals a new secret in place of the old one, with a new key. The readers may differ.
    ///
    /// # Errors
    /// If a limit is exceeded.
    pub fn rotate(
        &self,
        secret: &Secret,
        place: &Place<'_>,
        readers: &[PublicKeys],
        entropy: &mut Entropy,
    ) -> Result<Self, SealError> {
        let next = self.generation.checked_add(1).ok_or(SealError::Generation)?;
        Self::generation(next, secret, place, readers, entropy)
    }

    fn generation(
        generation: u64,
        secret: &Secret,
        place: &Place<'_>,
        readers: &[PublicKeys],
        entropy: &mut Entropy,
    ) -> Result<Self, SealError> {
        if place.path.len() > PATH_MAX {
            return Err(SealError::Path);
        }
        let mut readers: Vec<(KeyId, &PublicKeys)> = readers.iter().map(|keys| (keys.id(), keys)).collect();
        readers.sort_by_key(|(id, _)| *id);
        let is_twice = readers.windows(2).any(|pair| pair[0].0 == pair[1].0);
        if readers.is_empty() || readers.len() > READERS_MAX || is_twice {
            return Err(SealError::Readers);
        }
        let key = Zeroizing::new(entropy.bytes::<32>());
        let about = about(place, generation);
        let wraps = readers.iter().map(|(id, keys)| Wrap::new(&key, *id, keys, &about, entropy));
        let wraps = wraps.collect::<Result<Vec<_>, _>>()?;
        let mut sealed = Self { generation, wraps, nonce: entropy.bytes(), ciphertext: Vec::new() };
        let payload = Payload { msg: secret.expose(), aad: &sealed.authenticated(&about) };
        let ciphertext = cipher(&key).encrypt(XNonce::from_slice(&sealed.nonce), payload);
        sealed.ciphertext = ciphertext.map_err(|_too_long| SealError::TooLong)?;
        Ok(sealed)
    }

    /// Returns the secret, for one of its readers.
    ///
    /// # Errors
    /// If the secret is not sealed for these keys, or belongs to another place.
    pub fn open(&self, place: &Place<'_>, keys: &SecretKeys) -> Result<Secret, SealError> {
        if place.path.len() > PATH_MAX {
            return Err(SealError::Path);
        }
        let id = keys.public().id();
        let wrap = self.wraps.iter().find(|wrap| wrap.reader == id).ok_or(SealError::NotForUs)?;
        let about = about(place, self.generation);
        let key = wrap.open(keys, &about)?;
        let payload = Payload { msg: &self.ciphertext, aad: &self.authenticated(&about) };
        let secret = cipher(&key).decrypt(XNonce::from_slice(&self.nonce), payload);
        Ok(Secret(Zeroizing::new(secret.map_err(|_damaged| SealError::Damaged)?)))
    }

    /// Returns the generation: how often the secret was rotated, plus one.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.generation
    }

    /// Returns the ids of the readers.
    pub fn readers(&self) -> impl Iterator<Item = KeyId> {
        self.wraps.iter().map(|wrap| wrap.reader)
    }

    /// Returns the bytes that are authenticated together with the secret.
    fn authenticated(&self, about: &[u8]) -> Vec<u8> {
        let mut bytes = about.to_vec();
        self.wraps.iter().for_each(|wrap| wrap.write(&mut bytes));
        bytes
    }

    /// Returns the bytes of the sealed secret in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer::new(SEALED);
        writer.u64(self.generation);
        writer.count(self.wraps.len());
        let mut wraps = Vec::new();
        self.wraps.iter().for_each(|wrap| wrap.write(&mut wraps));
        writer.fixed(&wraps);
        writer.fixed(&self.nonce);
        writer.long(&self.ciphertext);
        writer.finish()
    }

    /// Reads the bytes of a sealed secret.
    ///
    /// # Errors
    /// If the bytes are not a sealed secret.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, SEALED, SEALED_MAX)?;
        let generation = reader.u64()?;
        let mut wraps: Vec<Wrap> = Vec::new();
        for _ in 0..reader.count(READERS_MAX, "readers")? {
            let wrap = Wrap { reader: KeyId(reader.fixed()?), once: reader.fixed()?, wrapped: reader.fixed()? };
            if wraps.last().is_some_and(|last| last.reader >= wrap.reader) {
                return Err(FormError::Field("readers"));
            }
            wraps.push(wrap);
        }
        let nonce = reader.fixed()?;
        let ciphertext = reader.long(SECRET_MAX + TAG, "ciphertext")?.to_vec();
        reader.finish()?;
        if generation == 0 || wraps.is_empty() || ciphertext.len() < TAG {
            return Err(FormError::Field("readers"));
        }
        Ok(Self { generation, wraps, nonce, ciphertext })
    }
}

impl fmt::Debug for Sealed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Sealed(generation {}, {} readers)", self.generation, self.wraps.len())
    }
}

impl Wrap {
    fn new(
        key: &[u8; 32],
        reader: KeyId,
        keys: &PublicKeys,
        about: &[u8],
        entropy: &mut Entropy,
    ) -> Result<Self, SealError> {
        let secret = Zeroizing::new(entropy.bytes::<32>());
        let once = sealing_key(&secret);
        let common = shared(&secret, keys.seal()).ok_or(SealError::Readers)?;
        let sealed = cipher(&wrapping_key(&once, keys.seal(), &common))
            .encrypt(&XNonce::default(), Payload { msg: key, aad: about })
            .expect("32 bytes are not too long");
        let mut wrapped = [0; 32 + TAG];
        wrapped.copy_from_slice(&sealed);
        Ok(Self { reader, once, wrapped })
    }

    fn open(&self, keys: &SecretKeys, about: &[u8]) -> Result<Zeroizing<[u8; 32]>, SealError> {
        let common = keys.shared(&self.once).ok_or(SealError::Damaged)?;
        let wrapping = wrapping_key(&self.once, keys.public().seal(), &common);
        let opened = cipher(&wrapping).decrypt(&XNonce::default(), Payload { msg: &self.wrapped, aad: about });
        let opened = Zeroizing::new(opened.map_err(|_damaged| SealError::Damaged)?);
        let mut key = Zeroizing::new([0; 32]);
        key.copy_from_slice(&opened);
        Ok(key)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.reader.0);
        bytes.extend_from_slice(&self.once);
        bytes.extend_from_slice(&self.wrapped);
    }
}

/// Returns the key that encrypts the key of a value. It is used for only one message, so its nonce is 0, as in age.
fn wrapping_key(once: &[u8; 32], reader: &[u8; 32], common: &[u8; 32]) -> Zeroizing<[u8; 32]> {
    let material = Zeroizing::new([*once, *reader, *common].concat());
    Zeroizing::new(blake3::derive_key("dca seal wrapping key 1", &material))
}

fn cipher(key: &[u8; 32]) -> XChaCha20Poly1305 {
    XChaCha20Poly1305::new(key.into())
}

fn about(place: &Place<'_>, generation: u64) -> Vec<u8> {
    let mut writer = Writer::new(SEALED);
    writer.fixed(&place.team.0);
    writer.long(place.path.as_bytes());
    writer.u64(generation);
    writer.finish()
}

/// Returns the paths of the secrets that the owner of a key could read. They have to be changed if that key is stolen.
pub fn readable_by<'a>(key: &KeyId, values: impl IntoIterator<Item = (&'a str, &'a Sealed)>) -> Vec<&'a str> {
    values
        .into_iter()
        .filter(|(_, sealed)| sealed.readers().any(|reader| reader == *key))
        .map(|(path, _)| path)
        .collect()
}
