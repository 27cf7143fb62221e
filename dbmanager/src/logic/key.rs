//! Keys are paths such as `robot/r2/camera/gain`. The namespace of a key says who may write it.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;
use thiserror::Error;

/// The longest key, in bytes.
pub const KEY_SIZE_MAX: usize = 512;

/// Segments joined by `/`: none is empty, none has a character that key expressions give a meaning.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Key(Arc<str>);

/// Why a text is not a key.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum KeyError {
    /// Longer than [`KEY_SIZE_MAX`].
    #[error("a key of {size} bytes is longer than {KEY_SIZE_MAX}")]
    Long {
        /// Its size.
        size: usize,
    },
    /// A segment without a character.
    #[error("the key `{key}` has an empty segment")]
    Empty {
        /// The text.
        key: String,
    },
    /// A segment that means another place in a path of files.
    #[error("the key `{key}` has a segment `{segment}`: a key is a name, not a path of files")]
    Path {
        /// The text.
        key: String,
        /// The first such segment.
        segment: String,
    },
    /// A character with a meaning of its own, or one that cannot be seen.
    #[error("the key `{key}` has a forbidden character: {character:?}")]
    Character {
        /// The text.
        key: String,
        /// The first such character.
        character: char,
    },
}

/// The namespace of a key, by its first segment: who may write it, and how far it travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Namespace<'a> {
    /// `team/…`: everybody's. So is everything that is in no other namespace.
    Team,
    /// `robot/<name>/…`: only that robot writes, everybody reads.
    Robot(&'a str),
    /// `sys/…`: members, retirements; written by the database itself.
    System,
    /// `local/…`: never leaves the robot.
    Local,
}

impl Key {
    /// Returns the key that `text` is.
    ///
    /// # Errors
    /// If it is none.
    pub fn new(text: impl Into<String>) -> Result<Self, KeyError> {
        let key = Self::stored(text.into())?;
        match key.0.split('/').find(|segment| matches!(*segment, "." | "..")) {
            Some(segment) => Err(KeyError::Path { key: key.to_string(), segment: segment.to_owned() }),
            None => Ok(key),
        }
    }

    /// Returns the key that `text` is, which an earlier version may have written: it took `.` and `..`.
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

    /// Returns its namespace.
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
