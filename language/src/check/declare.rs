//! Collects the declarations of all texts.

mod environment;
mod module;
mod process;
mod python;
pub(super) mod ros_action;
mod ros_components;
pub(super) mod ros_node;
pub(super) mod silent;
mod template;

pub(super) use module::outcomes;
pub(super) use template::Templates;

use super::diagnostics::Diagnostics;
use super::names::twice;
use super::range::Range;
use super::spec::{Const, FIELDS_MAX, Kind, NamedType, Param, Scope, Spec, Value, ValueKind};
use super::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::source::{Origin, Span};
use crate::syntax::SyntaxKind::{self, Constant, RecordType, Type};
use crate::syntax::ast::{Name, Node};
use crate::unit;
use std::collections::BTreeMap;

/// Reads the texts one after the other and collects their declarations.
pub(super) struct ItemCollector<'a> {
    pub(super) spec: &'a mut Spec,
    pub(super) diagnostics: &'a mut Diagnostics,
}

/// The tree of one text.
pub(super) struct Tree {
    pub(super) root: Node,
    pub(super) origin: Origin,
    /// Whether the text is the spec or a file that the spec uses. It is `false` for interfaces.
    pub(super) is_part: bool,
    /// The command of the program in Python that has printed the text.
    pub(super) python: Option<String>,
    /// The places where the text could not be read, in order.
    pub(super) damage: Vec<Span>,
}

impl Tree {
    /// Returns the items. Each has the places where its text could not be read.
    pub(super) fn items(&self) -> impl Iterator<Item = (Node, Vec<Span>)> + '_ {
        self.root.children().map(|item| {
            let damage = within(&self.damage, item.span()).to_vec();
            (item, damage)
        })
    }
}

impl ItemCollector<'_> {
    /// Adds the constants of a tree. They are known everywhere, in any order of the text. If the text of a constant is
    /// damaged, only its name is known.
    pub(super) fn constants(&mut self, tree: &Tree) {
        for item in tree.root.children_of(SyntaxKind::ConstItem) {
            let (Some(name), Some(node)) = (item.title(), item.child(Constant)) else { continue };
            if let Some(first) = self.spec.consts.get(&name.text) {
                self.diagnostics.push(twice("constant", &name.text, name.span, first.name.span));
                continue;
            }
            let list = node.child(SyntaxKind::List);
            let nodes = list.as_ref().map_or_else(|| vec![node.clone()], |list| list.children_of(Constant).collect());
            let mut reader = self.reader();
            let mut values: Vec<Value> = nodes.iter().map(|node| reader.value(node)).collect();
            let is_damaged = !within(&tree.damage, item.span()).is_empty();
            if is_damaged || values.iter().any(|value| matches!(value.kind, ValueKind::Broken)) {
                values = vec![Value { span: node.span(), kind: ValueKind::Broken, dimension: None }];
            }
            let named = Const { name: name.clone(), values, is_list: list.is_some(), is_param: false };
            self.spec.consts.insert(name.text, named);
        }
    }

    /// Adds all other declarations of a tree to the spec.
    pub(super) fn items(&mut self, tree: &Tree, templates: &Templates) {
        for item in tree.root.children().filter(|item| !tree.is_part || !templates.contains(item)) {
            let damage = within(&tree.damage, item.span());
            if item.kind() == SyntaxKind::TypeItem {
                // The type is not checked if its text is damaged.
                let named = if damage.is_empty() { self.named_type(&item, tree.is_part) } else { None };
                if let Some(named) = named {
                    self.add_type(named);
                }
            } else if item.kind() == SyntaxKind::Module {
                if let Some(module) = module::module(&item, damage, &mut self.reader()) {
                    self.add_module(module, tree);
                }
            } else if item.kind() == SyntaxKind::Process {
                if !tree.is_part {
                    let message = "an interface consists of `module` blocks and `type`s only";
                    self.diagnostics.push(Diagnostic::new(Code::E0108, item.span(), message));
                } else if let Some(process) = process::process(&item, damage, &self.spec.consts, self.diagnostics) {
                    self.add_process(process);
                }
            }
        }
    }

    /// Returns a reader of values. In a value, a name means the constant with this name. If there
    /// is no such constant, the name itself is the value.
    fn reader(&mut self) -> Reader<'_> {
        let scope = Scope { params: &[], consts: &self.spec.consts, indices: &[] };
        Reader { scope, diagnostics: self.diagnostics }
    }

    fn add_process(&mut self, process: super::spec::Process) {
        if let Some(&first) = self.spec.process_names.get(&process.name.text) {
            let first = self.spec.processes[first].name.span;
            self.diagnostics.push(twice("process", &process.name.text, process.name.span, first));
            return;
        }
        self.spec.process_names.insert(process.name.text.clone(), self.spec.processes.len());
        self.spec.processes.push(process);
    }

    /// Interfaces in the spec have precedence over the interfaces of programs. Of two programs with the same module,
    /// the first is used. A module with a program in Python has the interface that this program prints, and no other one.
    fn add_module(&mut self, module: super::spec::Module, tree: &Tree) {
        let origin = tree.origin;
        let asked = self.spec.module_names.get(&module.name.text).map(|&first| &mut self.spec.modules[first]);
        match (asked.filter(|module| module.is_asked), &tree.python) {
            (Some(asked), Some(command)) if asked.is_run_by(command) => return asked.take_interface(module),
            (Some(_), None) if tree.is_part => {}
            (Some(_), None) | (_, Some(_)) => return,
            (None, None) => {}
        }
        let Some(&first) = self.spec.module_names.get(&module.name.text) else {
            self.spec.module_names.insert(module.name.text.clone(), self.spec.modules.len());
            self.spec.modules.push(module);
            return;
        };
        let first = self.spec.modules[first].name.span;
        if origin == Origin::Spec {
            self.diagnostics.push(twice("module", &module.name.text, module.name.span, first));
        } else if first.origin != Origin::Spec {
            let message = format!("interface of `{}` is given twice; the first is used", module.name.text);
            let diagnostic = Diagnostic::new(Code::W0110, module.name.span, message);
            self.diagnostics.push(diagnostic.reason(first, "first given here"));
        }
    }

    /// Reads `type Name = Type;`.
    fn named_type(&mut self, node: &Node, is_own: bool) -> Option<NamedType> {
        let (name, kind) = (node.title()?, kind(node, &mut self.reader())?);
        Some(NamedType { name, doc: node.doc(), kind, is_own })
    }

    /// Adds a type. The spec and its files may declare each type name only once. Programs have separate types.
    fn add_type(&mut self, named: NamedType) {
        let Name { text, span } = named.name.clone();
        if unit::is_type(&text) {
            let message = format!("`{text}` is already a type of the language");
            self.diagnostics.push(Diagnostic::new(Code::E0110, span, message).help("choose another name"));
            return;
        }
        let known = self.spec.type_names.entry(text.clone()).or_default();
        let is_second = |first: &&NamedType| first.name.span.origin == span.origin || first.is_own && named.is_own;
        match known.iter().map(|&first| &self.spec.types[first]).find(is_second) {
            Some(first) => self.diagnostics.push(twice("type", &text, span, first.name.span)),
            None => {
                known.push(self.spec.types.len());
                self.spec.types.push(named);
            }
        }
    }
}

