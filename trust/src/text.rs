//! Bytes as text that people can copy: digits and letters without `i`, `l`, `o` and `u`, and a checksum.
//!
//! Source of the alphabet: D. Crockford, *Base 32*, <https://www.crockford.com/base32.html>. Capitals are read as small letters, `o`
//! as 0, and `i` and `l` as 1.

use thiserror::Error;

const ALPHABET: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";
/// The length of a checksum in bytes: one typing error in 4 billion is not noticed.
const SUM: usize = 4;

/// Why a text could not be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum TextError {
    /// A character does not belong to the alphabet.
    #[error("it has the character `{0}`, which is not allowed in such a text")]
    Character(char),
    /// The text has the wrong length, or bits that must be 0 are not 0.
    #[error("a part of it is missing")]
    Length,
    /// The checksum does not match: a character is wrong.
    #[error("it has a typing mistake: its checksum does not fit")]
    Checksum,
    /// The text does not begin with the prefix.
    #[error("it does not begin with `{0}`")]
    Prefix(&'static str),
}

/// Returns bytes as text, with 8 characters for 5 bytes.
pub(crate) fn encode(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(5) * 8);
    let (mut bits, mut held) = (0u32, 0u32);
    for byte in bytes {
        held = (held << 8) | u32::from(*byte);
        bits += 8;
        while bits >= 5 {
            bits -= 5;
            text.push(char::from(ALPHABET[((held >> bits) & 31) as usize]));
            held &= (1 << bits) - 1;
        }
    }
    if bits > 0 {
        text.push(char::from(ALPHABET[((held << (5 - bits)) & 31) as usize]));
    }
    text
}

/// Returns the bytes of a text.
pub(crate) fn decode(text: &str) -> Result<Vec<u8>, TextError> {
    let mut bytes = Vec::with_capacity(text.len() * 5 / 8);
    let (mut bits, mut held) = (0u32, 0u32);
    for character in text.chars() {
        held = (held << 5) | value(character)?;
        bits += 5;
        if bits >= 8 {
            bits -= 8;
            bytes.push(u8::try_from(held >> bits).expect("higher bits are cleared"));
            held &= (1 << bits) - 1;
        }
    }
    // A whole number of bytes leaves fewer than 5 bits. These must be 0, so that the same bytes always have the same text.
    if bits >= 5 || held != 0 { Err(TextError::Length) } else { Ok(bytes) }
}

fn value(character: char) -> Result<u32, TextError> {
    let small = match character.to_ascii_lowercase() {
        'o' => '0',
        'i' | 'l' => '1',
        other => other,
    };
    let place = ALPHABET.iter().position(|letter| char::from(*letter) == small);
    place.and_then(|place| u32::try_from(place).ok()).ok_or(TextError::Character(character))
}

/// Returns the checksum of the bytes of a text with this prefix.
pub(crate) fn checksum(prefix: &'static str, bytes: &[u8]) -> [u8; SUM] {
    let mut hasher = blake3::Hasher::new_derive_key("dca text checksum 1");
    hasher.update(prefix.as_bytes());
    hasher.update(bytes);
    let mut sum = [0; SUM];
    sum.copy_from_slice(&hasher.finalize().as_bytes()[..SUM]);
    sum
}

/// Returns bytes as a text with a prefix and a checksum.
pub(crate) fn with_sum(prefix: &'static str, bytes: &[u8]) -> String {
    let mut all = bytes.to_vec();
    all.extend_from_slice(&checksum(prefix, bytes));
    format!("{prefix}{}", encode(&all))
}

/// Returns the bytes of a text with a prefix and a checksum; surrounding blanks are ignored.
pub(crate) fn without_sum(prefix: &'static str, text: &str) -> Result<Vec<u8>, TextError> {
    let mut bytes = decode(text.trim().strip_prefix(prefix).ok_or(TextError::Prefix(prefix))?)?;
    let at = bytes.len().checked_sub(SUM).ok_or(TextError::Length)?;
    let sum = bytes.split_off(at);
    if sum == checksum(prefix, &bytes) { Ok(bytes) } else { Err(TextError::Checksum) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_looks_alike_is_read_alike() {
        assert_eq!(encode(&[0, 1, 255]), "000zy");
        assert_eq!(decode("OO0ZY"), Ok(vec![0, 1, 255]));
        assert_eq!(decode("0u"), Err(TextError::Character('u')));
        assert_eq!(decode("000zz"), Err(TextError::Length), "the last bit must be 0");
        assert_eq!(decode("0"), Err(TextError::Length));
    }

    proptest! {
        #[test]
        fn bytes_come_back(bytes: Vec<u8>) {
            prop_assert_eq!(decode(&encode(&bytes)), Ok(bytes.clone()));
            prop_assert_eq!(without_sum("x-", &with_sum("x-", &bytes)), Ok(bytes));
        }

        #[test]
        fn a_wrong_character_is_noticed(bytes in prop::collection::vec(any::<u8>(), 1..40), at: prop::sample::Index) {
            let text = with_sum("x-", &bytes);
            let at = 2 + at.index(text.len() - 2);
            let other = if &text[at..=at] == "7" { "8" } else { "7" };
            let wrong = format!("{}{other}{}", &text[..at], &text[at + 1..]);
            prop_assert!(without_sum("x-", &wrong).is_err());
        }
    }
}
