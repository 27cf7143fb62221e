//! Keys of nodes, users, programs and teams, and their short forms for comparison by people.
//!
//! Every owner has two pairs of keys: one for signatures (Ed25519, RFC 8032) and one for receiving secrets (X25519, RFC 7748). Both
//! public keys together have one id. `Debug` shows ids, never a secret.

use crate::text::{self, TextError};
use crate::wire::FormError;
use ed25519_dalek::{Signature, Signer as _, SigningKey, VerifyingKey};
use std::fmt;
use zeroize::Zeroizing;

/// The length of both secret keys, in bytes.
pub const SECRET_LEN: usize = 64;
/// The length of both public keys, in bytes.
pub const PUBLIC_LEN: usize = 64;
/// Bytes of a signature.
pub const SIGNATURE_LEN: usize = 64;
const KEY_TEXT: &str = "dca-key1-";
const WORDS: &str = include_str!("words.txt");

/// Random bytes for one operation, derived from 32 unpredictable bytes.
///
/// This room never calls the system. The caller gets the 32 bytes from the system for each operation, and never uses them twice.
pub struct Entropy(Box<blake3::OutputReader>);

impl Entropy {
    /// Takes 32 unpredictable bytes, which must not be used for anything else.
    pub fn new(seed: &[u8; 32]) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key("dca entropy 1");
        hasher.update(seed);
        Self(Box::new(hasher.finalize_xof()))
    }

    /// Returns the next bytes.
    pub fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut bytes = [0; N];
        self.0.fill(&mut bytes);
        bytes
    }
}

impl fmt::Debug for Entropy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Entropy(..)")
    }
}

/// The id of an owner's two public keys: their hash. Different keys have different ids.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct KeyId(pub [u8; 32]);

impl KeyId {
    /// Returns six words that two people can compare over a telephone. They have 60 bits of the id, which covers both public keys. For
    /// four words, which have 40 bits, an attacker can find matching keys in minutes.
    pub fn fingerprint(&self) -> String {
        let hash = blake3::derive_key("dca fingerprint 2", &self.0);
        let bits = hash.iter().take(8).fold(0u64, |bits, byte| (bits << 8) | u64::from(*byte));
        let words: Vec<&str> = (0..6).map(|place| word((bits >> (54 - 10 * place)) & 1023)).collect();
        words.join(" ")
    }
}

/// Returns a word from the list of 1024 words; each has 10 bits.
fn word(number: u64) -> &'static str {
    let index = usize::try_from(number).unwrap_or(usize::MAX);
    WORDS.split_whitespace().nth(index).expect("the list has 1024 words")
}

impl fmt::Display for KeyId {
    /// Writes the first 26 characters of the id, which have 130 bits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&text::encode(&self.0)[..26])
    }
}

impl fmt::Debug for KeyId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "KeyId({self})")
    }
}

/// The public keys of one owner.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct PublicKeys {
    sign: VerifyingKey,
    seal: [u8; 32],
    id: KeyId,
}

impl PublicKeys {
    /// Reads both keys: 32 bytes to check signatures, then 32 bytes to seal secrets.
    ///
    /// # Errors
    /// If a key is invalid, or weak: a point of small order, for which any attacker can make a signature or open a seal.
    pub fn from_bytes(bytes: &[u8; PUBLIC_LEN]) -> Result<Self, FormError> {
        let (mut sign, mut seal) = ([0; 32], [0; 32]);
        sign.copy_from_slice(&bytes[..32]);
        seal.copy_from_slice(&bytes[32..]);
        let sign = VerifyingKey::from_bytes(&sign).map_err(|_no_point| FormError::Field("key to sign"))?;
        if sign.is_weak() {
            return Err(FormError::Field("key to sign"));
        }
        // One scalar is enough to show whether the point has a small order.
        if shared(&[1; 32], &seal).is_none() {
            return Err(FormError::Field("key to seal"));
        }
        Ok(Self::new(sign, seal))
    }

    fn new(sign: VerifyingKey, seal: [u8; 32]) -> Self {
        let id = KeyId(blake3::derive_key("dca key id 1", &both(sign.as_bytes(), &seal)));
        Self { sign, seal, id }
    }

    /// Returns both keys as bytes.
    pub fn to_bytes(&self) -> [u8; PUBLIC_LEN] {
        both(self.sign.as_bytes(), &self.seal)
    }

