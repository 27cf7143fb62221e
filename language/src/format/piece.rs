//! The tokens of a text with the comments between them. A formatted text keeps all of them.

use super::expression::is_operator;
use crate::check::is_ordinal_suffix;
use crate::syntax::SyntaxKind::{
    self, Ampersand, Args, Bang, Bar, Binder, Block, Chain, Colon, Comma, Constant, Dot, DotDot, DoubleColon, Equals,
    Formula, Greater, Labels, LeftBrace, LeftBracket, LeftParen, Less, List, Match, Minus, Module, Owner, Params,
    Paren, Plus, Question, Record, RecordType, Recur, RightBrace, RightBracket, RightParen, Semicolon, Sequence, Slash,
    Star, State, Statement, Whitespace,
};
use crate::syntax::{Dca, SyntaxNode};
use rowan::Language;
use std::ops::Range;

/// A token that is not white space or a comment, with the white space and comments before it.
#[derive(Debug)]
pub(super) struct Piece<'t> {
    pub(super) kind: SyntaxKind,
    /// The kind of the token's node.
    pub(super) parent: SyntaxKind,
    pub(super) text: &'t str,
    /// The first byte of the token in the source.
    pub(super) start: u32,
    /// The comments between the previous token and this token.
    pub(super) comments: Vec<Comment>,
    /// Whether the source has a line break anywhere between the previous token and this token.
    pub(super) is_broken: bool,
    /// Whether there is an empty line directly before the token.
    pub(super) is_spaced: bool,
}

/// A comment, without the white space around it.
#[derive(Clone, Debug)]
pub(super) struct Comment {
    pub(super) text: String,
    /// Whether the comment begins its line.
    pub(super) is_own_line: bool,
    /// Whether there is an empty line directly before the comment.
    pub(super) is_spaced: bool,
}

impl Comment {
    /// Returns whether the next token has to start a new line.
    pub(super) fn ends_line(&self) -> bool {
        self.text.starts_with("//")
    }

    fn forces_lines(&self) -> bool {
        self.is_own_line || self.ends_line() || self.text.contains('\n')
    }
}

impl Piece<'_> {
    /// Returns whether the comments of the token do not fit within one line.
    pub(super) fn forces_lines(&self) -> bool {
        self.comments.iter().any(Comment::forces_lines)
    }

    /// Returns whether the token is an operator with a line break before or after it. A closing token is not an operand.
    fn is_broken_beside(&self, next: Option<&Self>) -> bool {
        let next = next.filter(|next| ![RightParen, RightBrace, SyntaxKind::End].contains(&next.kind));
        let breaks = |piece: &Self| piece.is_broken || piece.forces_lines();
        breaks(self) || next.is_some_and(breaks)
    }

    /// Returns how many columns the comments of the token take within a line.
    pub(super) fn comments_width(&self) -> usize {
        self.comments.iter().map(|comment| comment.text.chars().count() + 1).sum()
    }
}

/// Returns the tokens of a tree in order. The last one is empty and carries the comments at the end of the file.
pub(super) fn pieces<'t>(root: &SyntaxNode, text: &'t str) -> Vec<Piece<'t>> {
    let mut reader =
        Reader { text, offset: 0, pieces: Vec::new(), comments: Vec::new(), newlines: 0, is_broken: false };
    reader.node(&root.green());
    let Reader { offset: start, mut pieces, comments, is_broken, .. } = reader;
    let (kind, parent) = (SyntaxKind::End, SyntaxKind::File);
    pieces.push(Piece { kind, parent, text: "", start, comments, is_broken, is_spaced: false });
    move_behind_operators(&mut pieces);
    pieces
}

/// Moves the comments before each operator to the place after it, because an operator ends a line and never begins one. Comments are moved
/// before anything is measured, because their new place decides the widths.
fn move_behind_operators(pieces: &mut [Piece<'_>]) {
    for index in 1..pieces.len() {
        let [operator, next] = &mut pieces[index - 1..=index] else { continue };
        if !is_operator(operator.parent) || operator.comments.is_empty() {
            continue;
        }
        let mut moved = std::mem::take(&mut operator.comments);
        if let (Some(last), Some(first)) = (moved.last(), next.comments.first_mut()) {
            first.is_own_line |= last.ends_line();
        }
        moved.append(&mut next.comments);
        next.comments = moved;
    }
}

/// Walks a tree, token by token.
struct Reader<'t> {
    text: &'t str,
    /// The first byte of the next token.
    offset: u32,
    pieces: Vec<Piece<'t>>,
    comments: Vec<Comment>,
    /// The number of line breaks since the last token or comment.
    newlines: usize,
    /// Whether there is a line break since the last token.
    is_broken: bool,
}

