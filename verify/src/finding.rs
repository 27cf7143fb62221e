//! The answer of the verification to one question.

use crate::explore::Reached;
use crate::story::Story;
use language::{Code, Diagnostic, Label, Severity, Span};

/// The answer to a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The property holds in every order of events.
    Proved,
    /// The property does not hold.
    Fails,
    /// The question was not decided.
    Open,
}

/// A question with its answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The answer.
    pub verdict: Verdict,
    /// The answer in a sentence.
    pub sentence: String,
    /// Why the property does not hold, with places in the text.
    pub diagnostic: Option<Diagnostic>,
    /// The way to the violation.
    pub story: Option<Story>,
    /// An assumption of this proof, in addition to the assumptions of every proof.
    pub assumes: Option<Assumption>,
    /// The place of the answered sentence; none for a question of the catalogue.
    pub place: Option<Span>,
}

/// An assumption of a proof. If it does not hold, something else may happen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assumption {
    /// The assumption, and the possible behaviour if it does not hold: "no host is lost: once `c2` is cut off, both
    /// may run".
    pub text: String,
    /// A run in which the assumption does not hold.
    pub story: Option<Story>,
}

impl Finding {
    pub(crate) fn proved(sentence: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Proved,
            sentence: sentence.into(),
            diagnostic: None,
            story: None,
            assumes: None,
            place: None,
        }
    }

    pub(crate) fn open(sentence: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Open,
            sentence: sentence.into(),
            diagnostic: None,
            story: None,
            assumes: None,
            place: None,
        }
    }

    pub(crate) fn fails(diagnostic: Diagnostic, story: Option<Story>) -> Self {
        let sentence = diagnostic.message.clone();
        Self { verdict: Verdict::Fails, sentence, diagnostic: Some(diagnostic), story, assumes: None, place: None }
    }
}

/// A diagnostic without reasons and help.
pub(crate) fn diagnostic(code: Code, span: Span, message: impl Into<String>) -> Diagnostic {
    Diagnostic {
        severity: Severity::Error,
        code,
        message: message.into(),
        primary: Label { span, text: String::new() },
        secondary: Vec::new(),
        help: Vec::new(),
        fix: None,
        choices: Vec::new(),
    }
}

/// Adds the place of a reason.
pub(crate) fn reason(mut diagnostic: Diagnostic, span: Span, text: impl Into<String>) -> Diagnostic {
    diagnostic.secondary.push(Label { span, text: text.into() });
    diagnostic
}

/// Adds advice.
pub(crate) fn help(mut diagnostic: Diagnostic, text: impl Into<String>) -> Diagnostic {
    diagnostic.help.push(text.into());
    diagnostic
}

impl Reached {
    /// Returns the limit in words, and how to raise it.
    pub fn words(self) -> &'static str {
        match self {
            Self::States => "the limit of states was reached (--states)",
            Self::Memory => "the limit of memory was reached (--memory)",
            Self::Time => "the limit of time was reached (--seconds)",
            Self::Values => "a spec can have at most 255 outcomes and reasons of failures",
            Self::Inside => "a group inside was not examined completely",
        }
    }
}
