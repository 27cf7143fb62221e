//! The tokens of a text with the comments between them: what a formatted text has to keep.

use crate::syntax::SyntaxKind::{
    self, Args, Binder, Chain, Colon, Comma, Dot, DotDot, DoubleColon, Greater, Labels, LeftBrace, LeftBracket,
    LeftParen, Less, List, Match, Minus, Module, Owner, Params, Paren, Question, Record, RecordType, Recur, RightBrace,
    RightBracket, RightParen, Semicolon, Sequence, Slash, Whitespace,
};
use crate::syntax::SyntaxNode;

/// A token that means something, with what stands before it.
#[derive(Debug)]
pub(super) struct Piece {
    pub(super) kind: SyntaxKind,
    /// The kind of the node it belongs to.
    pub(super) parent: SyntaxKind,
    pub(super) text: String,
    /// Its first byte in the source.
    pub(super) start: u32,
    /// The comments between the token before and this one.
    pub(super) comments: Vec<Comment>,
    /// Whether the source has a line break anywhere between the token before and this one.
    pub(super) is_broken: bool,
    /// Whether an empty line stands directly before it.
    pub(super) is_spaced: bool,
}

/// A comment, without the white space around it.
#[derive(Clone, Debug)]
pub(super) struct Comment {
    pub(super) text: String,
    /// Whether it begins its line.
    pub(super) is_own_line: bool,
    /// Whether an empty line stands directly before it.
    pub(super) is_spaced: bool,
}

impl Comment {
    /// Whether what follows has to start a new line.
    pub(super) fn ends_line(&self) -> bool {
        self.text.starts_with("//")
    }

    fn forces_lines(&self) -> bool {
        self.is_own_line || self.ends_line() || self.text.contains('\n')
    }
}

impl Piece {
    /// Whether its comments cannot stand within one line.
    pub(super) fn forces_lines(&self) -> bool {
        self.comments.iter().any(Comment::forces_lines)
    }

    /// How many columns its comments take within a line.
    pub(super) fn comments_width(&self) -> usize {
        self.comments.iter().map(|comment| comment.text.chars().count() + 1).sum()
    }
}

/// Returns the tokens of a tree in order; the last one is empty and carries what stands at the end of the file.
pub(super) fn pieces(root: &SyntaxNode) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let (mut comments, mut newlines, mut is_broken): (Vec<Comment>, usize, bool) = (Vec::new(), 0, false);
    let mut is_first = true;
    for token in root.descendants_with_tokens().filter_map(rowan::NodeOrToken::into_token) {
        let kind = token.kind();
        if kind == Whitespace {
            newlines += token.text().matches('\n').count();
            is_broken |= newlines > 0;
        } else if kind.is_trivia() {
            let is_own_line = newlines > 0 || is_first;
            let text = token.text().trim_end().to_owned();
            comments.push(Comment { text, is_own_line, is_spaced: newlines > 1 });
            newlines = 0;
            is_first = false;
        } else {
            // `:;` is an older spelling of `;;`.
            let text = if kind == Recur { ";;" } else { token.text() };
            pieces.push(Piece {
                kind,
                parent: token.parent().map_or(SyntaxKind::File, |node| node.kind()),
                text: text.to_owned(),
                start: token.text_range().start().into(),
                comments: std::mem::take(&mut comments),
                is_broken,
                is_spaced: newlines > 1,
            });
            (newlines, is_broken, is_first) = (0, false, false);
        }
    }
    let (start, text) = (root.text_range().end().into(), String::new());
    let (kind, parent) = (SyntaxKind::End, SyntaxKind::File);
    pieces.push(Piece { kind, parent, text, start, comments, is_broken, is_spaced: false });
    pieces
}

/// Whether a blank stands between two tokens of one line.
pub(super) fn is_apart(before: &Piece, next: &Piece) -> bool {
    // An empty statement: two `;` that touch would be a `;;`.
    if [before, next].iter().all(|piece| [Semicolon, Recur].contains(&piece.kind)) {
        return true;
    }
    if next.kind == Semicolon {
        return next.parent == Sequence;
    }
    if next.kind == Colon || next.kind == Recur {
        return next.parent == Chain;
    }
    let is_roomy = |kind: SyntaxKind| [Module, Match, Record, RecordType].contains(&kind);
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
    let tight_after = [LeftParen, LeftBracket, Dot, Minus, DotDot, Less, Slash];
    let tight_before = [RightParen, RightBracket, Comma, Dot, Question, LeftBracket, Greater, DotDot, Less, Slash];
    if tight_after.contains(&before.kind) || tight_before.contains(&next.kind) {
        return false;
    }
    next.kind != LeftParen || next.parent == Paren
}

/// Whether the node is a list in brackets.
pub(super) fn is_bracketed(kind: SyntaxKind) -> bool {
    [Params, Args, Owner, Labels, Binder, List, Record, RecordType].contains(&kind)
}
