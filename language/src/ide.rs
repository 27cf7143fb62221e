//! Answers the questions of an editor: diagnostics, definitions, references, completion, renames.
//!
//! The input is a text and a place in it, and the output is an answer: the service has no protocol, no files and no state. An [`Analysis`] is one
//! spec with its files and the interfaces of its programs, compiled once. It answers any number of questions about that text, and is
//! discarded at the next keystroke. Checking from the start is fast enough for this (see *Measured* in the architecture), and no state can
//! become stale. The index of names is made at the first question that needs it.
//!
//! ```
//! use language::{Options, Source, ide::Analysis};
//!
//! let text = "process main() {
//!     instantiated_processes { lamp instof Lamp(c1); }
//!     internal_event_actions { lamp }
//! }";
//! let analysis = Analysis::new(Source::new("a.dca", text), Vec::new(), &Options::named("a"));
//! let used = text.rfind("lamp").unwrap();
//! let place = analysis.definition(used).unwrap();
//! assert_eq!(place.start as usize, text.find("lamp").unwrap());
//! ```

#![expect(clippy::wildcard_enum_match_arm, reason = "kinds of nodes that are not listed have nothing to say")]

mod complete;
mod fold;
mod highlight;
mod hover;
mod index;
mod outline;
mod rename;
mod words;

use crate::check::{self, spec::Spec};
use crate::plan::Plan;
use crate::source::{Origin, Role, Source, Span};
use crate::syntax::ast::Node;
use crate::syntax::{SyntaxKind, SyntaxToken, parse};
use crate::{Diagnostic, Options};
use index::Index;
use std::cell::OnceCell;

pub use complete::{Completion, CompletionKind};
pub use highlight::{Class, Highlight};
pub use hover::Hover;
pub use outline::{OutlineKind, Symbol};
pub use rename::{FileEdit, RenameError, rename};

/// A spec that was compiled once and answers questions.
#[derive(Debug)]
pub struct Analysis {
    spec: Source,
    others: Vec<Source>,
    options: Options,
    model: Spec,
    plan: Option<Plan>,
    diagnostics: Vec<Diagnostic>,
    trees: OnceCell<Vec<Node>>,
    index: OnceCell<Index>,
}

/// The place where a name is declared. It is the same in all specs, because it has the name of the text.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Declaration {
    /// The name of the source.
    pub file: String,
    /// The first byte of the name.
    pub start: u32,
    /// The byte after the name.
    pub end: u32,
}

impl Analysis {
    /// Compiles a spec. `others` are its files and the interfaces, as for [`crate::compile`].
    pub fn new(spec: Source, others: Vec<Source>, options: &Options) -> Self {
        let (compiled, model, _) = check::compile_with_model(&spec, &others, options);
        Self {
            spec,
            others,
            options: options.clone(),
            model,
            plan: compiled.plan,
            diagnostics: compiled.diagnostics,
            trees: OnceCell::new(),
            index: OnceCell::new(),
        }
    }

    /// Returns all diagnostics, in the order of the text.
    pub fn diagnostics(&self) -> &[Diagnostic] {
        &self.diagnostics
    }

    /// Returns the plan. There is none exactly when there is an error.
    pub fn plan(&self) -> Option<&Plan> {
        self.plan.as_ref()
    }

    /// Returns the spec itself.
    pub fn spec(&self) -> &Source {
        &self.spec
    }

    /// Returns the files of the spec and the interfaces, as the caller gave them.
    pub fn others(&self) -> &[Source] {
        &self.others
    }

    /// Returns the places of the spec's `verify` blocks.
    pub fn blocks_to_prove(&self) -> Vec<Span> {
        let items: Vec<Node> = self.trees()[0].children().collect();
        let inside = |item: &Node| match item.kind() {
            SyntaxKind::Verify => vec![item.span()],
            _ => item.children_of(SyntaxKind::Verify).map(|block| block.span()).collect(),
        };
        items.iter().flat_map(inside).collect()
    }

