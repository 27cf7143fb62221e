//! A typed view of the tree. Every part may be missing, because the text may be damaged.

use super::SyntaxKind::{self, Ident, Number};
use super::{SyntaxNode, SyntaxToken};
use crate::source::{Origin, Span};

/// A name with its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Name {
    pub(crate) text: String,
    pub(crate) span: Span,
}

/// A node together with its text.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    syntax: SyntaxNode,
    origin: Origin,
}

impl Node {
    pub(crate) fn new(syntax: SyntaxNode, origin: Origin) -> Self {
        Self { syntax, origin }
    }

    pub(crate) fn syntax(&self) -> &SyntaxNode {
        &self.syntax
    }

    pub(crate) fn kind(&self) -> SyntaxKind {
        self.syntax.kind()
    }

    pub(crate) fn span(&self) -> Span {
        span(self.origin, self.syntax.text_range())
    }

    /// Returns the text of the node without white space and comments.
    pub(crate) fn compact_text(&self) -> String {
        let tokens = self.syntax.descendants_with_tokens().filter_map(rowan::NodeOrToken::into_token);
        tokens.filter(|token| !token.kind().is_trivia()).map(|token| token.text().to_owned()).collect()
    }

    /// Returns the doc comments directly before the node, without their slashes.
    pub(crate) fn doc(&self) -> String {
        let before = std::iter::successors(self.syntax.prev_sibling_or_token(), |part| part.prev_sibling_or_token());
        let tokens = before.map_while(rowan::NodeOrToken::into_token).take_while(|token| token.kind().is_trivia());
        let docs = tokens.filter(|token| token.kind() == SyntaxKind::DocComment);
        let mut lines: Vec<String> = docs.map(|token| token.text().trim_start_matches('/').trim().to_owned()).collect();
        lines.reverse();
        lines.join("\n")
    }

    pub(crate) fn children(&self) -> impl Iterator<Item = Self> + '_ {
        self.syntax.children().map(|child| Self::new(child, self.origin))
    }

    pub(crate) fn children_of(&self, kind: SyntaxKind) -> impl Iterator<Item = Self> + '_ {
        self.children().filter(move |child| child.kind() == kind)
    }

    pub(crate) fn child(&self, kind: SyntaxKind) -> Option<Self> {
        self.children_of(kind).next()
    }

    /// Returns the node's own tokens, without white space and comments.
    pub(crate) fn tokens(&self) -> impl Iterator<Item = Token> + '_ {
        let tokens = self.syntax.children_with_tokens().filter_map(rowan::NodeOrToken::into_token);
        tokens.filter(|token| !token.kind().is_trivia()).map(|syntax| Token { syntax, origin: self.origin })
    }

    pub(crate) fn token(&self, kind: SyntaxKind) -> Option<Token> {
        self.tokens().find(|token| token.kind() == kind)
    }

    /// Returns the node's own names.
    pub(crate) fn names(&self) -> impl Iterator<Item = Name> + '_ {
        self.tokens().filter(|token| token.kind() == Ident).map(|token| token.name())
    }

    /// Returns the name after the node's first word. The first word may be misspelt or missing.
    pub(crate) fn title(&self) -> Option<Name> {
        let mut names = self.names();
        match (names.next(), names.next()) {
            (Some(_), Some(title)) => Some(title),
            (Some(title), None) if !["process", "module", "activity"].contains(&title.text.as_str()) => Some(title),
            (Some(_) | None, _) => None,
        }
    }
}

/// A token together with its text.
#[derive(Clone, Debug)]
pub(crate) struct Token {
    syntax: SyntaxToken,
    origin: Origin,
}

impl Token {
    pub(crate) fn kind(&self) -> SyntaxKind {
        self.syntax.kind()
    }

    pub(crate) fn text(&self) -> &str {
        self.syntax.text()
    }

    pub(crate) fn span(&self) -> Span {
        span(self.origin, self.syntax.text_range())
    }

    pub(crate) fn name(&self) -> Name {
        Name { text: self.text().to_owned(), span: self.span() }
    }

    /// Returns the content of a string, without quotes and escapes.
    pub(crate) fn content(&self) -> String {
        content(self.text())
    }

    /// Returns the value of a number.
    pub(crate) fn number(&self) -> Option<f64> {
        let is_number = self.kind() == Number;
        is_number.then(|| self.text().replace('_', "").parse().ok()).flatten().filter(|value: &f64| value.is_finite())
    }
}

/// Returns whether a `match` chooses by the reason of a failure, because it comes after an `else`, with or without
/// parentheses.
pub(crate) fn catches(node: &Node) -> bool {
    let mut operand = node.syntax().clone();
    while let Some(around) = operand.parent().filter(|around| around.kind() == SyntaxKind::Paren) {
        operand = around;
    }
    let around = operand.parent().filter(|around| around.kind() == SyntaxKind::Otherwise);
    node.kind() == SyntaxKind::Match && around.is_some_and(|around| around.children().next().as_ref() != Some(&operand))
}

fn span(origin: Origin, range: rowan::TextRange) -> Span {
    Span { origin, start: range.start().into(), end: range.end().into() }
}

/// Returns the content of a string token, without quotes and escapes.
pub(crate) fn content(text: &str) -> String {
    let inner = text.trim_start_matches('"');
    let inner = inner.strip_suffix('"').unwrap_or(inner);
    let mut content = String::with_capacity(inner.len());
    let mut is_escaped = false;
    for c in inner.chars() {
        match c {
            '\\' if !is_escaped => is_escaped = true,
            'n' if is_escaped => (content, is_escaped) = (content + "\n", false),
            't' if is_escaped => (content, is_escaped) = (content + "\t", false),
            _ => {
                content.push(c);
                is_escaped = false;
            }
        }
    }
    content
}
