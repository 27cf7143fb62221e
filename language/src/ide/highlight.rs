//! Classifies each token by the meaning of its name, which a grammar of patterns cannot find.

use super::Analysis;
use super::index::{Index, Kind};
use crate::source::{Origin, Span};
use crate::syntax::{SyntaxKind, SyntaxToken};

/// The class of a token, which decides its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// A word of the language.
    Keyword,
    /// A process or module.
    Type,
    /// An instance.
    Instance,
    /// A parameter, or the name of an argument.
    Parameter,
    /// A named constant.
    Constant,
    /// A port.
    Port,
    /// The label of a connection set, or an outcome.
    Label,
    /// The variable of a replication, or a resource.
    Variable,
    /// A number, with its unit.
    Number,
    /// A string, or a literal word, such as a host.
    Text,
    /// An operator of event actions, or an arrow.
    Operator,
    /// A comment.
    Comment,
}

/// A token with its class.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Highlight {
    /// The place of the token. A comment may have several lines.
    pub span: Span,
    /// The class of the token.
    pub class: Class,
    /// Whether the token declares the name.
    pub is_declaration: bool,
}

impl Analysis {
    /// Returns the tokens of the spec that have a class, in the order of the text.
    pub fn highlights(&self) -> Vec<Highlight> {
        let tokens = self.trees()[0].syntax().descendants_with_tokens().filter_map(rowan::NodeOrToken::into_token);
        tokens.filter_map(|token| highlight(&token, self.index())).collect()
    }
}

fn highlight(token: &SyntaxToken, index: &Index) -> Option<Highlight> {
    let range = token.text_range();
    let span = Span { origin: Origin::Spec, start: range.start().into(), end: range.end().into() };
    let mut is_declaration = false;
    let class = match token.kind() {
        SyntaxKind::Comment | SyntaxKind::DocComment => Class::Comment,
        SyntaxKind::Number => Class::Number,
        SyntaxKind::Text => Class::Text,
        SyntaxKind::Ident => match index.of(span) {
            Some(symbol) => {
                is_declaration = symbol.declaration == span;
                class(symbol.kind)
            }
            None => word(token)?,
        },
        kind if is_operator(kind, token) => Class::Operator,
        _ => return None,
    };
    Some(Highlight { span, class, is_declaration })
}

fn class(kind: Kind) -> Class {
    match kind {
        Kind::Process(_) | Kind::Module(_) | Kind::Type(_) => Class::Type,
        Kind::Instance(..) => Class::Instance,
        Kind::Param(..) | Kind::Field => Class::Parameter,
        Kind::Constant => Class::Constant,
        Kind::Port(..) | Kind::Export(..) => Class::Port,
        Kind::Label(..) | Kind::Outcome => Class::Label,
        Kind::Variable | Kind::Result | Kind::Resource(..) => Class::Variable,
    }
}

/// Returns the class of a word that is not a known name.
fn word(token: &SyntaxToken) -> Option<Class> {
    let parent = token.parent()?;
    let before = token.siblings_with_tokens(rowan::Direction::Prev).skip(1).filter_map(rowan::NodeOrToken::into_token);
    let mut before = before.filter(|token| !token.kind().is_trivia());
    let is_first = before.next().is_none();
    match parent.kind() {
        SyntaxKind::Type => Some(Class::Type),
        SyntaxKind::Constant if before.any(|token| token.kind() == SyntaxKind::Number) || !is_first => {
            Some(Class::Number)
        }
        SyntaxKind::Constant if ["true", "false"].contains(&token.text()) => Some(Class::Keyword),
        SyntaxKind::Constant => Some(Class::Text),
        SyntaxKind::Secret => Some(Class::Keyword),
        SyntaxKind::Host if !is_first => Some(Class::Text),
        SyntaxKind::Run if is_first && ["skip", "never"].contains(&token.text()) => Some(Class::Keyword),
        SyntaxKind::Index | SyntaxKind::Count => Some(Class::Variable),
        SyntaxKind::Claim if is_first => Some(Class::Parameter),
        // Here, a keyword is in the position of a name.
        SyntaxKind::Arm if token.text() == "else" => Some(Class::Keyword),
        SyntaxKind::Resources if is_first && token.text() == "resource" => Some(Class::Keyword),
        SyntaxKind::Until if is_first => Some(Class::Keyword),
        SyntaxKind::Run
        | SyntaxKind::Arm
        | SyntaxKind::Until
        | SyntaxKind::Resources
        | SyntaxKind::Endpoint
        | SyntaxKind::Owner
        | SyntaxKind::Labels
        | SyntaxKind::Binder
        | SyntaxKind::Error
        | SyntaxKind::Arg
        | SyntaxKind::Field
        | SyntaxKind::Param => None,
        SyntaxKind::Sentence if !crate::check::is_sentence_word(token.text()) => None,
        SyntaxKind::Verify if !is_first => None,
        SyntaxKind::Instance if token.text() != "instof" => None,
        SyntaxKind::Export => None,
        SyntaxKind::Process | SyntaxKind::Module | SyntaxKind::ConstItem | SyntaxKind::TypeItem | SyntaxKind::Port
            if !is_first =>
        {
            (token.text() == "optional").then_some(Class::Keyword)
        }
        _ => Some(Class::Keyword),
    }
}

/// Returns whether a punctuation mark is an operator, because it joins two parts.
fn is_operator(kind: SyntaxKind, token: &SyntaxToken) -> bool {
    let joins = [
        SyntaxKind::Concurrent,
        SyntaxKind::FailFast,
        SyntaxKind::Disable,
        SyntaxKind::Sequence,
        SyntaxKind::Chain,
        SyntaxKind::Named,
        SyntaxKind::Suffixed,
    ];
    let is_arrow = [SyntaxKind::Arrow, SyntaxKind::BackArrow].contains(&kind);
    let is_blank = kind == SyntaxKind::Whitespace;
    is_arrow || !is_blank && token.parent().is_some_and(|parent| joins.contains(&parent.kind()))
}
