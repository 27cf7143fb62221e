//! Recognises words of other languages and answers each with the word of this one.

use super::Parser;
use super::expression::INFIX;
use crate::diagnostic::Code;
use crate::syntax::SyntaxKind::{self, Ampersand, Bar, Ident, LeftBrace, LeftParen};

/// Words of other languages that begin an operand there, and what to write here.
const HABITS: [(&str, &str); 10] = [
    (
        "if",
        "to go on by how a process has ended, write `p : match { found => q, else => r }`; when it fails, `p else q`",
    ),
    ("while", "`a ;; b` runs them in turn for ever, `(a ;; b) # until` until something else ends"),
    ("loop", "`a ;; b` runs them in turn for ever, `(a ;; b) # until` until something else ends"),
    ("for", "`all i in 0..4 (a[i])` runs one of each beside the others"),
    ("repeat", "`a ; a ; a` runs it three times, `a ;; wait(1 s)` for ever, and `retry(3) a` again when it fails"),
    ("timeout", "a time limit stands behind what it limits: `a within 5 s`"),
    ("parallel", "`a, b` runs both; `a & b` too, and fails when one does; `a # b` until one has ended"),
    ("par", "`a, b` runs both; `a & b` too, and fails when one does; `a # b` until one has ended"),
    ("seq", "`a ; b` runs b when a is done"),
    ("try", "`a else b` runs b when a fails, `a finally b` however it ends"),
];
/// The words of other languages before a condition without brackets.
const BARE: [&str; 3] = ["if", "while", "for"];

impl Parser<'_> {
    /// A word of another language where an operand begins: it is reported, and skipped with its brackets. Returns whether
    /// that was the whole operand.
    pub(super) fn habit(&mut self) -> bool {
        let Some((word, help)) = HABITS.iter().find(|(word, _)| self.at_word(word)) else { return false };
        let has_bracket = [LeftParen, LeftBrace].contains(&self.kind(1));
        let has_condition = BARE.contains(word) && self.kind(1) == Ident && !INFIX.contains(&self.word(1));
        if self.ends_block() || !has_bracket && !has_condition {
            return false;
        }
        if let Some(diagnostic) = self.report(Code::E0001, format!("`{word}` is no word of this language")) {
            diagnostic.help.push((*help).to_owned());
        }
        self.start(SyntaxKind::Error);
        self.bump();
        let mut is_whole = self.at(LeftParen) && self.is_last_bracket();
        if self.at(LeftParen) {
            self.skip_tree();
        } else if self.kind(1) == LeftBrace {
            self.bump();
        }
        while self.at(LeftBrace) {
            self.skip_tree();
            is_whole = true;
            if self.kind(1) == LeftBrace {
                self.eat_word("else");
            }
        }
        self.finish();
        is_whole
    }

    /// Whether nothing follows the brackets that begin here, so that they are the operand: `parallel(a, b)`.
    fn is_last_bracket(&self) -> bool {
        let mut depth = 0_usize;
        for ahead in 0.. {
            if self.kind(ahead) == SyntaxKind::End {
                break;
            }
            depth += usize::from(self.kind(ahead) == LeftParen);
            depth -= usize::from(self.kind(ahead) == SyntaxKind::RightParen);
            if depth == 0 {
                return ![LeftParen, LeftBrace, Ident].contains(&self.kind(ahead + 1))
                    || INFIX.contains(&self.word(ahead + 1));
            }
        }
        true
    }

    /// `||` and `&&`, of which the first token comes next: reports them, and skips all of it but the last token.
    pub(super) fn foreign_operator(&mut self) {
        let is_or = self.at(Bar);
        let is_double = self.kind(1) == self.kind(0) && (is_or || self.at(Ampersand));
        if !is_or && !is_double {
            return;
        }
        let (operator, help) = match (is_or, is_double) {
            (true, true) => ("||", "`a, b` runs both; `a # b` until one has ended; `a else b` runs b when a fails"),
            (true, false) => ("|", "`a, b` runs both; `a # b` until one has ended; `a else b` runs b when a fails"),
            (false, _) => ("&&", "`a & b` runs both, and fails when one does; `a ; b` runs b when a is done"),
        };
        if let Some(diagnostic) = self.report(Code::E0001, format!("`{operator}` is not an operator")) {
            diagnostic.help.push(help.to_owned());
        }
        if is_double {
            self.bump();
        }
    }
}
