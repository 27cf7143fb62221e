//! Replication: `robot[4]`, `robot[i]`, `hosts[i]`. The elements of an array are separate instances with the names `robot_0`, `robot_1` and
//! so on. An indexed name is replaced by such a name before other checks.

use super::diagnostics::Diagnostics;
use super::names::Names;
use super::spec::Binding;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{Index, Number};
use crate::syntax::ast::{Name, Node};

/// The largest number of instances of one array.
pub(super) const COUNT_MAX: usize = 1000;

/// Returns the name of one instance of an array.
pub(super) fn element(array: &str, index: usize) -> String {
    format!("{array}_{index}")
}

/// Returns an index as a number of the language.
pub(super) fn number(index: usize) -> f64 {
    u32::try_from(index).map_or(f64::MAX, f64::from)
}

/// Returns the value of `[2]` or `[i]`. A variable without a value is reported.
pub(super) fn known(index: &Node, bindings: &[Binding], diagnostics: &mut Diagnostics) -> Option<usize> {
    if let Some(number) = index.token(Number) {
        let value = number.text().parse().ok();
        if value.is_none() {
            diagnostics.push(Diagnostic::new(Code::E0203, number.span(), "an index is a whole number"));
        }
        return value;
    }
    let name = index.names().next()?;
    let bound = bindings.iter().rev().find(|(known, _)| *known == name.text);
    if bound.is_none() {
        let message = format!("`{}` is not an index here", name.text);
        let help = "an index is a number, the `i` of a replicated instance or connection, or the name after `all`";
        diagnostics.push(Diagnostic::new(Code::E0203, name.span, message).help(help));
    }
    bound.map(|&(_, value)| value)
}

/// Returns the first name of a node, with its index expanded.
pub(super) fn name(node: &Node, names: &mut Names<'_>, bindings: &[Binding]) -> Option<Name> {
    let name = node.names().next()?;
    match node.child(Index) {
        Some(index) => written_out(&name, &index, names, bindings),
        None if names.arrays.contains_key(&name.text) => {
            names.diagnostics.push(without_index(&name, names.arrays[&name.text]));
            None
        }
        None => Some(name),
    }
}

pub(super) fn without_index(name: &Name, count: usize) -> Diagnostic {
    let message = format!("`{}` is an array of {count} instances and needs an index here", name.text);
    let diagnostic = Diagnostic::new(Code::E0203, name.span, message);
    diagnostic
        .help(format!("write `{0}[0]` for one instance, `all i in 0..{count} ({0}[i])` for all instances", name.text))
}

/// Reports a name that is similar to the name of an array. Returns whether there is such an array.
pub(super) fn is_misspelt(name: &Name, names: &mut Names<'_>) -> bool {
    let arrays = names.arrays.keys().map(String::as_str);
    let Some(near) = names.diagnostics.near(&name.text, arrays) else { return false };
    let message = format!("unknown process `{}`", name.text);
    let diagnostic = Diagnostic::new(Code::E0201, name.span, message).label("not an instance of this group");
    names.diagnostics.push(diagnostic.help(format!("did you mean `{}`?", near.name)).rename(name.span, &near));
    true
}

/// Returns `robot_2` for `robot[2]`.
pub(super) fn written_out(name: &Name, index: &Node, names: &mut Names<'_>, bindings: &[Binding]) -> Option<Name> {
    let Some(&count) = names.arrays.get(&name.text) else {
        let is_exact = names.find(&name.text).is_some();
        if !is_exact && is_misspelt(name, names) {
            return None;
        }
        if is_exact || names.means_one(&name.text) {
            let message = format!("`{}` is a single instance, not an array", name.text);
            names.diagnostics.push(Diagnostic::new(Code::E0203, name.span, message));
            return None;
        }
        // Later checks report the unknown name.
        return Some(name.clone());
    };
    let value = known(index, bindings, names.diagnostics)?;
    if value >= count {
        let message = format!("`{}` has {count} instances, and no instance with the index {value}", name.text);
        names.diagnostics.push(Diagnostic::new(Code::E0203, index.span(), message).help("the first index is 0"));
        return None;
    }
    Some(Name { text: element(&name.text, value), span: name.span })
}

/// Returns the first unbound index variable in the parts of a node, with the number of its values.
pub(super) fn unbound(parts: &[Node], names: &Names<'_>, bindings: &[Binding]) -> Option<(String, usize)> {
    parts.iter().find_map(|part| {
        let variable = part.child(Index)?.names().next()?;
        let count = names.arrays.get(&part.names().next()?.text)?;
        let is_bound = bindings.iter().any(|(known, _)| *known == variable.text);
        (!is_bound).then_some((variable.text, *count))
    })
}
