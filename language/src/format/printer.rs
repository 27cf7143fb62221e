//! Writes tokens onto lines.

use super::COLUMNS;
use super::piece::{Piece, Sums, is_apart, is_bracketed, pieces};
use crate::syntax::SyntaxKind::{
    Actions, Block, Comma, Connections, Environment, External, Host, Instances, LeftBrace, LeftBracket, LeftParen,
    Less, Module, OnBoot, Policies, Process, RightBrace, RosComponent, RosComponents, State, Supervision, Verify,
};
use crate::syntax::SyntaxNode;
use rowan::NodeOrToken;
use std::ops::Range;

/// The columns of one level.
const INDENT: usize = 4;

pub(super) struct Printer<'t> {
    pub(super) pieces: Vec<Piece<'t>>,
    sums: Sums,
    /// The next token to write.
    pub(super) cursor: usize,
    out: String,
    /// Characters since the last line break.
    column: usize,
    pub(super) indent: usize,
    /// Whether the next token starts a line.
    pub(super) starts_line: bool,
    /// Whether an empty line of the source is kept before that line.
    keeps_space: bool,
    /// Whether an empty line is required before that line.
    needs_space: bool,
    /// Whether nothing has been written in the current block yet.
    is_block_start: bool,
    /// Whether a comment within a line was written last.
    is_after_comment: bool,
}

impl<'t> Printer<'t> {
    pub(super) fn new(root: &SyntaxNode, text: &'t str) -> Self {
        let pieces = pieces(root, text);
        Self {
            sums: Sums::new(&pieces),
            pieces,
            cursor: 0,
            out: String::with_capacity(text.len() + text.len() / 8),
            column: 0,
            indent: 0,
            starts_line: true,
            keeps_space: true,
            needs_space: false,
            is_block_start: true,
            is_after_comment: false,
        }
    }

    /// Writes the whole text.
    pub(super) fn file(mut self, root: &SyntaxNode) -> String {
        let mut was_line = true;
        for (index, item) in root.children().enumerate() {
            self.new_line();
            let is_line = self.is_one_line(&item);
            self.needs_space = index > 0 && !(is_line && was_line);
            was_line = is_line;
            self.node(&item, 0);
            // Between two items, there can only be an extra `;`.
            let end = item.next_sibling().map_or(self.pieces.len() - 1, |next| self.range(&next).start);
            self.flat(&(self.cursor..end));
        }
        self.comments();
        if !self.out.is_empty() {
            self.out.push('\n');
        }
        self.out
    }

    // ---- measuring ----

    /// Returns the tokens of a node, which must not be written yet.
    pub(super) fn range(&self, node: &SyntaxNode) -> Range<usize> {
        let range = node.text_range();
        let start = self.index(self.cursor, range.start().into());
        start..self.index(start, range.end().into())
    }

    /// Returns the first token at an offset or after it, from the token `from` on. The search is fast if the token is
    /// near.
    fn index(&self, from: usize, offset: u32) -> usize {
        let rest = &self.pieces[from..];
        let mut near = 1;
        while rest.get(near).is_some_and(|piece| piece.start < offset) {
            near *= 2;
        }
        let (low, high) = (near / 2, rest.len().min(near + 1));
        from + low + rest[low..high].partition_point(|piece| piece.start < offset)
    }

    /// Returns whether these tokens fit into the current line, if `reserve` columns must be left for the following
    /// tokens.
    pub(super) fn fits(&self, range: &Range<usize>, reserve: usize) -> bool {
        let column = if self.starts_line { self.indent * INDENT } else { self.column };
        column + self.sums.width(range) + reserve <= COLUMNS
    }

    /// Returns whether the author or a comment broke a line at a place where it may be broken.
    pub(super) fn is_forced(&self, range: &Range<usize>) -> bool {
        self.sums.is_commented(range) || self.sums.is_broken_at_operator(range)
    }

    /// Returns whether these tokens can be in one line.
    pub(super) fn is_flat(&self, range: &Range<usize>, reserve: usize) -> bool {
        self.fits(range, reserve) && !self.is_forced(range)
    }

    fn is_one_line(&self, item: &SyntaxNode) -> bool {
        let range = self.range(item);
        let is_short = self.indent * INDENT + self.sums.width(&range) <= COLUMNS;
        ![Process, Verify].contains(&item.kind())
            && is_short
            && !self.sums.is_broken(&range)
            && !self.sums.is_commented(&range)
    }

    // ---- writing ----

    /// Starts a new line. An empty line of the source is kept.
    pub(super) fn new_line(&mut self) {
        self.starts_line = true;
        self.keeps_space = true;
    }

    /// Starts a new line without an empty line before it.
    pub(super) fn next_line(&mut self) {
        self.starts_line = true;
        self.keeps_space = false;
    }

    /// Writes the next token after its comments.
    pub(super) fn token(&mut self) {
        self.comments();
        let piece = &self.pieces[self.cursor];
        let is_spaced = piece.is_spaced && self.keeps_space;
        let is_apart = self.cursor > 0 && is_apart(&self.pieces[self.cursor - 1], piece);
        let text = piece.text;
        if self.starts_line {
            self.break_line(is_spaced);
        } else if is_apart || self.is_after_comment {
            self.push(" ");
        }
        self.push(text);
        self.cursor += 1;
        (self.is_block_start, self.is_after_comment) = (false, false);
    }