    /// Returns the key that checks signatures. Source: RFC 8032, section 5.1.5.
    pub fn signing(&self) -> &[u8; 32] {
        self.sign.as_bytes()
    }

    /// Returns their id.
    pub const fn id(&self) -> KeyId {
        self.id
    }

    pub(crate) const fn seal(&self) -> &[u8; 32] {
        &self.seal
    }

    /// Returns whether a signature of these bytes was made with the secret key. Strict: RFC 8032 without weak keys, and with only one
    /// valid signature for each message and key.
    pub(crate) fn has_signed(&self, bytes: &[u8], signature: &[u8; SIGNATURE_LEN]) -> bool {
        self.sign.verify_strict(bytes, &Signature::from_bytes(signature)).is_ok()
    }

    /// Returns both keys as one word with a checksum, which people can copy: `dca-key1-…`.
    pub fn to_text(&self) -> String {
        text::with_sum(KEY_TEXT, &self.to_bytes())
    }

    /// Reads the text of [`PublicKeys::to_text`].
    ///
    /// # Errors
    /// If the text is not such a word, has a typing error, or does not contain valid keys.
    pub fn from_text(text: &str) -> Result<Self, TextError> {
        let bytes = text::without_sum(KEY_TEXT, text)?;
        let bytes: [u8; PUBLIC_LEN] = bytes.try_into().map_err(|_other_length| TextError::Length)?;
        Self::from_bytes(&bytes).map_err(|_no_keys| TextError::Checksum)
    }
}

/// Returns whether a signature of these bytes was made with the secret key of the public key `key`, as strictly as [`PublicKeys`]
/// checks it.
pub(crate) fn has_signed(key: &[u8; 32], bytes: &[u8], signature: &[u8; SIGNATURE_LEN]) -> bool {
    let key = VerifyingKey::from_bytes(key);
    key.is_ok_and(|key| !key.is_weak() && key.verify_strict(bytes, &Signature::from_bytes(signature)).is_ok())
}

impl fmt::Debug for PublicKeys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PublicKeys({})", self.id())
    }
}

/// The secret keys of one owner. They are wiped from memory when they are dropped.
pub struct SecretKeys {
    sign: SigningKey,
    seal: Zeroizing<[u8; 32]>,
    public: PublicKeys,
}

impl SecretKeys {
    /// Makes new keys.
    pub fn generate(entropy: &mut Entropy) -> Self {
        let bytes = Zeroizing::new(entropy.bytes::<SECRET_LEN>());
        Self::from_bytes(&bytes)
    }

    /// Reads the bytes of [`SecretKeys::to_bytes`]. Any 64 bytes are secret keys.
    pub fn from_bytes(bytes: &[u8; SECRET_LEN]) -> Self {
        let mut halves = Zeroizing::new([[0; 32]; 2]);
        halves[0].copy_from_slice(&bytes[..32]);
        halves[1].copy_from_slice(&bytes[32..]);
        let sign = SigningKey::from_bytes(&halves[0]);
        let public = PublicKeys::new(sign.verifying_key(), sealing_key(&halves[1]));
        Self { sign, seal: Zeroizing::new(halves[1]), public }
    }

    /// Returns both keys as bytes, which are wiped when they are dropped.
    pub fn to_bytes(&self) -> Zeroizing<[u8; SECRET_LEN]> {
        let mut bytes = Zeroizing::new([0; SECRET_LEN]);
        bytes[..32].copy_from_slice(self.sign.as_bytes());
        bytes[32..].copy_from_slice(&*self.seal);
        bytes
    }

    /// Returns the secret key for signatures, which is wiped when it is dropped.
    pub fn signing(&self) -> Zeroizing<[u8; 32]> {
        Zeroizing::new(self.sign.to_bytes())
    }

    /// Returns the public keys.
    pub const fn public(&self) -> &PublicKeys {
        &self.public
    }

    /// Signs the bytes of a form, which begin with its name.
    pub(crate) fn sign(&self, form: &[u8]) -> [u8; SIGNATURE_LEN] {
        self.sign.sign(form).to_bytes()
    }

    /// Returns the shared secret of these keys and a public key; none if the public key is of small order.
    pub(crate) fn shared(&self, with: &[u8; 32]) -> Option<Zeroizing<[u8; 32]>> {
        shared(&self.seal, with)
    }
}

/// Returns the key for signatures, followed by the key for seals.
fn both(sign: &[u8; 32], seal: &[u8; 32]) -> [u8; PUBLIC_LEN] {
    let mut bytes = [0; PUBLIC_LEN];
    bytes[..32].copy_from_slice(sign);
    bytes[32..].copy_from_slice(seal);
    bytes
}

