//! Recovers after an error: finds the place where parsing continues.

use super::Parser;
use crate::syntax::SyntaxKind::{
    self, Comma, End, Equals, Ident, LeftBrace, LeftBracket, LeftParen, RightBrace, RightBracket, RightParen, Semicolon,
};

/// The words that open a section of a process.
pub(super) const SECTIONS: [&str; 8] = [
    "host",
    "instantiated_processes",
    "external_io",
    "internal_connections",
    "internal_event_actions",
    "supervision",
    "on_boot",
    "verify",
];
/// The words that open an item of a file.
pub(super) const ITEMS: [&str; 4] = ["process", "module", "verify", "activity"];

/// As many tokens are skipped at most to find the rest of a list.
const SKIP_MAX: usize = 32;

impl Parser<'_> {
    /// Whether a section surely starts `ahead` tokens from here: its word and its bracket, or `resource name`.
    pub(super) fn is_section(&self, ahead: usize) -> bool {
        let opens = self.kind(ahead + 1) == LeftBrace
            || self.kind(ahead + 1) == LeftParen && self.word(ahead) == "internal_connections";
        let declares = self.word(ahead) == "resource"
            && self.kind(ahead + 1) == Ident
            && [Comma, Semicolon].contains(&self.kind(ahead + 2));
        self.kind(ahead) == Ident && (SECTIONS.contains(&self.word(ahead)) && opens || declares)
    }

    /// Whether an item surely starts `ahead` tokens from here: its word, its name and its bracket, `const name =`,
    /// `type Name =`, or `use "file"`.
    pub(super) fn is_item(&self, ahead: usize) -> bool {
        let (first, second) = (self.kind(ahead + 1), self.kind(ahead + 2));
        if self.kind(ahead) == Ident && self.word(ahead) == "const" {
            return first == Ident && second == Equals;
        }
        if self.kind(ahead) == Ident && self.word(ahead) == "type" {
            return first == Ident && [Equals, LeftBrace].contains(&second);
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

    /// Reads the bracket that opens a block or a list; one token too many before it is skipped.
    pub(super) fn open(&mut self, bracket: SyntaxKind) -> bool {
        let is_late = !self.at(bracket) && self.kind(1) == bracket;
        if is_late && !self.ends_block() {
            self.expected(bracket.describe());
            self.start(SyntaxKind::Error);
            self.bump();
            self.finish();
        }
        self.expect(bracket)
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
            } else if self.eat(Comma) || self.at(close) {
                continue;
            } else if self.starts_item(close) {
                // `level 2` may be `level = 2`.
                let is_only = !self.follows(Ident) || [SyntaxKind::Colon, Equals].contains(&self.kind(1));
                self.expect_at(Comma, is_only);
                continue;
            } else if self.rest_of_item(close).is_some() {
                self.expected(close.describe());
            }
            let Some(length) = self.rest_of_item(close) else { break };
            if length > 0 {
                self.start(SyntaxKind::Error);
                (0..length).for_each(|_| self.bump());
                self.finish();
            }
            self.eat(Comma);
        }
        self.expect(close);
    }

    /// Whether the next tokens in a list are certainly its next item, although the comma before them is missing.
    fn starts_item(&self, close: SyntaxKind) -> bool {
        let is_value = self.at_any(&[Ident, SyntaxKind::Text, SyntaxKind::Number]) && !self.ends_block();
        let goes_on = [Comma, SyntaxKind::Colon, Equals, close].contains(&self.kind(1));
        let is_record = self.at(LeftBrace) && self.kind(1) == Ident && self.kind(2) == Equals;
        is_value && goes_on || is_record
    }

    /// How many tokens are before the next `,` or the end of a list, if the end is near. A closing
    /// bracket of another sort directly before the end is superfluous.
    fn rest_of_item(&self, close: SyntaxKind) -> Option<usize> {
        let stops = [Comma, RightParen, RightBrace, RightBracket, Semicolon, LeftParen, LeftBrace, LeftBracket, End];
        let is_end =
            |&ahead: &usize| stops.contains(&self.kind(ahead)) || self.is_section(ahead) || self.is_item(ahead);
        let length = (0..SKIP_MAX).find(is_end)?;
        let is_surplus = [RightParen, RightBrace, RightBracket].contains(&self.kind(length))
            && self.kind(length) != close
            && self.kind(length + 1) == close;
        let length = length + usize::from(is_surplus);
        [Comma, close].contains(&self.kind(length)).then_some(length)
    }
}
