//! Parses the policies of an instance, in braces behind it, and the supervision of a group.

use super::Parser;
use crate::diagnostic::Fix;
use crate::similar;
use crate::syntax::SyntaxKind::{self, Ident, Minus, Number, Text};

/// The words that open a policy.
const POLICIES: [&str; 16] = [
    "runs_in",
    "restart",
    "replace",
    "backoff",
    "watchdog",
    "ready",
    "on_agent_loss",
    "on_link_loss",
    "memory",
    "cpu",
    "cores",
    "pids",
    "files",
    "file_size",
    "nice",
    "realtime",
];

/// The words that open a rule of the supervision of a group.
const RULES: [&str; 3] = ["strategy", "restarts", "backoff"];

impl Parser<'_> {
    /// `restart transient;`, `backoff 100 ms to 30 s;`, `on_agent_loss stop within 3 s;`, `memory 200 MB;`
    pub(super) fn policy(&mut self) {
        self.ruled_by(&POLICIES, "a policy");
    }

    /// `strategy one_for_all;`, `restarts 3 within 10 s;`
    pub(super) fn supervision_rule(&mut self) {
        self.ruled_by(&RULES, "`strategy`, `restarts` or `backoff`");
    }

    /// A statement that one of these words opens.
    fn ruled_by(&mut self, openers: &[&'static str], expected: &str) {
        if !self.at(Ident) || !openers.contains(&self.word(0)) {
            let (span, meant) = (self.span(), similar::nearest(self.word(0), openers.iter().copied()));
            let diagnostic = self.expected(expected);
            if let (Some(diagnostic), Some(word)) = (diagnostic, meant) {
                diagnostic.choices.push(Fix::replace(span, word));
            }
            return self.skip_statement();
        }
        // `runs_in "my-base" "main/wheels";`
        let takes_texts = self.word(0) == "runs_in";
        self.start(SyntaxKind::Policy);
        self.bump();
        while takes_texts && self.at_any(&[Ident, Text]) && !self.ends_block() {
            if self.at(Ident) {
                self.bump();
            } else {
                self.constant();
            }
        }
        if self.at(Number) && self.kind(1) == Ident && self.word(1) == "within" {
            // A count; else the word would be its unit.
            self.bump();
        }
        while self.at_any(&[Ident, Number, Minus]) && !self.ends_block() {
            if self.at(Ident) {
                self.bump();
            } else {
                self.constant();
            }
        }
        self.end_statement();
        self.finish();
    }
}