impl Reader<'_> {
    /// Reads a node. The recursion is limited, because the parser limits how deep nodes nest.
    fn node(&mut self, node: &rowan::GreenNodeData) {
        let parent = Dca::kind_from_raw(node.kind());
        for child in node.children() {
            match child {
                rowan::NodeOrToken::Node(node) => self.node(node),
                rowan::NodeOrToken::Token(token) => {
                    self.token(Dca::kind_from_raw(token.kind()), parent, token.text_len());
                }
            }
        }
    }

    fn token(&mut self, kind: SyntaxKind, parent: SyntaxKind, length: rowan::TextSize) {
        let start = self.offset;
        self.offset += u32::from(length);
        let text = &self.text[start as usize..self.offset as usize];
        if kind == Whitespace {
            self.newlines += text.bytes().filter(|&byte| byte == b'\n').count();
            self.is_broken |= self.newlines > 0;
        } else if kind.is_trivia() {
            let is_first = self.pieces.is_empty() && self.comments.is_empty();
            let is_own_line = self.newlines > 0 || is_first;
            self.comments.push(Comment { text: text.trim_end().to_owned(), is_own_line, is_spaced: self.newlines > 1 });
            self.newlines = 0;
        } else {
            self.pieces.push(Piece {
                kind,
                parent,
                // `:;` is an older spelling of `;;`.
                text: if kind == Recur { ";;" } else { text },
                start,
                comments: std::mem::take(&mut self.comments),
                is_broken: self.is_broken,
                is_spaced: self.newlines > 1,
            });
            (self.newlines, self.is_broken) = (0, false);
        }
    }
}

/// Sums that give the width of any range of tokens in constant time. For each token, there is the sum of all widths before it. Comments
/// before the first token of a range are not included.
#[derive(Debug)]
pub(super) struct Sums {
    /// The columns in one line, up to the token, and up to the comments before it.
    columns: Vec<(usize, usize)>,
    /// The number of tokens whose comments do not fit within one line.
    comments: Vec<u32>,
    /// The number of tokens that start a line.
    lines: Vec<u32>,
    /// The number of operators at which the author or a comment broke the line.
    operators: Vec<u32>,
}

