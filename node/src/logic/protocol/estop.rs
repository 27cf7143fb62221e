//! Messages of `dca estop`: everything on a node stops at once, and nothing begins there until a user releases it.

use crate::logic::printable::printable;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The longest name or reason that is stored, in characters.
const WORDS_MAX: usize = 200;

/// The user who has stopped everything on a node, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Estop {
    /// The user, such as `ann@c1`. The name is not checked.
    pub by: String,
    /// The reason in the user's own words; may be empty.
    pub reason: String,
}

impl Estop {
    /// Returns this stop with its texts cut to the longest length that is stored.
    #[must_use]
    pub fn bounded(&self) -> Self {
        let bounded = |text: &str| text.chars().take(WORDS_MAX).collect();
        Self { by: bounded(&self.by), reason: bounded(&self.reason) }
    }
}

/// Formats the stop: `everything was stopped by ann@c1: a person in the cell`.
impl fmt::Display for Estop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "everything was stopped by {}", printable(&self.by).replace('\n', " "))?;
        if self.reason.is_empty() { Ok(()) } else { write!(f, ": {}", printable(&self.reason).replace('\n', " ")) }
    }
}

/// The answer to [`super::Request::Estop`]. No program of a deployment runs on the node, except for the programs in `unended`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Estopped {
    /// Absolute paths of programs that could not be ended, with their deployment: `door@3 main/base/wheels`. A program
    /// that has ended is also in the list if work outside of it may continue. Then a description of this work follows.
    pub unended: Vec<String>,
    /// Why the disk of the node could not store the stop. Then the node may not know after its next start that everything is stopped.
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