    /// Writes the comments before the next token, unless they are already written.
    pub(super) fn comments(&mut self) {
        for comment in std::mem::take(&mut self.pieces[self.cursor].comments) {
            if comment.is_own_line {
                self.break_line(comment.is_spaced);
                self.starts_line = true;
            } else if self.column > 0 {
                self.push(" ");
            }
            self.push(&comment.text);
            self.starts_line |= comment.ends_line();
            (self.is_block_start, self.is_after_comment) = (false, true);
        }
    }

    fn break_line(&mut self, is_spaced: bool) {
        let is_spaced = is_spaced && !self.is_block_start || self.needs_space;
        if !self.out.is_empty() {
            self.out.push_str(if is_spaced { "\n\n" } else { "\n" });
        }
        self.out.push_str(&" ".repeat(self.indent * INDENT));
        self.column = self.indent * INDENT;
        (self.starts_line, self.needs_space) = (false, false);
    }

    fn push(&mut self, text: &str) {
        self.out.push_str(text);
        let line = text.rfind('\n').map_or(text, |newline| &text[newline + 1..]);
        self.column = line.chars().count() + if line.len() == text.len() { self.column } else { 0 };
    }

    // ---- structure ----

    /// Writes a node. In its last line, `reserve` columns are left for the following tokens.
    pub(super) fn node(&mut self, node: &SyntaxNode, reserve: usize) {
        let kind = node.kind();
        if [
            Process,
            Instances,
            Policies,
            Supervision,
            External,
            Connections,
            Actions,
            Environment,
            RosComponents,
            Verify,
        ]
        .contains(&kind)
            || kind == RosComponent && node.children_with_tokens().any(|part| part.kind() == LeftBrace)
            || [Module, State, Block].contains(&kind) && !self.is_one_line(node)
            || [Host, OnBoot].contains(&kind) && self.sums.is_commented(&self.range(node))
        {
            self.block(node);
        } else if is_bracketed(kind) {
            self.list(node, reserve);
        } else if super::expression::is_expression(kind) {
            self.expression(node, reserve);
        } else {
            self.walk(node, reserve);
        }
    }

    /// Writes tokens and nodes in their order.
    pub(super) fn walk(&mut self, node: &SyntaxNode, reserve: usize) {
        let range = self.range(node);
        let has_block = node.last_child().is_some_and(|last| {
            last.kind() == Policies || last.kind() == Block && self.sums.is_broken(&self.range(&last))
        });
        if !has_block && self.is_flat(&range, reserve) {
            return self.flat(&range);
        }
        let end = range.end;
        for part in node.children_with_tokens() {
            match part {
                NodeOrToken::Token(token) if token.kind().is_trivia() => {}
                NodeOrToken::Token(_) => self.token(),
                NodeOrToken::Node(part) => {
                    let rest = self.sums.width(&(self.range(&part).end..end));
                    self.node(&part, rest + reserve);
                }
            }
        }
    }

    /// Writes these tokens in one line.
    pub(super) fn flat(&mut self, range: &Range<usize>) {
        while self.cursor < range.end {
            self.token();
        }
    }

    /// Writes `word head { part part }`, with each part on a line of its own.
    fn block(&mut self, node: &SyntaxNode) {
        let mut is_open = false;
        for part in node.children_with_tokens() {
            match part {
                NodeOrToken::Token(token) if token.kind().is_trivia() => {}
                NodeOrToken::Token(token) if token.kind() == RightBrace && is_open => self.close(),
                NodeOrToken::Token(token) => {
                    self.token();
                    if token.kind() == LeftBrace {
                        self.open();
                        is_open = true;
                    }
                }
                NodeOrToken::Node(part) => {
                    if is_open {
                        self.new_line();
                    }
                    self.node(&part, usize::from(!is_open));
                }
            }
        }
    }

    /// Begins the content of an opening bracket that ends its line.
    pub(super) fn open(&mut self) {
        self.indent += 1;
        let is_empty = self.pieces[self.cursor].kind == RightBrace && self.pieces[self.cursor].comments.is_empty();
        if !is_empty {
            self.new_line();
            self.is_block_start = true;
        }
    }

    /// Closes the content before a closing bracket, and writes the bracket. Comments before the bracket belong to the
    /// content.
    pub(super) fn close(&mut self) {
        let is_empty = self.is_empty_block();
        self.comments();
        self.indent = self.indent.saturating_sub(1);
        if !is_empty {
            self.next_line();
        }
        self.token();
    }

    fn is_empty_block(&self) -> bool {
        let before = self.cursor.checked_sub(1).map(|index| self.pieces[index].kind);
        before == Some(LeftBrace) && self.pieces[self.cursor].comments.is_empty()
    }

    /// Writes `( item, item )` in one line, or otherwise with one item on each line.
    fn list(&mut self, node: &SyntaxNode, reserve: usize) {
        let range = self.range(node);
        if !self.sums.is_commented(&range) && self.fits(&range, reserve) {
            return self.flat(&range);
        }
        let mut is_open = false;
        for part in node.children_with_tokens() {
            match part {
                NodeOrToken::Token(token) if token.kind().is_trivia() => {}
                NodeOrToken::Token(_) if self.cursor + 1 == range.end && is_open => self.close(),
                NodeOrToken::Token(token) => {
                    self.token();
                    if [LeftParen, LeftBrace, LeftBracket, Less].contains(&token.kind()) && !is_open {
                        is_open = true;
                        self.open();
                    } else if token.kind() == Comma {
                        self.next_line();
                    }
                }
                NodeOrToken::Node(part) => self.node(&part, 1),
            }
        }
    }
}
