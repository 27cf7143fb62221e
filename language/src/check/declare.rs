//! What a text declares.

mod fixed;
mod module;
mod process;

pub(super) use fixed::Templates;

use super::names::twice;
use super::range::Range;
use super::spec::{Const, Consts, Kind, NamedType, Param, Scope, Spec, Value, ValueKind};
use super::unit;
use super::value::value;
use crate::diagnostic::{Code, Diagnostic};
use crate::source::{Origin, Span};
use crate::syntax::SyntaxKind::{self, Constant, RecordType, Type};
use crate::syntax::ast::{Name, Node};

/// Adds the constants of a tree: they are known everywhere, whatever the order of the text. Of one whose text has
/// damage, which is in order, the name is known.
pub(super) fn constants(spec: &mut Spec, root: &Node, damage: &[Span], diagnostics: &mut Vec<Diagnostic>) {
    for item in root.children_of(SyntaxKind::ConstItem) {
        let (Some(name), Some(node)) = (item.title(), item.child(Constant)) else { continue };
        if let Some(first) = spec.consts.get(&name.text) {
            diagnostics.push(twice("constant", &name.text, name.span, first.name.span));
            continue;
        }
        let scope = Scope { params: &[], consts: &spec.consts, indices: &[] };
        let list = node.child(SyntaxKind::List);
        let nodes = list.as_ref().map_or_else(|| vec![node.clone()], |list| list.children_of(Constant).collect());
        let mut values: Vec<Value> = nodes.iter().map(|node| value(node, scope, diagnostics)).collect();
        let is_damaged = !within(damage, item.span()).is_empty();
        if is_damaged || values.iter().any(|value| matches!(value.kind, ValueKind::Broken)) {
            values = vec![Value { span: node.span(), kind: ValueKind::Broken, dimension: None }];
        }
        spec.consts.insert(name.text.clone(), Const { name, values, is_list: list.is_some(), is_param: false });
    }
}

/// Adds everything else that a tree declares to the spec; `damage` is where its text could not be read, in order.
pub(super) fn declare(
    spec: &mut Spec,
    root: &Node,
    (origin, is_part): (Origin, bool),
    (damage, templates): (&[Span], &Templates),
    diagnostics: &mut Vec<Diagnostic>,
) {
    for item in root.children().filter(|item| !is_part || !templates.contains(item)) {
        let damage = within(damage, item.span());
        if item.kind() == SyntaxKind::TypeItem {
            // What is not known whole is not checked.
            let named = if damage.is_empty() { named_type(&item, is_part, &spec.consts, diagnostics) } else { None };
            if let Some(named) = named {
                add_type(spec, named, diagnostics);
            }
        } else if item.kind() == SyntaxKind::Module {
            if let Some(module) = module::module(&item, damage, &spec.consts, diagnostics) {
                add_module(spec, module, origin, diagnostics);
            }
        } else if item.kind() == SyntaxKind::Process {
            if !is_part {
                let message = "an interface consists of `module` blocks and `type`s only";
                diagnostics.push(Diagnostic::new(Code::E0108, item.span(), message));
            } else if let Some(process) = process::process(&item, damage, &spec.consts, diagnostics) {
                add_process(spec, process, diagnostics);
            }
        }
    }
}

/// The items of a tree, each with where its text could not be read.
pub(super) fn items(root: &Node, damage: &[Span]) -> Vec<(Node, Vec<Span>)> {
    root.children().map(|item| (item.clone(), within(damage, item.span()).to_vec())).collect()
}

/// The places, which are sorted, that start in a span.
fn within(places: &[Span], span: Span) -> &[Span] {
    let from = places.partition_point(|place| place.start < span.start);
    let length = places[from..].partition_point(|place| place.start <= span.end);
    &places[from..from + length]
}

fn add_process(spec: &mut Spec, process: super::spec::Process, diagnostics: &mut Vec<Diagnostic>) {
    if let Some(&first) = spec.process_names.get(&process.name.text) {
        let first = spec.processes[first].name.span;
        diagnostics.push(twice("process", &process.name.text, process.name.span, first));
        return;
    }
    spec.process_names.insert(process.name.text.clone(), spec.processes.len());
    spec.processes.push(process);
}

/// Interfaces in the spec win over those of programs; of two programs the first wins.
fn add_module(spec: &mut Spec, module: super::spec::Module, origin: Origin, diagnostics: &mut Vec<Diagnostic>) {
    let Some(&first) = spec.module_names.get(&module.name.text) else {
        spec.module_names.insert(module.name.text.clone(), spec.modules.len());
        spec.modules.push(module);
        return;
    };
    let first = spec.modules[first].name.span;
    if origin == Origin::Spec {
        diagnostics.push(twice("module", &module.name.text, module.name.span, first));
    } else if first.origin != Origin::Spec {
        let message = format!("interface of `{}` is given twice; the first is used", module.name.text);
        let diagnostic = Diagnostic::new(Code::W0110, module.name.span, message);
        diagnostics.push(diagnostic.reason(first, "first given here"));
    }
}

/// `type Name = Type;`
fn named_type(node: &Node, is_own: bool, consts: &Consts, diagnostics: &mut Vec<Diagnostic>) -> Option<NamedType> {
    let (name, kind) = (node.title()?, kind(node, consts, diagnostics)?);
    Some(NamedType { name, doc: node.doc(), kind, is_own })
}

/// A spec and the files that it uses have a type of one name once; programs have their own.
fn add_type(spec: &mut Spec, named: NamedType, diagnostics: &mut Vec<Diagnostic>) {
    let Name { text, span } = named.name.clone();
    if unit::is_type(&text) {
        let message = format!("`{text}` is a type of the language");
        diagnostics.push(Diagnostic::new(Code::E0110, span, message).help("choose another name"));
        return;
    }
    let known = spec.type_names.entry(text.clone()).or_default();
    let is_second = |first: &&NamedType| first.name.span.origin == span.origin || first.is_own && named.is_own;
    match known.iter().map(|&first| &spec.types[first]).find(is_second) {
        Some(first) => diagnostics.push(twice("type", &text, span, first.name.span)),
        None => {
            known.push(spec.types.len());
            spec.types.push(named);
        }
    }
}

/// The type of a parameter, field, port or outcome; nothing if there is none.
fn kind(node: &Node, consts: &Consts, diagnostics: &mut Vec<Diagnostic>) -> Option<Kind> {
    let node = node.child(Type)?;
    let fields = node.child(RecordType).map(|fields| params(&fields, "field", consts, diagnostics));
    let kind = Kind { text: node.compact_text(), span: node.span(), fields };
    (!kind.text.is_empty()).then_some(kind)
}

/// Reads a list of parameters, or of fields.
fn params(node: &Node, what: &str, consts: &Consts, diagnostics: &mut Vec<Diagnostic>) -> Vec<Param> {
    let mut params: Vec<Param> = Vec::new();
    for node in node.children_of(SyntaxKind::Param) {
        let Some(name) = node.names().next() else { continue };
        if let Some(first) = params.iter().find(|param| param.name.text == name.text) {
            diagnostics.push(twice(what, &name.text, name.span, first.name.span));
            continue;
        }
        let scope = Scope { params: &[], consts, indices: &[] };
        let default = node.child(Constant).map(|node| value(&node, scope, diagnostics));
        let default = default.filter(|value| !matches!(value.kind, ValueKind::Broken));
        let range = node.child(SyntaxKind::Range).and_then(|node| Range::read(&node, scope, diagnostics));
        params.push(Param { name, kind: kind(&node, consts, diagnostics), range, default });
    }
    params
}
