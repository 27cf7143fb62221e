//! The outline of a file: its declarations, nested.

use super::Analysis;
use crate::source::Span;
use crate::syntax::SyntaxKind;
use crate::syntax::ast::{Name, Node};

/// The kind of a symbol in the outline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutlineKind {
    /// A process group.
    Process,
    /// A module interface.
    Module,
    /// A named constant.
    Constant,
    /// A named type.
    Type,
    /// An instance.
    Instance,
    /// An external port, or a port of a module.
    Port,
    /// A connection set.
    Connections,
    /// The event actions, or a state of an activity.
    Actions,
}

/// One line of the outline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// The kind of the declaration.
    pub kind: OutlineKind,
    /// The name of the declaration.
    pub name: String,
    /// The type of an instance, or the owner of a set. It may be empty.
    pub detail: String,
    /// The span of the whole declaration.
    pub span: Span,
    /// The span of the name.
    pub name_span: Span,
    /// The inner declarations.
    pub children: Vec<Self>,
}

impl Analysis {
    /// Returns the declarations of the spec, in the order of the text.
    pub fn outline(&self) -> Vec<Symbol> {
        self.trees()[0].children().filter_map(|item| symbol(&item)).collect()
    }
}

fn symbol(node: &Node) -> Option<Symbol> {
    let names: Vec<Name> = node.names().collect();
    let compact = |kind| node.child(kind).map(|part: Node| part.compact_text()).unwrap_or_default();
    let (kind, name, detail) = match node.kind() {
        SyntaxKind::Process => (OutlineKind::Process, node.title()?, compact(SyntaxKind::Params)),
        SyntaxKind::Module => (OutlineKind::Module, node.title()?, compact(SyntaxKind::Params)),
        SyntaxKind::ConstItem => (OutlineKind::Constant, node.title()?, compact(SyntaxKind::Constant)),
        SyntaxKind::TypeItem => (OutlineKind::Type, node.title()?, compact(SyntaxKind::Type)),
        SyntaxKind::Instance => (OutlineKind::Instance, names.first()?.clone(), compact(SyntaxKind::Type)),
        SyntaxKind::Export => (OutlineKind::Port, names.first()?.clone(), compact(SyntaxKind::Endpoint)),
        SyntaxKind::Port => (OutlineKind::Port, names.get(1)?.clone(), compact(SyntaxKind::Type)),
        SyntaxKind::Connections => (OutlineKind::Connections, names.first()?.clone(), compact(SyntaxKind::Owner)),
        SyntaxKind::State => (OutlineKind::Actions, names.last()?.clone(), String::new()),
        SyntaxKind::Actions => (OutlineKind::Actions, names.first()?.clone(), String::new()),
        _ => return None,
    };
    let sections = [SyntaxKind::Instances, SyntaxKind::External];
    let inner = node.children().flat_map(|part| match sections.contains(&part.kind()) {
        true => part.children().collect::<Vec<_>>(),
        false => vec![part],
    });
    let children = inner.filter_map(|part| symbol(&part)).collect();
    Some(Symbol { kind, name: name.text, detail, span: node.span(), name_span: name.span, children })
}
