//! Diagnostics as data. [`render`] writes them as text.

mod code;
mod render;

use crate::similar::Near;
use crate::source::{Origin, Span};

pub use code::Code;
pub use render::{Style, render};

/// The severity of a diagnostic. A spec with an error has no plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The spec has no plan.
    Error,
    /// The spec runs, but perhaps not as intended.
    Warning,
}

/// A place with a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// The place in one of the texts.
    pub span: Span,
    /// The text at the place. It may be empty.
    pub text: String,
}

/// One replacement in a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Edit {
    /// The text that is replaced. An empty span inserts the new text.
    pub span: Span,
    /// The new text.
    pub text: String,
}

/// A change that corrects a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fix {
    /// The description of the change: "replace with `puma`".
    pub title: String,
    /// The replacements, all in one text.
    pub edits: Vec<Edit>,
}

/// One diagnostic of a spec.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// An error or a warning.
    pub severity: Severity,
    /// The code. The meaning of a code never changes.
    pub code: Code,
    /// The diagnostic in one sentence.
    pub message: String,
    /// The place of the mistake.
    pub primary: Label,
    /// The places of the reasons.
    pub secondary: Vec<Label>,
    /// Advice for the author, one sentence each.
    pub help: Vec<String>,
    /// The change that removes the diagnostic, if only one reading is possible. It is applied without a question.
    pub fix: Option<Fix>,
    /// Changes that would remove the diagnostic. A person may choose one.
    pub choices: Vec<Fix>,
}

/// The largest number of diagnostics that are kept for one spec. A person sees at most a hundred. `dca fix` and editors
/// use more.
pub(crate) const DIAGNOSTICS_MAX: usize = 10_000;
/// The largest number of secondary places of one diagnostic.
pub(crate) const REASONS_MAX: usize = 12;

impl Fix {
    /// Replaces the text in `span` by `text`.
    pub(crate) fn replace(span: Span, text: &str) -> Self {
        Self { title: format!("replace with `{text}`"), edits: vec![Edit { span, text: text.to_owned() }] }
    }
}

impl Diagnostic {
    pub(crate) fn new(code: Code, span: Span, message: impl Into<String>) -> Self {
        Self {
            severity: code.severity(),
            code,
            message: message.into(),
            primary: Label { span, text: String::new() },
            secondary: Vec::new(),
            help: Vec::new(),
            fix: None,
            choices: Vec::new(),
        }
    }

    pub(crate) fn label(mut self, text: impl Into<String>) -> Self {
        self.primary.text = text.into();
        self
    }

    /// Adds a place that explains the diagnostic. Only the first places are kept.
    pub(crate) fn reason(mut self, span: Span, text: impl Into<String>) -> Self {
        if self.secondary.len() < REASONS_MAX {
            self.secondary.push(Label { span, text: text.into() });
        }
        self
    }

    pub(crate) fn help(mut self, text: impl Into<String>) -> Self {
        self.help.push(text.into());
        self
    }

    pub(crate) fn fix(mut self, title: impl Into<String>, edits: Vec<Edit>) -> Self {
        self.fix = Some(Fix { title: title.into(), edits });
        self
    }

    /// Adds a fix that replaces `span` by `text`. No other reading is possible.
    pub(crate) fn replace(mut self, span: Span, text: &str) -> Self {
        self.fix = Some(Fix::replace(span, text));
        self
    }

    /// Offers to replace `span` by `text`.
    pub(crate) fn choose(mut self, span: Span, text: &str) -> Self {
        self.choices.push(Fix::replace(span, text));
        self
    }

    /// Offers names that resemble the name in `span`. If one differs only in case or `_`, it becomes the fix.
    pub(crate) fn rename(self, span: Span, near: &Near<'_>) -> Self {
        match near.is_same {
            true => self.replace(span, near.name),
            false => std::iter::once(&near.name).chain(&near.others).fold(self, |found, name| found.choose(span, name)),
        }
    }
}

/// Returns the spec's text with every fix applied. Of two overlapping fixes, only the first in the text is applied.
pub fn apply_fixes(text: &str, diagnostics: &[Diagnostic]) -> String {
    applied(text, diagnostics.iter().filter_map(|diagnostic| diagnostic.fix.as_ref()).collect())
}

/// Returns the spec's text with a fix applied. The text is unchanged if the fix belongs to another text.
pub fn apply_fix(text: &str, fix: &Fix) -> String {
    applied(text, vec![fix])
}

fn applied(text: &str, mut fixes: Vec<&Fix>) -> String {
    fixes.retain(|fix| fix.edits.iter().all(|edit| fits(text, edit)) && are_apart(&fix.edits));
    fixes.sort_by_key(|fix| fix.edits.iter().map(|edit| edit.span.start).min());
    let mut taken: Vec<&Edit> = Vec::new();
    for fix in fixes {
        let is_free = |edit: &Edit| taken.iter().all(|other| !overlap(other.span, edit.span));
        if fix.edits.iter().all(is_free) {
            taken.extend(&fix.edits);
        }
    }
    taken.sort_by_key(|edit| edit.span);
    let mut fixed = String::with_capacity(text.len());
    let mut end = 0;
    for edit in taken {
        fixed.push_str(&text[end..edit.span.start as usize]);
        fixed.push_str(&edit.text);
        end = edit.span.end as usize;
    }
    fixed.push_str(&text[end..]);
    fixed
}

fn fits(text: &str, edit: &Edit) -> bool {
    edit.span.origin == Origin::Spec && text.get(edit.span.start as usize..edit.span.end as usize).is_some()
}

fn are_apart(edits: &[Edit]) -> bool {
    let is_free = |(at, edit): (usize, &Edit)| edits[..at].iter().all(|other| !overlap(other.span, edit.span));
    edits.iter().enumerate().all(is_free)
}

/// Keeps as many diagnostics as allowed, errors rather than warnings, in their order. Returns how many are left out.
pub(crate) fn limit(diagnostics: &mut Vec<Diagnostic>) -> usize {
    let Some(omitted) = diagnostics.len().checked_sub(DIAGNOSTICS_MAX) else { return 0 };
    let errors = diagnostics.iter().filter(|found| found.severity == Severity::Error).count().min(DIAGNOSTICS_MAX);
    let (mut errors, mut warnings) = (errors, DIAGNOSTICS_MAX - errors);
    diagnostics.retain(|found| {
        let room = if found.severity == Severity::Error { &mut errors } else { &mut warnings };
        let is_kept = *room > 0;
        *room -= usize::from(is_kept);
        is_kept
    });
    omitted
}

/// Returns whether two spans overlap: they share a byte, or start at the same place.
fn overlap(one: Span, other: Span) -> bool {
    one.start < other.end && other.start < one.end || one.start == other.start
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edit(start: u32, end: u32, text: &str) -> Diagnostic {
        let span = Span { origin: Origin::Spec, start, end };
        Diagnostic::new(Code::E0001, span, "").replace(span, text)
    }

    #[test]
    fn fixes_apply_in_text_order_and_the_first_of_two_wins() {
        let diagnostics = [edit(4, 5, "three"), edit(0, 1, "one"), edit(0, 3, "lost"), edit(90, 91, "outside")];
        assert_eq!(apply_fixes("1 2 3", &diagnostics), "one 2 three");
    }
}