    /// Returns the text that a span is in.
    pub fn source(&self, span: Span) -> &Source {
        match span.origin {
            Origin::Spec => &self.spec,
            Origin::Interface(index) => self.others.get(index as usize).unwrap_or(&self.spec),
        }
    }

    /// Returns the place where the name at a byte offset of the spec is declared. For a `use`, this is the beginning of its file, or of the
    /// first file in its folder.
    pub fn definition(&self, offset: usize) -> Option<Span> {
        if let Some(symbol) = self.index().at(offset) {
            return Some(self.index().symbols[symbol].declaration);
        }
        let token = self.token_at(offset)?;
        let path = Node::new(token.parent()?, Origin::Spec);
        let used = crate::gather::uses(&self.trees()[0]).into_iter().find(|used| path.span().contains(used.span))?;
        let path = crate::gather::resolve(&self.spec.name, &used.text);
        let first = self.others.iter().find_map(|other| match &other.role {
            Role::Folder(paths) if other.name == path => paths.first(),
            Role::Folder(_) | Role::Part | Role::Whole | Role::Python | Role::Missing(_) => None,
        });
        let path = first.unwrap_or(&path);
        let place = self.others.iter().position(|other| other.name == *path && other.role == Role::Part)?;
        Some(Span { origin: Origin::Interface(u32::try_from(place).ok()?), start: 0, end: 0 })
    }

    /// Returns the declaration of the name at a byte offset of the spec.
    pub fn declaration(&self, offset: usize) -> Option<Declaration> {
        let symbol = self.index().at(offset)?;
        let span = self.index().symbols[symbol].declaration;
        Some(Declaration { file: self.source(span).name.clone(), start: span.start, end: span.end })
    }

    /// Returns every place of a name. The declaration comes first, and the other places are in the order of the text. The list is empty if
    /// this spec does not know the name.
    pub fn references(&self, declaration: &Declaration) -> Vec<Span> {
        let Some(symbol) = self.find(declaration) else { return Vec::new() };
        let mut places: Vec<Span> = self.index().places(symbol).collect();
        places.sort_by_key(|span| (*span != self.index().symbols[symbol].declaration, *span));
        places
    }

    /// Returns the symbol with this declaration.
    fn find(&self, declaration: &Declaration) -> Option<usize> {
        let is_it = |span: Span| {
            (span.start, span.end) == (declaration.start, declaration.end) && self.source(span).name == declaration.file
        };
        self.index().symbols.iter().position(|symbol| is_it(symbol.declaration))
    }

    /// Returns the trees of the spec and of the other texts.
    fn trees(&self) -> &[Node] {
        self.trees.get_or_init(|| {
            let origins = (0..).map(Origin::Interface);
            let sources = std::iter::once((Origin::Spec, &self.spec)).chain(origins.zip(&self.others));
            sources.map(|(origin, source)| Node::new(parse(source, origin).root, origin)).collect()
        })
    }

    fn index(&self) -> &Index {
        self.index.get_or_init(|| Index::new(&self.model, self.trees(), &|span| self.text(span)))
    }

    /// Returns the text of a span.
    fn text(&self, span: Span) -> &str {
        self.source(span).text.get(span.start as usize..span.end as usize).unwrap_or_default()
    }

    /// Returns the token at a byte offset of the spec. Between two tokens, a word has precedence, and then a token that is not white space.
    fn token_at(&self, offset: usize) -> Option<SyntaxToken> {
        let offset = u32::try_from(offset.min(self.spec.text.len())).ok()?;
        let found = self.trees()[0].syntax().token_at_offset(offset.into());
        let (left, right) = (found.clone().left_biased()?, found.right_biased()?);
        let is_word = |token: &SyntaxToken| token.kind() == SyntaxKind::Ident;
        let is_blank = |token: &SyntaxToken| token.kind() == SyntaxKind::Whitespace;
        Some(if is_word(&left) && !is_word(&right) || is_blank(&right) { left } else { right })
    }
}
