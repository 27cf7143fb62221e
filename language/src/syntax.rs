//! From text to tree: lexer, error-tolerant parser, typed view.
//!
//! The tree is lossless: the texts of all its tokens together are the source. Every keyword depends on its context, so
//! `host`, `add` or `model` can still be names of instances.

pub(crate) mod ast;
mod kind;
mod lexer;
mod parser;

pub(crate) use kind::Operator;
pub use kind::SyntaxKind;
pub(crate) use lexer::is_name;
pub use lexer::{Token, lex};
pub(crate) use parser::{Parse, parse};

/// Binds the tree library to the kinds of this language.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Dca {}

impl rowan::Language for Dca {
    type Kind = SyntaxKind;

    fn kind_from_raw(raw: rowan::SyntaxKind) -> SyntaxKind {
        SyntaxKind::ALL.get(usize::from(raw.0)).copied().unwrap_or(SyntaxKind::Unknown)
    }

    fn kind_to_raw(kind: SyntaxKind) -> rowan::SyntaxKind {
        rowan::SyntaxKind(kind as u16)
    }
}

/// A node of the tree.
pub(crate) type SyntaxNode = rowan::SyntaxNode<Dca>;
/// A leaf of the tree.
pub(crate) type SyntaxToken = rowan::SyntaxToken<Dca>;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Origin, Source};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_tree_keeps_every_byte(text in "(process|a|\\{|\\}|\\(|\\)|;|,|#|\\[|\\]| |\n|//x\n|internal_event_actions|é|\"){0,60}") {
            let Parse { root, .. } = parse(&Source::new("any", &*text), Origin::Spec);
            prop_assert_eq!(root.text().to_string(), text);
        }
    }
}
