//! Keys are paths such as `robot/r2/camera/gain`. The namespace of a key decides which robots may write it.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;
use thiserror::Error;

/// The longest key, in bytes.
pub const KEY_SIZE_MAX: usize = 512;

/// Segments joined by `/`. No segment is empty, or has a character with a meaning in key expressions.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Key(Arc<str>);

/// Why a text is not a key.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum KeyError {
    /// Longer than [`KEY_SIZE_MAX`].
    #[error("a key of {size} bytes is longer than {KEY_SIZE_MAX}")]
    Long {
        /// The size of the text, in bytes.
        size: usize,
    },
    /// A segment without a character.
    #[error("the key `{key}` has an empty segment")]
    Empty {
        /// The text.
        key: String,
    },
    /// A segment that means another place in a file path: `.` or `..`.
    #[error("the key `{key}` has a segment `{segment}`: a key is a name, not a path of files")]
    Path {
        /// The text.
        key: String,
        /// The first such segment.
        segment: String,
    },
    /// A segment in which letters of another script look like Latin letters.
    #[error(
        "the key `{key}` has {letter:?} (U+{:04X}) together with Latin letters that look like it: another key would look the same",
        u32::from(*letter)
    )]
    LookAlike {
        /// The text.
        key: String,
        /// The first such letter.
        letter: char,
    },
    /// A character with a meaning in key expressions, or an invisible one.
    #[error("the key `{key}` has a forbidden character: {character:?}")]
    Character {
        /// The text.
        key: String,
        /// The first such character.
        character: char,
    },
}

/// The namespace of a key, given by its first segment. It decides which robots may write the key, and how far it is replicated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Namespace<'a> {
    /// `team/…`: every robot may write. Keys outside the other namespaces also belong here.
    Team,
    /// `robot/<name>/…`: only that robot writes, every robot reads.
    Robot(&'a str),
    /// `sys/…`: members, retirements; only the database itself writes.
    System,
    /// `local/…`: never leaves the robot.
    Local,
}

impl Key {
    /// Returns `text` as a key.
    ///
    /// # Errors
    /// If the text is not a key.
    pub fn new(text: impl Into<String>) -> Result<Self, KeyError> {
        let key = Self::stored(text.into())?;
        if let Some(character) = key.0.chars().find(|character| is_unseen(*character)) {
            return Err(KeyError::Character { key: key.into(), character });
        }
        if let Some(letter) = key.0.split('/').find_map(look_alike) {
            return Err(KeyError::LookAlike { key: key.into(), letter });
        }
        match key.0.split('/').find(|segment| matches!(*segment, "." | "..")) {
            Some(segment) => Err(KeyError::Path { key: key.to_string(), segment: segment.to_owned() }),
            None => Ok(key),
        }
    }

    /// Returns a text from the store as a key. Earlier versions also accepted `.`, `..` and look-alike letters.
    fn stored(key: String) -> Result<Self, KeyError> {
        if key.len() > KEY_SIZE_MAX {
            return Err(KeyError::Long { size: key.len() });
        }
        let forbidden = |character: &char| matches!(character, '*' | '$' | '?' | '#') || character.is_control();
        if let Some(character) = key.chars().find(forbidden) {
            return Err(KeyError::Character { key, character });
        }
        if key.split('/').any(str::is_empty) {
            return Err(KeyError::Empty { key });
        }
        Ok(Self(key.into()))
    }

    /// Returns the key as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the namespace of the key.
    pub fn namespace(&self) -> Namespace<'_> {
        let (first, rest) = self.0.split_once('/').unwrap_or((&self.0, ""));
        match first {
            "robot" => Namespace::Robot(rest.split('/').next().unwrap_or(rest)),
            "sys" => Namespace::System,
            "local" => Namespace::Local,
            _ => Namespace::Team,
        }
    }
}

/// Returns whether a character is invisible or looks like a blank: blanks of other widths, direction marks, joiners, fillers.
/// Source: Unicode 16, general categories `Cf` and `Zs`, and `Default_Ignorable_Code_Point`.
fn is_unseen(character: char) -> bool {
    let is_other_blank = character != ' ' && character.is_whitespace();
    let is_ignorable = matches!(u32::from(character),
        0xad | 0x34f | 0x61c | 0x115f | 0x1160 | 0x17b4 | 0x17b5 | 0x180b..=0x180f | 0x200b..=0x200f | 0x202a..=0x202e
        | 0x2060..=0x206f | 0x3164 | 0xfe00..=0xfe0f | 0xfeff | 0xffa0 | 0xfff0..=0xfffb | 0x1bca0..=0x1bca3
        | 0x1d173..=0x1d17a | 0xe0000..=0xe0fff);
    is_other_blank || is_ignorable
}

