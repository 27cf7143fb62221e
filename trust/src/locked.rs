//! Secret keys in a file, encrypted with a passphrase (Argon2id, then XChaCha20-Poly1305).
//!
//! The public keys are stored beside them unencrypted, but authenticated. Source of the costs: RFC 9106, section 4, the second
//! recommended choice with one lane.

use crate::identity::{Entropy, PUBLIC_LEN, PublicKeys, SECRET_LEN, SecretKeys};
use crate::wire::{FormError, Reader, Writer};
use argon2::{Algorithm, Argon2, Params, Version};
use chacha20poly1305::aead::{Aead, Payload};
use chacha20poly1305::{KeyInit as _, XChaCha20Poly1305, XNonce};
use thiserror::Error;
use zeroize::Zeroizing;

/// The longest such file, in bytes.
pub const LOCKED_MAX: usize = 512;
/// The shortest passphrase, in characters.
pub const PASSPHRASE_MIN: usize = 8;
/// The longest passphrase, in bytes.
pub const PASSPHRASE_MAX: usize = 1024;

const LOCKED: &str = "dca locked keys 1";
const TAG: usize = 16;

/// The cost of one guess of a passphrase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Memory, in KiB.
    memory: u32,
    /// How many passes over the memory are made.
    passes: u32,
}

impl Cost {
    /// 64 MiB, three times.
    pub const STANDARD: Self = Self { memory: 64 << 10, passes: 3 };
    /// The least cost, only for tests: it does not protect the keys.
    pub const TEST: Self = Self { memory: 8, passes: 1 };

    /// Reads a cost. A file from another user may require at most 1 GiB and 16 passes.
    fn from_numbers(memory: u32, passes: u32) -> Result<Self, FormError> {
        if (8..=1 << 20).contains(&memory) && (1..=16).contains(&passes) {
            Ok(Self { memory, passes })
        } else {
            Err(FormError::Field("cost"))
        }
    }
}

/// Why keys cannot be locked or unlocked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum LockError {
    /// The passphrase is too short or too long.
    #[error("a passphrase has {PASSPHRASE_MIN} characters or more, and {PASSPHRASE_MAX} bytes at most")]
    Passphrase,
    /// The passphrase is one of the first that an attacker tries.
    #[error("attackers try this passphrase first; take for example four words that do not belong together")]
    Guessable,
    /// The passphrase is wrong, or the file was changed.
    #[error("the passphrase is wrong, or the file was changed")]
    Wrong,
    /// The memory is not sufficient for checking the passphrase.
    #[error("there is not enough memory to use the passphrase")]
    Memory,
}

/// The most common passphrases of [`PASSPHRASE_MIN`] characters or more. The list leaves out runs
/// of characters, and passphrases with few different characters, because the check recognises these
/// by a rule.
const COMMON: [&str; 24] = [
    "1q2w3e4r",
    "1q2w3e4r5t",
    "1qaz2wsx",
    "abc12345",
    "abcd1234",
    "asdfghjk",
    "asdfghjkl",
    "baseball",
    "changeme",
    "football",
    "iloveyou",
    "letmein1",
    "passw0rd",
    "password",
    "password1",
    "password123",
    "passwort",
    "princess",
    "qwerty123",
    "qwertyui",
    "qwertyuiop",
    "sunshine",
    "superman",
    "trustno1",
];
/// The fewest different characters of a passphrase.
const DIFFERENT_MIN: usize = 5;

/// Returns whether a passphrase is common, has few different characters, or is a run such as `12345678` or `hgfedcba`.
fn is_guessable(passphrase: &str) -> bool {
    let lower = passphrase.to_lowercase();
    let characters: Vec<u32> = lower.chars().map(u32::from).collect();
    let steps: Vec<i64> = characters.windows(2).map(|pair| i64::from(pair[1]) - i64::from(pair[0])).collect();
    // `1234567890` continues from 9 with 0.
    let along = steps.iter().filter(|step| matches!(step, 1 | -1)).count();
    let different = characters.iter().collect::<std::collections::BTreeSet<_>>().len();
    different < DIFFERENT_MIN || along + 2 > steps.len() || COMMON.contains(&lower.as_str())
}

/// Secret keys that can be opened only with the passphrase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LockedKeys {
    cost: Cost,
    salt: [u8; 16],
    nonce: [u8; 24],
    public: PublicKeys,
    ciphertext: [u8; SECRET_LEN + TAG],
}

impl LockedKeys {
    /// Encrypts keys.
    ///
    /// # Errors
    /// If the passphrase is too short, too long, or easy to guess.
    pub fn lock(keys: &SecretKeys, passphrase: &str, cost: Cost, entropy: &mut Entropy) -> Result<Self, LockError> {
        if passphrase.chars().count() < PASSPHRASE_MIN || passphrase.len() > PASSPHRASE_MAX {
            return Err(LockError::Passphrase);
        }
        if is_guessable(passphrase) {
            return Err(LockError::Guessable);
        }
        let (salt, nonce) = (entropy.bytes(), entropy.bytes());
        let ciphertext = [0; SECRET_LEN + TAG];
        let mut locked = Self { cost, salt, nonce, public: *keys.public(), ciphertext };
        let secret = keys.to_bytes();
        let payload = Payload { msg: &*secret, aad: &locked.head() };
        let sealed = locked.cipher(passphrase)?.encrypt(XNonce::from_slice(&nonce), payload);
        // Cannot fail for its length: 64 bytes are not too long, and the result has 80 bytes.
        let sealed = sealed.map_err(|_too_long| LockError::Memory)?;
        locked.ciphertext = sealed.try_into().map_err(|_other_length| LockError::Memory)?;
        Ok(locked)
    }

