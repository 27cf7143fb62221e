//! Parses the policies of an instance, in braces behind it.

use super::Parser;
use crate::diagnostic::{Edit, Fix};
use crate::similar;
use crate::syntax::SyntaxKind::{self, Ident, Minus, Number};

/// The words that open a policy.
const POLICIES: [&str; 13] = [
    "restart",
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

impl Parser<'_> {
    /// `restart transient;`, `on_agent_loss stop within 3 s;`, `memory 200 MB;`
    pub(super) fn policy(&mut self) {
        if !self.at(Ident) || !POLICIES.contains(&self.word(0)) {
            let (span, meant) = (self.span(), similar::nearest(self.word(0), POLICIES));
            let diagnostic = self.expected("a policy");
            if let (Some(diagnostic), Some(word)) = (diagnostic, meant) {
                let edits = vec![Edit { span, text: word.to_owned() }];
                diagnostic.fix = Some(Fix { title: format!("replace with `{word}`"), edits });
            }
            return self.skip_statement();
        }
        self.start(SyntaxKind::Policy);
        self.bump();
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
