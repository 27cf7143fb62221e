//! The cursor and its surroundings in the tree.

use super::{Completion, CompletionKind, inside, keywords};
use crate::automaton::Failure;
use crate::ide::words::Place;
use crate::source::Origin;
use crate::syntax::ast::Node;
use crate::syntax::{SyntaxKind, SyntaxToken};

/// The marked word and its surroundings.
pub(super) struct Cursor {
    /// The node that the word belongs to.
    pub(super) parent: Node,
    /// The node around the parent.
    pub(super) grand: Option<Node>,
    /// How many names of the same node precede it.
    pub(super) place: usize,
    /// The text of the previous token. It is empty at the beginning of the file.
    pub(super) before: String,
    /// The kind of the previous token.
    before_kind: SyntaxKind,
    /// All nodes around the word, the innermost first.
    pub(super) around: Vec<Node>,
}

impl Cursor {
    pub(super) fn new(token: &SyntaxToken) -> Option<Self> {
        let parent = token.parent()?;
        let earlier = std::iter::successors(token.prev_token(), SyntaxToken::prev_token);
        let before = earlier.into_iter().find(|token| !token.kind().is_trivia());
        let around: Vec<Node> = parent.ancestors().map(|node| Node::new(node, Origin::Spec)).collect();
        let parent = around.first()?.clone();
        let start = u32::from(token.text_range().start());
        let place = parent.names().take_while(|name| name.span.start < start).count();
        Some(Self {
            parent,
            grand: around.get(1).cloned(),
            place,
            before: before.as_ref().map_or(String::new(), |token| token.text().to_owned()),
            before_kind: before.map_or(SyntaxKind::End, |token| token.kind()),
            around,
        })
    }

    /// Returns whether the node around the parent is of this kind.
    pub(super) fn grand_is(&self, kind: SyntaxKind) -> bool {
        self.grand.as_ref().is_some_and(|grand| grand.kind() == kind)
    }

    /// Returns the nearest node of this kind around the word.
    pub(super) fn inside(&self, kind: SyntaxKind) -> Option<&Node> {
        self.around.iter().find(|node| node.kind() == kind)
    }

    /// Returns whether the word directly follows an operand, so that an operator is missing between them.
    pub(super) fn follows_operand(&self) -> bool {
        let is_word = self.before_kind == SyntaxKind::Ident
            && !["else", "finally", "within", "as", "with", "of", "in", "repeat", "shield"]
                .contains(&self.before.as_str());
        let ends = [SyntaxKind::RightParen, SyntaxKind::RightBracket, SyntaxKind::Question, SyntaxKind::Greater];
        // The parentheses after these words are followed by an operand.
        let prefixes = [SyntaxKind::Retry, SyntaxKind::Using, SyntaxKind::Shield];
        let after_prefix = prefixes.iter().any(|&kind| self.grand_is(kind));
        (is_word || ends.contains(&self.before_kind)) && !after_prefix
    }

    /// Returns whether the word directly follows a `repeat` that has no `until` yet.
    pub(super) fn follows_repeat(&self) -> bool {
        let before = self.parent.syntax().prev_sibling().filter(|node| node.kind() == SyntaxKind::Repeat);
        before.is_some_and(|repeat| repeat.children().all(|part| part.kind() != SyntaxKind::Until))
    }

    /// Returns the causes of failures that have no arm yet.
    pub(super) fn causes(&self) -> Vec<Completion> {
        let Some(node) = self.inside(SyntaxKind::Match) else { return Vec::new() };
        let given: Vec<String> =
            node.children_of(SyntaxKind::Arm).filter_map(|arm| arm.names().next()).map(|name| name.text).collect();
        let open = Failure::WORDS.iter().filter(|(word, _)| given.iter().all(|other| other != word));
        let offer = |word: &str| {
            let mut offer = Completion::new(CompletionKind::Keyword, word).documentation("a cause of a failure");
            offer.snippet = Some(format!("{word} => $0"));
            offer
        };
        open.map(|(word, _)| offer(word)).collect()
    }

    /// Returns whether the word begins a statement.
    pub(super) fn begins_statement(&self) -> bool {
        let starts = [SyntaxKind::LeftBrace, SyntaxKind::Semicolon, SyntaxKind::RightBrace];
        let joins = [SyntaxKind::Arrow, SyntaxKind::BackArrow, SyntaxKind::Equals];
        starts.contains(&self.before_kind) || joins.contains(&self.before_kind)
    }

    /// Returns the words for the effect of a reboot.
    pub(super) fn on_boot(&self) -> Vec<Completion> {
        ["none", "resume"].into_iter().map(|word| Completion::new(CompletionKind::Keyword, word)).collect()
    }

    /// Returns the words that can follow in a policy.
    pub(super) fn policy(&self) -> Vec<Completion> {
        let words: &[&str] = match self.before.as_str() {
            "restart" => &["temporary", "transient", "permanent"],
            "strategy" => &["one_for_one", "one_for_all", "rest_for_one"],
            "watchdog" => &["none"],
            "ready" => &["within"],
            "on_agent_loss" => &["stop within"],
            "on_link_loss" => &["keep", "hold", "safe_stop_after"],
            _ => &[],
        };
        words.iter().map(|word| Completion::new(CompletionKind::Keyword, *word)).collect()
    }

    /// Returns words for places without names: items, sections, properties of a module.
    pub(super) fn words(&self) -> Vec<Completion> {
        let begins = [SyntaxKind::LeftBrace, SyntaxKind::Semicolon, SyntaxKind::RightBrace, SyntaxKind::End];
        if self.before_kind == SyntaxKind::LeftParen && self.inside(SyntaxKind::Module).is_some() {
            return ["read", "write"].into_iter().flat_map(inside).collect();
        }
        if !begins.contains(&self.before_kind) {
            return Vec::new();
        }
        if self.inside(SyntaxKind::Policies).is_some() {
            return keywords(Place::Policy);
        }
        if self.inside(SyntaxKind::Supervision).is_some() {
            return keywords(Place::Rule);
        }
        let is_first = self.before_kind == SyntaxKind::End;
        let is_title = |node: &Node| self.parent.span() == node.span() && self.place == 0;
        if let Some(process) = self.inside(SyntaxKind::Process).filter(|node| !is_first && !is_title(node)) {
            return sections(process);
        }
        if self.inside(SyntaxKind::Module).is_some_and(|node| !is_first && !is_title(node)) {
            return keywords(Place::ModuleItem);
        }
        keywords(Place::Item)
    }
}

/// Returns the sections that a process lacks. There can be any number of connection sets.
fn sections(process: &Node) -> Vec<Completion> {
    let mut offers = keywords(Place::Section);
    let is_there = |word: &str| {
        let mut heads = process.children().filter_map(|section| section.names().next());
        word != "internal_connections" && heads.any(|head| head.text == word)
    };
    offers.retain(|offer| !is_there(&offer.label));
    offers
}