    /// Decrypts the keys.
    ///
    /// # Errors
    /// If the passphrase is wrong, or the file was changed.
    pub fn unlock(&self, passphrase: &str) -> Result<SecretKeys, LockError> {
        if passphrase.len() > PASSPHRASE_MAX {
            return Err(LockError::Wrong);
        }
        let payload = Payload { msg: &self.ciphertext, aad: &self.head() };
        let opened = self.cipher(passphrase)?.decrypt(XNonce::from_slice(&self.nonce), payload);
        let opened = Zeroizing::new(opened.map_err(|_wrong| LockError::Wrong)?);
        let mut bytes = Zeroizing::new([0; SECRET_LEN]);
        bytes.copy_from_slice(&opened);
        let keys = SecretKeys::from_bytes(&bytes);
        if *keys.public() == self.public { Ok(keys) } else { Err(LockError::Wrong) }
    }

    /// Returns the public keys.
    #[must_use]
    pub const fn public(&self) -> &PublicKeys {
        &self.public
    }

    fn cipher(&self, passphrase: &str) -> Result<XChaCha20Poly1305, LockError> {
        let params = Params::new(self.cost.memory, self.cost.passes, 1, Some(32));
        let params = params.expect("costs have been checked");
        let mut key = Zeroizing::new([0; 32]);
        Argon2::new(Algorithm::Argon2id, Version::V0x13, params)
            .hash_password_into(passphrase.as_bytes(), &self.salt, &mut *key)
            .map_err(|_no_memory| LockError::Memory)?;
        Ok(XChaCha20Poly1305::new((&*key).into()))
    }

    /// Returns the bytes before the encrypted secret, which are authenticated.
    fn head(&self) -> Vec<u8> {
        let mut writer = Writer::new(LOCKED);
        writer.fixed(&self.cost.memory.to_be_bytes());
        writer.fixed(&self.cost.passes.to_be_bytes());
        writer.fixed(&self.salt);
        writer.fixed(&self.nonce);
        writer.fixed(&self.public.to_bytes());
        writer.finish()
    }

    /// Returns the bytes of the file in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.head();
        bytes.extend_from_slice(&self.ciphertext);
        bytes
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// If the bytes are not locked keys.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, LOCKED, LOCKED_MAX)?;
        let mut number = || reader.fixed().map(u32::from_be_bytes);
        let cost = Cost::from_numbers(number()?, number()?)?;
        let (salt, nonce) = (reader.fixed()?, reader.fixed()?);
        let public = PublicKeys::from_bytes(&reader.fixed::<PUBLIC_LEN>()?)?;
        let ciphertext = reader.fixed()?;
        reader.finish()?;
        Ok(Self { cost, salt, nonce, public, ciphertext })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_passphrase_that_everybody_tries_first_is_refused() {
        for common in [
            "12345678",
            "1234567890",
            "87654321",
            "abcdefgh",
            "ABCDEFGHI",
            "aaaaaaaa",
            "abababab",
            "Password",
            "qwertyui",
        ] {
            assert!(is_guessable(common), "{common}");
        }
        for good in ["correct horse battery", "walrus copper lantern", "k7#pQ2!x", "einszweidrei", "20261129"] {
            assert!(!is_guessable(good), "{good}");
        }
    }

    #[test]
    fn only_the_passphrase_opens_keys() {
        let mut entropy = Entropy::new(&[3; 32]);
        let keys = SecretKeys::generate(&mut entropy);
        let locked = LockedKeys::lock(&keys, "correct horse", Cost::TEST, &mut entropy).unwrap();
        let locked = LockedKeys::from_bytes(&locked.to_bytes()).unwrap();
        assert_eq!(*locked.unlock("correct horse").unwrap().to_bytes(), *keys.to_bytes());
        assert_eq!(locked.unlock("correct horsf").unwrap_err(), LockError::Wrong);
        let short = LockedKeys::lock(&keys, "1234567", Cost::TEST, &mut entropy);
        assert_eq!(short.unwrap_err(), LockError::Passphrase);
        for at in 0..locked.to_bytes().len() {
            let mut changed = locked.to_bytes();
            changed[at] ^= 1;
            // A changed cost only makes opening slower; all other changes are noticed.
            let read = LockedKeys::from_bytes(&changed).ok().filter(|read| read.cost == Cost::TEST);
            assert!(read.is_none_or(|read| read.unlock("correct horse").is_err()), "byte {at}");
        }
    }

    #[test]
    fn a_file_cannot_ask_for_all_memory() {
        for (memory, passes) in [(7, 1), ((1 << 20) + 1, 1), (8, 0), (8, 17)] {
            assert!(Cost::from_numbers(memory, passes).is_err());
        }
    }
}
