//! Source texts and places in them.

mod lines;

pub use lines::{Lines, Texts};

/// The longest text that can be read, in bytes.
pub const SOURCE_MAX: usize = 16 * 1024 * 1024;

/// A named text: a spec, or the interfaces of some modules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The name in diagnostics, usually a path.
    pub name: String,
    /// The content.
    pub text: String,
    /// The role of the text in the spec.
    pub role: Role,
}

/// The role of a text in the spec that is compiled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Role {
    /// The spec itself, or the interfaces that a program prints.
    Whole,
    /// The interfaces that a program in Python prints. The name is the `exec` of its modules, without their own names. Only these modules
    /// have these interfaces.
    Python,
    /// A file that the spec uses, directly or through other files.
    Part,
    /// A folder that the spec uses, with the names of its specs. Each of them is a part. The text of this source is empty.
    Folder(Vec<String>),
    /// A file or folder that the spec uses, but that could not be read, for this reason. It may also be the `exec` of a module whose Python
    /// program was asked for its interface and failed.
    Missing(String),
}

impl Source {
    /// Returns a source that diagnostics call `name`.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), text: text.into(), role: Role::Whole }
    }

    /// Returns the command of the program in Python that has printed this text.
    pub(crate) fn python(&self) -> Option<String> {
        (self.role == Role::Python).then(|| self.name.clone())
    }
}

/// A line and a column. Both are counted from 1, and columns count characters.
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
    /// An interface, by its index in the list.
    Interface(u32),
}

/// A range of bytes in one of the texts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Span {
    /// The text.
    pub origin: Origin,
    /// The first byte.
    pub start: u32,
    /// The byte after the last one.
    pub end: u32,
}

impl Span {
    /// Returns the empty span at the start of this span.
    pub fn at_start(self) -> Self {
        Self { end: self.start, ..self }
    }

    /// Returns the empty span at the end of this span.
    pub fn at_end(self) -> Self {
        Self { start: self.end, ..self }
    }

    /// Returns whether `other` lies within this span.
    pub fn contains(self, other: Self) -> bool {
        self.origin == other.origin && self.start <= other.start && other.end <= self.end
    }
}