impl Sums {
    pub(super) fn new(pieces: &[Piece<'_>]) -> Self {
        let length = pieces.len() + 1;
        let vec = || Vec::with_capacity(length);
        let mut sums = Self { columns: Vec::with_capacity(length), comments: vec(), lines: vec(), operators: vec() };
        let (mut columns, mut comments, mut lines, mut operators) = (0, 0, 0, 0);
        for (index, piece) in pieces.iter().enumerate() {
            let before = index.checked_sub(1).map(|before| &pieces[before]);
            let start = columns + piece.comments_width();
            sums.columns.push((start, columns));
            sums.comments.push(comments);
            sums.lines.push(lines);
            sums.operators.push(operators);
            let is_apart = !piece.comments.is_empty() || before.is_some_and(|before| is_apart(before, piece));
            columns = start + piece.text.chars().count() + usize::from(is_apart);
            comments += u32::from(piece.forces_lines());
            lines += u32::from(piece.is_broken || piece.text.contains('\n'));
            operators += u32::from(is_operator(piece.parent) && piece.is_broken_beside(pieces.get(index + 1)));
        }
        sums.columns.push((columns, columns));
        sums.comments.push(comments);
        sums.lines.push(lines);
        sums.operators.push(operators);
        sums
    }

    /// Returns the columns of these tokens in one line. The blank before the first token is included, unless the token starts the text. The
    /// comments before the first token are not included.
    pub(super) fn width(&self, range: &Range<usize>) -> usize {
        self.columns[range.end].1.saturating_sub(self.columns[range.start].0)
    }

    /// Returns whether a comment between these tokens prevents that they are in one line.
    pub(super) fn is_commented(&self, range: &Range<usize>) -> bool {
        range.start < range.end && self.comments[range.end] > self.comments[range.start + 1]
    }

    /// Returns whether there is a line break between these tokens.
    pub(super) fn is_broken(&self, range: &Range<usize>) -> bool {
        range.start < range.end && self.lines[range.end] > self.lines[range.start + 1]
    }

    /// Returns whether there is a line break at an operator in this range.
    pub(super) fn is_broken_at_operator(&self, range: &Range<usize>) -> bool {
        self.operators[range.end] > self.operators[range.start]
    }
}

/// Returns whether two tokens of one line have a blank between them.
pub(super) fn is_apart(before: &Piece<'_>, next: &Piece<'_>) -> bool {
    // Empty statements need the blank: two `;` without a blank would be a `;;`.
    if [before, next].iter().all(|piece| [Semicolon, Recur].contains(&piece.kind)) {
        return true;
    }
    // `2nd` is two tokens of a sentence.
    if before.parent == SyntaxKind::Sentence && before.kind == SyntaxKind::Number && is_ordinal_suffix(next.text) {
        return false;
    }
    if next.kind == Semicolon {
        return next.parent == Sequence;
    }
    if next.kind == Colon || next.kind == Recur {
        return next.parent == Chain;
    }
    if let Some(is_apart) = is_apart_in_activity(before, next) {
        return is_apart;
    }
    let is_roomy = |kind: SyntaxKind| [Module, Match, Record, RecordType, State, Block].contains(&kind);
    if next.kind == SyntaxKind::Script {
        return true;
    }
    if next.kind == LeftBrace {
        return is_roomy(next.parent) && ![LeftParen, LeftBracket].contains(&before.kind);
    }
    if before.kind == LeftBrace || next.kind == RightBrace {
        let is_empty = before.kind == LeftBrace && next.kind == RightBrace;
        return !is_empty && (is_roomy(before.parent) || is_roomy(next.parent));
    }
    if next.kind == DoubleColon {
        return true;
    }
    if before.kind == RightParen && [SyntaxKind::Shield, SyntaxKind::Resources].contains(&before.parent) {
        return next.kind != Semicolon;
    }
    if next.kind == LeftBracket && next.parent == List {
        return ![LeftParen, LeftBracket].contains(&before.kind);
    }
    // In `in ..5 = 3` and `in 1.. = 3`, an end of the range is left out.
    if before.parent == SyntaxKind::Range && (before.kind == SyntaxKind::Ident || next.kind == Equals) {
        return true;
    }
    if next.kind == Star {
        return false;
    }
    let tight_after = [LeftParen, LeftBracket, Dot, Minus, DotDot, Less, Slash];
    let tight_before = [RightParen, RightBracket, Comma, Dot, Question, LeftBracket, Greater, DotDot, Less, Slash];
    if tight_after.contains(&before.kind) || tight_before.contains(&next.kind) {
        return false;
    }
    next.kind != LeftParen || next.parent == Paren
}

/// Returns whether two tokens of a formula or an assignment have a blank between them, if this differs from other places.
fn is_apart_in_activity(before: &Piece<'_>, next: &Piece<'_>) -> Option<bool> {
    let signs = [Ampersand, Bang, Bar, Equals, Greater, Less, Minus, Plus, Star];
    let is_sign = |piece: &Piece<'_>| piece.parent == Formula && signs.contains(&piece.kind);
    if before.parent == Statement && [Plus, Minus].contains(&before.kind) && next.kind == Equals {
        return Some(false);
    }
    if is_sign(before) {
        let is_pair = is_sign(next) && (next.kind == Equals || next.kind == before.kind);
        return Some(!is_pair && before.kind != Bang);
    }
    if is_sign(next) {
        return Some(before.kind != LeftParen);
    }
    let is_empty_value = next.kind == LeftParen && next.parent == Constant;
    let is_enclosed = next.kind == LeftParen && next.parent == Formula && before.text != "in";
    (is_empty_value || is_enclosed).then_some(before.kind != LeftParen)
}

/// Returns whether the node is a list in brackets.
pub(super) fn is_bracketed(kind: SyntaxKind) -> bool {
    [Params, Args, Owner, Labels, Binder, List, Record, RecordType].contains(&kind)
}
