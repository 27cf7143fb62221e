//! Texts of a launch file after replacement of their substitutions.

use std::collections::BTreeSet;

/// A text whose substitutions were replaced.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Value {
    /// A substitution that could not be replaced stands in it as it was written.
    pub(super) text: String,
    /// The arguments of the launch file that it depends on, by number.
    pub(super) arguments: BTreeSet<usize>,
    /// Whether it is the value of one argument, and nothing else.
    pub(super) is_argument: bool,
    /// Why a substitution could not be replaced.
    pub(super) open: Option<String>,
}

impl Value {
    /// Returns a text without substitutions.
    pub(super) fn plain(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// Appends another value.
    pub(super) fn push(&mut self, other: Self) {
        if self.text.is_empty() && self.arguments.is_empty() && self.open.is_none() {
            *self = other;
            return;
        }
        if other.text.is_empty() && other.arguments.is_empty() && other.open.is_none() {
            return;
        }
        self.text += &other.text;
        self.arguments.extend(other.arguments);
        self.is_argument = false;
        self.open = self.open.take().or(other.open);
    }

    /// Returns another text that follows from this value.
    pub(super) fn into_other(self, text: impl Into<String>) -> Self {
        Self { text: text.into(), is_argument: false, ..self }
    }

    /// Returns whether it is true, if it is a truth.
    pub(super) fn truth(&self) -> Option<bool> {
        match self.text.trim().to_lowercase().as_str() {
            _ if self.open.is_some() => None,
            "true" | "1" => Some(true),
            "false" | "0" => Some(false),
            _ => None,
        }
    }
}
