//! How the parser finds its feet again.

use super::Parser;
use crate::syntax::SyntaxKind::{
    self, End, Ident, LeftBrace, LeftBracket, LeftParen, RightBrace, RightBracket, RightParen, Semicolon,
};

/// The words that open a section of a process.
pub(super) const SECTIONS: [&str; 5] =
    ["host", "instantiated_processes", "external_io", "internal_connections", "internal_event_actions"];
/// The words that open an item of a file.
pub(super) const ITEMS: [&str; 2] = ["process", "module"];

impl Parser<'_> {
    /// Whether a section surely starts `ahead` tokens from here: its word and its bracket, or `resource name`.
    pub(super) fn is_section(&self, ahead: usize) -> bool {
        let opens = self.kind(ahead + 1) == LeftBrace
            || self.kind(ahead + 1) == LeftParen && self.word(ahead) == "internal_connections";
        let declares = self.word(ahead) == "resource"
            && self.kind(ahead + 1) == Ident
            && [SyntaxKind::Comma, Semicolon].contains(&self.kind(ahead + 2));
        self.kind(ahead) == Ident && (SECTIONS.contains(&self.word(ahead)) && opens || declares)
    }

    /// Whether an item surely starts `ahead` tokens from here: its word, its name and its bracket, `const name =`, or
    /// `use "file"`.
    pub(super) fn is_item(&self, ahead: usize) -> bool {
        let (first, second) = (self.kind(ahead + 1), self.kind(ahead + 2));
        if self.kind(ahead) == Ident && self.word(ahead) == "const" {
            return first == Ident && second == SyntaxKind::Equals;
        }
        if self.kind(ahead) == Ident && self.word(ahead) == "use" {
            return first == SyntaxKind::Text;
        }
        let opens = self.kind(ahead + 2) == LeftParen || self.kind(ahead + 2) == LeftBrace;
        self.kind(ahead) == Ident && ITEMS.contains(&self.word(ahead)) && self.kind(ahead + 1) == Ident && opens
    }

    /// Whether the list that is being read ends here, by its brace or because something else begins.
    pub(super) fn ends_block(&self) -> bool {
        self.at(RightBrace) || self.at(End) || self.is_section(0) || self.is_item(0)
    }

    /// Skips to just after the next `;`, or to the end of the block.
    pub(super) fn skip_statement(&mut self) {
        if self.at(Semicolon) || self.ends_block() {
            self.eat(Semicolon);
            return;
        }
        self.start(SyntaxKind::Error);
        while !self.at(Semicolon) && !self.ends_block() {
            self.skip_tree();
        }
        self.finish();
        self.eat(Semicolon);
    }

    /// Skips one token, or everything between a bracket and its counterpart.
    pub(super) fn skip_tree(&mut self) {
        let mut depth = 0_usize;
        loop {
            if self.at_any(&[LeftParen, LeftBrace, LeftBracket]) {
                depth += 1;
            } else if self.at_any(&[RightParen, RightBrace, RightBracket]) {
                depth = depth.saturating_sub(1);
            }
            self.bump();
            if depth == 0 || self.at(End) || self.is_section(0) || self.is_item(0) {
                break;
            }
        }
    }

    /// Skips one token, or one bracketed stretch, into an error node.
    pub(super) fn skip_as_error(&mut self) {
        self.start(SyntaxKind::Error);
        self.skip_tree();
        self.finish();
    }

    /// Reads `item , item ... close`. A missing comma or close is reported and taken as read.
    pub(super) fn list(&mut self, close: SyntaxKind, what: &str, item: fn(&mut Self) -> bool) {
        while !self.at(close) {
            if !item(self) {
                self.expected(what);
                if self.at_any(&[SyntaxKind::Comma]) {
                    self.bump();
                    continue;
                }
                break;
            }
            if self.eat(SyntaxKind::Comma) || self.at(close) {
                continue;
            }
            let goes_on = self.at_any(&[Ident, SyntaxKind::Text, SyntaxKind::Number]) && !self.ends_block();
            if !goes_on || (self.kind(1) != SyntaxKind::Comma && self.kind(1) != close) {
                break;
            }
            self.expect(SyntaxKind::Comma);
        }
        self.expect(close);
    }
}