/// Returns the first letter of a segment that looks like a Latin letter, if the segment also has Latin letters. A name entirely in
/// Greek or Cyrillic letters is valid. Source: UTS 39, section 5.2, for the scripts whose letters look like Latin ones, and
/// full-width forms.
fn look_alike(segment: &str) -> Option<char> {
    let looks_latin = |letter: &char| {
        letter.is_alphanumeric()
            && matches!(u32::from(*letter),
                0x370..=0x52f | 0x531..=0x587 | 0x13a0..=0x13ff | 0x1c80..=0x1c8f | 0x1f00..=0x1fff | 0x2c80..=0x2cff
                | 0x2de0..=0x2dff | 0xa4d0..=0xa4ff | 0xa640..=0xa69f | 0xab70..=0xabbf | 0xff10..=0xff5a | 0x1d400..=0x1d7ff)
    };
    let has_latin = segment.chars().any(|letter| letter.is_ascii_alphabetic());
    segment.chars().find(looks_latin).filter(|_| has_latin)
}

impl TryFrom<String> for Key {
    type Error = KeyError;
    fn try_from(text: String) -> Result<Self, KeyError> {
        Self::stored(text)
    }
}

impl From<Key> for String {
    fn from(key: Key) -> Self {
        key.0.as_ref().to_owned()
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_no_path_and_one_that_is_there_can_be_read() {
        for (bad, segment) in [(".", "."), ("team/../a", ".."), ("team/a/.", "."), ("../a", "..")] {
            let (key, segment) = (bad.to_owned(), segment.to_owned());
            assert_eq!(Key::new(bad), Err(KeyError::Path { key, segment }));
            assert!(postcard::from_bytes::<Key>(&postcard::to_stdvec(bad).unwrap()).is_ok());
        }
        for good in ["team/...", "team/.a", "team/a..b"] {
            assert!(Key::new(good).is_ok(), "{good}");
        }
    }

    #[test]
    fn a_key_does_not_look_like_another_one() {
        let alike = |text: &str| match Key::new(text) {
            Err(KeyError::LookAlike { letter, .. }) => Some(letter),
            _ => None,
        };
        // Cyrillic and Greek letters mixed with Latin ones, full-width letters, mathematical letters.
        for (text, letter) in [
            ("team/\u{430}b", '\u{430}'),
            ("te\u{430}m/b", '\u{430}'),
            ("a\u{3bf}", '\u{3bf}'),
            ("x\u{ff21}", '\u{ff21}'),
        ] {
            assert_eq!(alike(text), Some(letter), "{text}");
            assert!(
                postcard::from_bytes::<Key>(&postcard::to_stdvec(text).unwrap()).is_ok(),
                "one that is there can be read"
            );
        }
        let why = Key::new("team/\u{430}b").unwrap_err().to_string();
        assert!(why.contains("(U+0430) together with Latin letters"), "{why}");
        for unseen in ['\u{200b}', '\u{a0}', '\u{202e}', '\u{feff}', '\u{3164}', '\u{ad}', '\u{e0041}'] {
            let (key, character) = (format!("team/a{unseen}b"), unseen);
            assert_eq!(Key::new(key.clone()), Err(KeyError::Character { key, character }));
        }
        for good in
            ["team/a b", "команда/рука", "team/κάμερα", "team/ось_1", "チーム/腕", "team/größe", "robot/r2/温度_c"]
        {
            assert!(Key::new(good).is_ok(), "{good}");
        }
    }

    #[test]
    fn what_is_a_key() {
        for good in ["a", "team/x", "robot/r2/ä", &"k".repeat(KEY_SIZE_MAX)] {
            assert_eq!(Key::new(good).unwrap().as_str(), good);
        }
        for bad in ["", "/", "a/", "/a", "a//b", "a/*", "a?b", "a\nb", &"k".repeat(KEY_SIZE_MAX + 1)] {
            assert!(Key::new(bad).is_err(), "{bad:?}");
            assert!(postcard::from_bytes::<Key>(&postcard::to_stdvec(bad).unwrap()).is_err());
        }
    }

    #[test]
    fn namespaces() {
        let check = |text: &str, expected| assert_eq!(Key::new(text).unwrap().namespace(), expected);
        check("team/a", Namespace::Team);
        check("robotics", Namespace::Team);
        check("robot/r2/a", Namespace::Robot("r2"));
        check("robot", Namespace::Robot(""));
        check("sys/members/1", Namespace::System);
        check("local/a", Namespace::Local);
    }
}
