//! The answer of a verification to one question.

use crate::explore::Reached;
use crate::story::Story;
use language::{Code, Diagnostic, Label, Severity, Span};

/// The answer to a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It holds in every order of events.
    Proved,
    /// It does not hold.
    Fails,
    /// It was not decided.
    Open,
}

/// A question with its answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The answer.
    pub verdict: Verdict,
    /// The answer in a sentence.
    pub sentence: String,
    /// Why it does not hold, with places in the text.
    pub diagnostic: Option<Diagnostic>,
    /// The way to the violation.
    pub story: Option<Story>,
    /// The assumption that this proof makes, beside the assumptions of every proof.
    pub assumes: Option<Assumption>,
    /// The place of the sentence that it answers; none if it is a question of the catalogue.
    pub place: Option<Span>,
}

/// An assumption of a proof. Without it, something else may happen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assumption {
    /// The assumption, and the possible behaviour without it: "no host is lost: once `c2` is cut off, both may run".
    pub text: String,
    /// How that happens.
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

/// Adds a place where the reason is.
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
    /// The limit in words, and how to raise it.
    pub fn words(self) -> &'static str {
        match self {
            Self::States => "the limit of states was reached (--states)",
            Self::Memory => "the limit of memory was reached (--memory)",
            Self::Time => "the limit of time was reached (--seconds)",
            Self::Inside => "a group inside was not looked at whole",
        }
    }
}
