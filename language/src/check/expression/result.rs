//! Names for results: `find : p => (goto with p ; place with p)`.

use super::{Group, expression};
use crate::check::spec::{Expr, ExprKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{Name, Node};

/// The name of a value that is kept while an operand runs.
#[derive(Debug)]
pub(super) struct Known {
    name: Name,
    is_used: bool,
}

/// `p => goto with p`
pub(super) fn named(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let (name, body) = (node.names().next()?, node.children().next()?);
    Some(kept(name, &body, group).kind)
}

/// Reads an operand in which a name stands for the value that the operand is started with.
pub(super) fn kept(name: Name, body: &Node, group: &mut Group<'_>) -> Expr {
    let span = Span { start: name.span.start, ..body.span() };
    let is_taken = report_taken(&name, group);
    group.kept.results.push(Known { name: name.clone(), is_used: is_taken });
    let inner = expression(body, group);
    let known = group.kept.results.pop();
    if !is_taken {
        group.kept.ended.push(name.clone());
    }
    if known.is_some_and(|known| !known.is_used) && !group.damage.actions {
        let found = Diagnostic::new(Code::W0431, name.span, format!("`{}` is never used", name.text));
        group.diagnostics().push(found.help(format!("start a process with it: `process with {}`", name.text)));
    }
    let kind = if is_taken { ExprKind::Broken } else { ExprKind::Named(name, Box::new(inner)) };
    Expr { span, kind }
}

/// Returns whether this is the name of a result that is known here, and notes the use.
pub(super) fn is_known(name: &Name, group: &mut Group<'_>) -> bool {
    let known = group.kept.results.iter_mut().rev().find(|known| known.name.text == name.text);
    known.is_some_and(|known| {
        known.is_used = true;
        true
    })
}

/// Reports a start value that is the name of a result of an earlier operand. Returns whether it is.
pub(super) fn report_ended(name: &Name, group: &mut Group<'_>) -> bool {
    let Some(span) = group.kept.ended.iter().find(|ended| ended.text == name.text).map(|ended| ended.span) else {
        return false;
    };
    let found = Diagnostic::new(Code::E0425, name.span, format!("the result `{}` is not known here", name.text));
    let found = found.reason(span, "known only in this operand");
    let help = format!("put parentheses around each part that uses it: `{0} => (a with {0} ; b with {0})`", name.text);
    group.diagnostics().push(found.help(help));
    true
}

/// Reports the name of a result that has another meaning there already. Returns whether it has one.
fn report_taken(name: &Name, group: &mut Group<'_>) -> bool {
    let param = group.scope.params.iter().find(|param| param.name.text == name.text).map(|param| param.name.span);
    let named = group.scope.consts.get(&name.text).map(|named| named.name.span);
    let instance = group.names.declared(&name.text);
    let is_index = group.indices.iter().any(|(index, _)| *index == name.text);
    let is_variable = group.kept.variables.contains_key(&name.text);
    let declared = around(name, group).or(param).or(named).or(instance);
    if declared.is_none() && !is_index && !is_variable && !["true", "false"].contains(&name.text.as_str()) {
        return false;
    }
    let message = format!("`{}` has another meaning here already", name.text);
    let found = Diagnostic::new(Code::E0430, name.span, message);
    let found = match declared {
        Some(span) => found.reason(span, "declared here"),
        None => found,
    };
    group.diagnostics().push(match instance {
        Some(_) => {
            found.help(format!("give the result another name; to run `{}` first, write `;` instead of `=>`", name.text))
        }
        None => found.help("give the result another name"),
    });
    true
}

/// Reports the variable of a replication that has the name of a result around it.
pub(super) fn report_index(variable: &Name, group: &mut Group<'_>) {
    if let Some(span) = around(variable, group) {
        let message = format!("`{}` is the name of a result here already", variable.text);
        let found = Diagnostic::new(Code::E0430, variable.span, message).reason(span, "declared here");
        group.diagnostics().push(found.help("give the index another name"));
    }
}

/// Returns where the result of this name gets its name, if it is known here.
fn around(name: &Name, group: &Group<'_>) -> Option<Span> {
    group.kept.results.iter().find(|known| known.name.text == name.text).map(|known| known.name.span)
}
