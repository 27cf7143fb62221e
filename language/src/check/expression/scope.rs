//! `shield`, `using`, `match`: what they hold, take and tell apart.

use super::{Group, expression, parts};
use crate::check::names::twice;
use crate::check::spec::{Arm, ExprKind};
use crate::check::value::duration;
use crate::diagnostic::{Code, Diagnostic};
use crate::similar::nearest;
use crate::syntax::SyntaxKind::{self, Constant};
use crate::syntax::ast::{Name, Node};

pub(super) fn shield(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<ExprKind> {
    let bound = match node.child(Constant) {
        Some(bound) => Some(duration(&bound, group.consts, diagnostics)?),
        None => None,
    };
    Some(ExprKind::Shield(bound, Box::new(parts(node, group, diagnostics).pop()?)))
}

pub(super) fn using(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<ExprKind> {
    let mut taken: Vec<usize> = Vec::new();
    for name in node.children_of(SyntaxKind::Resources).flat_map(|node| node.names().collect::<Vec<_>>()) {
        let Some(index) = group.resources.iter().position(|known| known.text == name.text) else {
            // One cause is one report; and what is declared in damaged text is not known.
            if !group.damage.header && group.unknown.insert(name.text.clone()) {
                diagnostics.push(unknown(&name, group));
            }
            continue;
        };
        if !taken.contains(&index) {
            taken.push(index);
        }
    }
    group.taken.extend(&taken);
    let operand = Box::new(parts(node, group, diagnostics).pop()?);
    Some(ExprKind::Using(taken, operand))
}

fn unknown(name: &Name, group: &Group<'_>) -> Diagnostic {
    let diagnostic = Diagnostic::new(Code::E0204, name.span, format!("unknown resource `{}`", name.text));
    let known = group.resources.iter().map(|known| known.text.as_str());
    let near = nearest(&name.text, known).and_then(|near| group.resources.iter().find(|known| known.text == near));
    match near {
        Some(near) => diagnostic.reason(near.span, "declared here").replace(name.span, &near.text),
        None => diagnostic.help(format!(
            "declare it in the group: `resource {0};`, or have it handed to the group: a parameter `{0}: Resource`",
            name.text
        )),
    }
}

pub(super) fn matching(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<ExprKind> {
    let mut arms: Vec<Arm> = Vec::new();
    for part in node.children_of(SyntaxKind::Arm) {
        let Some(name) = part.names().next() else { continue };
        let Some(body) = part.children().next().map(|body| expression(&body, group, diagnostics)) else { continue };
        let is_same = |arm: &&Arm| arm.tag.as_ref().map_or("else", |tag| tag.text.as_str()) == name.text;
        if let Some(first) = arms.iter().find(is_same) {
            let first = first.tag.as_ref().map_or(first.body.span, |tag| tag.span);
            diagnostics.push(twice("arm", &name.text, name.span, first));
            continue;
        }
        if let Some(last) = arms.last().filter(|last| last.tag.is_none()) {
            let message = format!("`{}` stands behind `else`, which takes everything", name.text);
            let diagnostic = Diagnostic::new(Code::W0422, name.span, message).label("never taken");
            diagnostics.push(diagnostic.reason(last.body.span, "taken instead").help("put `else` last"));
            continue;
        }
        let tag = (name.text != "else").then_some(name);
        arms.push(Arm { tag, body });
    }
    (!arms.is_empty()).then_some(ExprKind::Match(arms))
}
