//! Parses `verify` blocks: sentences that the checker reads word by word.

use super::Parser;
use crate::syntax::SyntaxKind::{self, End, Ident, RightBrace, Semicolon};

impl Parser<'_> {
    /// `verify Name { sentence; sentence; }`; inside a process, it has the name of the process.
    pub(super) fn properties(&mut self) {
        self.start(SyntaxKind::Verify);
        self.bump();
        self.eat(Ident);
        self.statements(Self::sentence);
        self.finish();
    }

    /// Words, names, numbers and signs up to the `;`.
    fn sentence(&mut self) {
        self.start(SyntaxKind::Sentence);
        while !self.at_any(&[Semicolon, SyntaxKind::Recur, RightBrace, End]) && !self.is_item(0) {
            self.bump();
        }
        self.end_statement();
        self.finish();
    }
}
