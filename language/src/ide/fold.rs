//! Finds the parts of a text that an editor can fold: items, sections, and comments of several lines.

use super::Analysis;
use crate::source::Span;
use crate::syntax::SyntaxKind;
use crate::syntax::ast::Node;

impl Analysis {
    /// Returns the foldable spans, in the order of the text. Parts of one line are included.
    pub fn folds(&self) -> Vec<Span> {
        let mut folds = Vec::new();
        let mut parts: Vec<Node> = self.trees()[0].children().collect();
        while let Some(part) = parts.pop() {
            let is_item = [SyntaxKind::Process, SyntaxKind::Module, SyntaxKind::TypeItem, SyntaxKind::State]
                .contains(&part.kind());
            let sections = [SyntaxKind::Instances, SyntaxKind::External, SyntaxKind::Connections, SyntaxKind::Actions];
            if is_item || sections.contains(&part.kind()) {
                folds.push(part.span());
            }
            if is_item {
                parts.extend(part.children());
            }
        }
        let elements = self.trees()[0].syntax().descendants_with_tokens().filter_map(rowan::NodeOrToken::into_token);
        let is_block = |kind, text: &str| kind == SyntaxKind::Comment && text.contains('\n');
        let comments = elements.filter(|token| is_block(token.kind(), token.text()));
        folds.extend(comments.map(|token| {
            let range = token.text_range();
            Span { origin: crate::Origin::Spec, start: range.start().into(), end: range.end().into() }
        }));
        folds.sort_unstable();
        folds
    }
}