/// Returns the places that start in a span. `places` is sorted.
fn within(places: &[Span], span: Span) -> &[Span] {
    let from = places.partition_point(|place| place.start < span.start);
    let length = places[from..].partition_point(|place| place.start <= span.end);
    &places[from..from + length]
}

/// Reads the type of a parameter, field, port or outcome, if the text has one.
pub(super) fn kind(node: &Node, reader: &mut Reader<'_>) -> Option<Kind> {
    let node = node.child(Type)?;
    let fields = node.child(RecordType).map(|fields| params(&fields, "field", reader));
    let kind = Kind { text: node.compact_text(), span: node.span(), fields };
    (!kind.text.is_empty()).then_some(kind)
}

/// Reads a list of parameters or fields. `what` is the word for them in messages.
fn params(node: &Node, what: &str, reader: &mut Reader<'_>) -> Vec<Param> {
    let mut params: Vec<Param> = Vec::new();
    let mut first: BTreeMap<String, Span> = BTreeMap::new();
    for node in node.children_of(SyntaxKind::Param) {
        let Some(name) = node.names().next() else { continue };
        if let Some(&first) = first.get(&name.text) {
            reader.diagnostics.push(twice(what, &name.text, name.span, first));
            continue;
        }
        first.insert(name.text.clone(), name.span);
        if params.len() == FIELDS_MAX {
            let message = format!("more than {FIELDS_MAX} {what}s");
            reader.diagnostics.push(Diagnostic::new(Code::E0702, name.span, message));
            break;
        }
        let default = node.child(Constant).map(|node| reader.value(&node));
        let default = default.filter(|value| !matches!(value.kind, ValueKind::Broken));
        let range = node.child(SyntaxKind::Range).and_then(|node| Range::read(&node, reader));
        params.push(Param { name, kind: kind(&node, reader), range, default });
    }
    params
}
