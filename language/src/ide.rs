//! Answers the questions of an editor: diagnostics, definitions, references, completion, renames.
//!
//! Text and a place in, answers out: no protocol, no file, no state. An [`Analysis`] is one spec with the files it uses
//! and the interfaces of its programs, compiled once; it answers any number of questions about that text and is thrown
//! away at the next keystroke. Checking again from the start is fast enough for that (see *Measured* in the
//! architecture), and leaves nothing to go stale. The index of names, which only questions need, is made at the first
//! question.
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

/// A spec that was compiled once, to be asked about.
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

/// Where a name is declared, in a way that holds between specs: by the name of the text.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Declaration {
    /// Name of the source.
    pub file: String,
    /// First byte of the name.
    pub start: u32,
    /// One after its last byte.
    pub end: u32,
}

impl Analysis {
    /// Compiles a spec; `others` are the files it uses and the interfaces, as for [`crate::compile`].
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

    /// Returns the plan; absent exactly when there is an error.
    pub fn plan(&self) -> Option<&Plan> {
        self.plan.as_ref()
    }

    /// Returns the spec itself.
    pub fn spec(&self) -> &Source {
        &self.spec
    }

    /// Returns the files it uses and the interfaces, as they were given.
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

    /// Returns where the name at a byte offset of the spec is declared, or the beginning of the file that a `use` names; of a
    /// folder that of its first file.
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
            Role::Folder(_) | Role::Part | Role::Whole | Role::Missing(_) => None,
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

    /// Returns every place of a name, its declaration first, else in the order of the text; none if this spec does not
    /// know it.
    pub fn references(&self, declaration: &Declaration) -> Vec<Span> {
        let Some(symbol) = self.find(declaration) else { return Vec::new() };
        let mut places: Vec<Span> = self.index().places(symbol).collect();
        places.sort_by_key(|span| (*span != self.index().symbols[symbol].declaration, *span));
        places
    }

    /// The symbol that is declared there.
    fn find(&self, declaration: &Declaration) -> Option<usize> {
        let is_it = |span: Span| {
            (span.start, span.end) == (declaration.start, declaration.end) && self.source(span).name == declaration.file
        };
        self.index().symbols.iter().position(|symbol| is_it(symbol.declaration))
    }

    /// The trees of the spec and of the others.
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

    /// The token at a byte offset of the spec that means something; at a border a word wins.
    fn token_at(&self, offset: usize) -> Option<SyntaxToken> {
        let offset = u32::try_from(offset.min(self.spec.text.len())).ok()?;
        let found = self.trees()[0].syntax().token_at_offset(offset.into());
        let (left, right) = (found.clone().left_biased()?, found.right_biased()?);
        let is_word = |token: &SyntaxToken| token.kind() == SyntaxKind::Ident;
        let is_blank = |token: &SyntaxToken| token.kind() == SyntaxKind::Whitespace;
        Some(if is_word(&left) && !is_word(&right) || is_blank(&right) { left } else { right })
    }
}
