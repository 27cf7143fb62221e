//! Source texts and places in them.

mod lines;

pub use lines::{Lines, Texts};

/// The longest text that is read, in bytes.
pub const SOURCE_MAX: usize = 16 * 1024 * 1024;

/// A named text: a spec, or the interfaces of some modules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The name in diagnostics, usually a path.
    pub name: String,
    /// Its content.
    pub text: String,
    /// The part that this text has in the spec.
    pub role: Role,
}

/// The role of a text in the spec that is compiled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Role {
    /// The spec itself, or the interfaces that a program prints of itself.
    Whole,
    /// A file that the spec uses, directly or through others.
    Part,
    /// A folder that it uses: the names of the specs in it, each a part. The text is empty.
    Folder(Vec<String>),
    /// A file or folder that it uses but that could not be read, for this reason; or the `exec` of a module whose program in Python was
    /// asked for its interface, and failed.
    Missing(String),
}

impl Source {
    /// Returns a source that diagnostics call `name`.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), text: text.into(), role: Role::Whole }
    }
}

/// A line and a column, both counted from 1; columns count characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// The line.
    pub line: usize,
    /// The column.
    pub column: usize,
}

/// The text that a span is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// The spec.
    Spec,
    /// An interface, by its place in the list.
    Interface(u32),
}

/// A range of bytes in one of the texts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Span {
    /// The text.
    pub origin: Origin,
    /// First byte.
    pub start: u32,
    /// One after the last byte.
    pub end: u32,
}

impl Span {
    /// Returns the empty span where this one starts.
    pub fn at_start(self) -> Self {
        Self { end: self.start, ..self }
    }

    /// Returns the empty span where this one ends.
    pub fn at_end(self) -> Self {
        Self { start: self.end, ..self }
    }

    /// Returns whether `other` lies within this span.
    pub fn contains(self, other: Self) -> bool {
        self.origin == other.origin && self.start <= other.start && other.end <= self.end
    }
}