/// The base point of X25519, RFC 7748, section 4.1.
const BASE_POINT: [u8; 32] = {
    let mut point = [0; 32];
    point[0] = 9;
    point
};

/// Returns the public key of a secret key.
pub(crate) fn sealing_key(secret: &[u8; 32]) -> [u8; 32] {
    x25519_dalek::x25519(*secret, BASE_POINT)
}

/// Returns the shared secret of a secret key and a public key; none if the public key is of small order.
pub(crate) fn shared(secret: &[u8; 32], with: &[u8; 32]) -> Option<Zeroizing<[u8; 32]>> {
    let shared = Zeroizing::new(x25519_dalek::x25519(*secret, *with));
    (*shared != [0; 32]).then_some(shared)
}

impl fmt::Debug for SecretKeys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SecretKeys({})", self.public.id())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_fingerprint_has_sixty_bits_of_both_keys() {
        let words = |id: KeyId| id.fingerprint().split(' ').map(str::to_owned).collect::<Vec<_>>();
        let one = SecretKeys::generate(&mut Entropy::new(&[1; 32]));
        assert_eq!(words(one.public().id()).len(), 6);
        let mut bytes = one.public().to_bytes();
        let other = SecretKeys::generate(&mut Entropy::new(&[2; 32])).public().to_bytes();
        // The second half is the key for opening secrets.
        bytes[32..].copy_from_slice(&other[32..]);
        let mixed = PublicKeys::from_bytes(&bytes).unwrap();
        assert_ne!(words(mixed.id()), words(one.public().id()));
        // Each word depends on the id.
        let all: Vec<Vec<String>> = (0..64).map(|number| words(KeyId([number; 32]))).collect();
        assert!((0..6).all(|place| all.iter().map(|words| &words[place]).collect::<BTreeSet<_>>().len() > 32));
    }

    #[test]
    fn the_words_are_1024_different_plain_ones() {
        let words: Vec<&str> = WORDS.split_whitespace().collect();
        let different: BTreeSet<&&str> = words.iter().collect();
        assert_eq!((words.len(), different.len()), (1024, 1024));
        assert!(words.iter().all(|word| word.len() <= 10 && word.bytes().all(|byte| byte.is_ascii_lowercase())));
    }

    #[test]
    fn weak_keys_are_refused() {
        let good = SecretKeys::generate(&mut Entropy::new(&[1; 32])).public().to_bytes();
        let mut weak = good;
        weak[..32].copy_from_slice(&[&[1][..], &[0; 31]].concat());
        assert_eq!(PublicKeys::from_bytes(&weak), Err(FormError::Field("key to sign")));
        let mut weak = good;
        weak[32..].copy_from_slice(&[0; 32]);
        assert_eq!(PublicKeys::from_bytes(&weak), Err(FormError::Field("key to seal")));
    }

    #[test]
    fn debug_shows_no_secret() {
        let keys = SecretKeys::generate(&mut Entropy::new(&[7; 32]));
        let shown = format!("{keys:?} {:?} {:?}", keys.public(), Entropy::new(&[7; 32]));
        assert_eq!(shown, format!("SecretKeys({0}) PublicKeys({0}) Entropy(..)", keys.public().id()));
    }

    #[test]
    fn a_key_as_text_is_checked() {
        let keys = *SecretKeys::generate(&mut Entropy::new(&[7; 32])).public();
        let text = keys.to_text();
        assert_eq!(PublicKeys::from_text(&format!(" {text}\n")), Ok(keys));
        assert!(PublicKeys::from_text(&text[..text.len() - 1]).is_err());
        assert_eq!(PublicKeys::from_text("dca-key2-0"), Err(TextError::Prefix(KEY_TEXT)));
    }

    proptest! {
        #[test]
        fn secret_keys_come_back(seed: [u8; 32], message: Vec<u8>) {
            let keys = SecretKeys::generate(&mut Entropy::new(&seed));
            let again = SecretKeys::from_bytes(&keys.to_bytes());
            let signature = keys.sign(&message);
            prop_assert_eq!(again.sign(&message), signature);
            prop_assert!(keys.public().has_signed(&message, &signature));
            prop_assert_eq!(PublicKeys::from_bytes(&keys.public().to_bytes()), Ok(*again.public()));
        }
    }
}
