//! Remarks: the parts of a file that have another meaning in the spec, or are missing there.

use crate::launch::Place;
use crate::name;
use crate::xml::{Node, place};
use std::fmt;

/// How far a part of a file has a counterpart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RemarkKind {
    /// The part has a counterpart that differs in a detail.
    Differs,
    /// The part has no counterpart, or a person has to complete it.
    Missing,
}

/// A part of a file that means something else in the spec, or is missing there.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Remark {
    /// The name of the file.
    pub file: String,
    /// The line of the part, from 1.
    pub line: u32,
    /// The column of the part, from 1.
    pub column: u32,
    /// How far the part has a counterpart.
    pub kind: RemarkKind,
    /// The sentence for people.
    pub text: String,
}

impl Remark {
    /// Returns a remark about an element.
    pub(crate) fn new(file: &str, node: Node<'_>, kind: RemarkKind, text: impl AsRef<str>) -> Self {
        let (line, column) = place(node);
        Self { file: file.into(), line, column, kind, text: name::plain(text.as_ref()) }
    }

    /// Returns a remark about an action of a launch file.
    pub(crate) fn about(file: &str, place: Place, kind: RemarkKind, text: &str) -> Self {
        Self { file: file.into(), line: place.line, column: place.column, kind, text: name::plain(text) }
    }

    /// Returns the remark as a comment of a spec, with the end of its line.
    pub(crate) fn comment(&self) -> String {
        format!("// import: line {}: {}\n", self.line, self.text)
    }
}

/// As a line for people.
impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}: {}", self.file, self.line, self.column, self.text)
    }
}
