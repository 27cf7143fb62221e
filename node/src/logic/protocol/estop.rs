//! Messages of `dca estop`: everything on a node stops at once, and nothing begins there until a user releases it.

use crate::logic::printable::printable;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The longest name or reason that is kept, in characters.
const WORDS_MAX: usize = 200;

/// The user who has stopped everything on a node, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Estop {
    /// A user, such as `ann@c1`, as the user says.
    pub by: String,
    /// The user's words; may be empty.
    pub reason: String,
}

impl Estop {
    /// Returns this stop with its texts cut to the length that is kept.
    #[must_use]
    pub fn bounded(&self) -> Self {
        let bounded = |text: &str| text.chars().take(WORDS_MAX).collect();
        Self { by: bounded(&self.by), reason: bounded(&self.reason) }
    }
}

/// `everything was stopped by ann@c1: a person in the cell`
impl fmt::Display for Estop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "everything was stopped by {}", printable(&self.by).replace('\n', " "))?;
        if self.reason.is_empty() { Ok(()) } else { write!(f, ": {}", printable(&self.reason).replace('\n', " ")) }
    }
}

/// The answer to [`super::Request::Estop`]: no program of a deployment runs on the node, except those named.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Estopped {
    /// Absolute paths of programs that could not be ended, with their deployment: `door@3 main/base/wheels`. A
    /// program that has ended is in the list if work outside of it may go on, with a description of the work.
    pub unended: Vec<String>,
    /// Why the disk of the node does not have it; then the next start of the node may not know that everything is stopped.
    pub unwritten: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_others_move_no_cursor_and_have_an_end() {
        let estop = Estop { by: "ann@c1".into(), reason: "a person\nin \u{1b}[2Jthe cell".into() };
        assert_eq!(estop.to_string(), "everything was stopped by ann@c1: a person in \\x1b[2Jthe cell");
        let long = Estop { by: "é".repeat(1000), reason: String::new() }.bounded();
        assert_eq!(long.by.chars().count(), WORDS_MAX);
    }
}
