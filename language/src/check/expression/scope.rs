//! Checks `shield`, `using`, `repeat` and `match`.

use super::{Group, expression, parts, result};
use crate::check::names::twice;
use crate::check::spec::{Arm, ExprKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::similar::Near;
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Constant};
use crate::syntax::ast::{Name, Node, Token};
use std::collections::{BTreeMap, BTreeSet};

pub(super) fn shield(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let bound = match node.child(Constant) {
        Some(bound) => Some(group.reader().duration(&bound)?),
        None => None,
    };
    Some(ExprKind::Shield(bound, Box::new(parts(node, group).pop()?)))
}

pub(super) fn using(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let (mut taken, mut known) = (Vec::new(), BTreeSet::new());
    for name in node.children_of(SyntaxKind::Resources).flat_map(|node| node.names().collect::<Vec<_>>()) {
        let Some(&index) = group.resources.places.get(name.text.as_str()) else {
            // Each unknown name is reported once. In a damaged header, the declarations are unknown.
            if !group.damage.header && group.resources.unknown.insert(name.text.clone()) {
                report_unknown(&name, group);
            }
            continue;
        };
        if known.insert(index) {
            taken.push(index);
        }
    }
    group.resources.taken.extend(&taken);
    let operand = Box::new(parts(node, group).pop()?);
    Some(ExprKind::Using(taken, operand))
}

fn report_unknown(name: &Name, group: &mut Group<'_>) {
    let diagnostic = Diagnostic::new(Code::E0204, name.span, format!("unknown resource `{}`", name.text));
    let resources = group.resources.all;
    let near = group.diagnostics().near(&name.text, resources.iter().map(|known| known.text.as_str()));
    let declared = |near: &Near<'_>| resources.iter().find(|known| known.text == near.name);
    let diagnostic = match near.as_ref().and_then(|near| Some((near, declared(near)?))) {
        Some((near, known)) => diagnostic.reason(known.span, "declared here").rename(name.span, near),
        None => diagnostic.help(format!(
            "declare it in the group: `resource {0};`, or add a parameter to the group: `{0}: Resource`",
            name.text
        )),
    };
    group.diagnostics().push(diagnostic);
}

pub(super) fn repeat(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let mut until: Vec<Name> = Vec::new();
    // The first name is the word `until`, so it is skipped.
    for name in node.child(SyntaxKind::Until).iter().flat_map(|node| node.names().skip(1).collect::<Vec<_>>()) {
        match until.iter().find(|known| known.text == name.text) {
            Some(known) => {
                let found = twice("outcome", &name.text, name.span, known.span);
                group.diagnostics().push(found);
            }
            None => until.push(name),
        }
    }
    let operand = Box::new(parts(node, group).pop()?);
    (!until.is_empty()).then_some(ExprKind::Repeat(until, operand))
}

/// Reports a text in place of an outcome: `look : match { "found" => grasp }`.
fn report_text(text: &Token, group: &mut Group<'_>) {
    let message = "an outcome is a name, without quotes";
    let found = Diagnostic::new(Code::E0421, text.span(), message);
    let help = "to choose by the reason of a failure, write `process else match { \"no way\" => other }`";
    group.diagnostics().push(found.help(help));
}

pub(super) fn matching(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let mut arms: Vec<Arm> = Vec::new();
    let mut known: BTreeMap<String, Span> = BTreeMap::new();
    for part in node.children_of(SyntaxKind::Arm) {
        if let Some(text) = part.tokens().next().filter(|token| token.kind() == SyntaxKind::Text) {
            report_text(&text, group);
            continue;
        }
        let mut names = part.names();
        let (Some(name), value) = (names.next(), names.next()) else { continue };
        let Some(body) = part.children().next() else { continue };
        let body = match value {
            Some(value) => result::kept(value, &body, group),
            None => expression(&body, group),
        };
        if let Some(&first) = known.get(&name.text) {
            group.diagnostics().push(twice("arm", &name.text, name.span, first));
            continue;
        }
        known.insert(name.text.clone(), name.span);
        if let Some(last) = arms.last().filter(|last| last.tag.is_none()) {
            let message = format!("the arm `{}` is never taken: the `else` before it takes every outcome", name.text);
            let diagnostic = Diagnostic::new(Code::W0422, name.span, message).label("never taken");
            group.diagnostics().push(diagnostic.reason(last.body.span, "taken instead").help("put `else` last"));
            continue;
        }
        let tag = (name.text != "else").then_some(name);
        arms.push(Arm { tag, body });
    }
    (!arms.is_empty()).then_some(ExprKind::Match(arms))
}
