//! Expands `all i in 0..4 (p[i])`, `race`, `each` and pools, and resolves `p[2]`.

use super::{Group, result};
use crate::check::count::{self, CountValue, Expected, whole};
use crate::check::index;
use crate::check::spec::{Expr, ExprKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::SyntaxKind::{DotDot, Labels, Number, Paren};
use crate::syntax::ast::{Name, Node, Token};
use std::collections::BTreeMap;

/// Expands a replication. `all` joins the copies with `,`, `race` with `#`, and `each` with `;`.
pub(super) fn all_of(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let words: Vec<Name> = node.names().collect();
    let (word, variable) = (words.first()?, words.get(1)?);
    let parens = node.child(Paren)?;
    // Without `..`, the text is damaged, which is already reported.
    node.token(DotDot)?;
    let (start, end) = range(node, group)?;
    result::report_index(variable, group);
    let mut copies: Vec<Expr> = Vec::new();
    let mut runs: BTreeMap<usize, Span> = BTreeMap::new();
    let mut rounds = group.diagnostics().rounds();
    for value in start..end {
        group.indices.push((variable.text.clone(), value));
        let copy = super::expression(&parens, group);
        group.indices.pop();
        group.diagnostics().end_round(&mut rounds);
        if group.is_full() {
            return None;
        }
        if word.text != "each"
            && let Some(shared) = shared(&copy, &mut runs, value > start)
        {
            let message =
                format!("one instance would run several times at the same time, once for each `{}`", variable.text);
            let diagnostic = Diagnostic::new(Code::E0401, shared, message);
            group
                .diagnostics()
                .push(diagnostic.help(format!("run another instance for each value: `robot[{}]`", variable.text)));
            return None;
        }
        copies.push(copy);
    }
    if copies.len() == 1 {
        return copies.pop().map(|only| only.kind);
    }
    Some(match word.text.as_str() {
        "race" => ExprKind::Disable(copies),
        "each" => ExprKind::Sequence(copies),
        _ => ExprKind::Concurrent(copies),
    })
}

/// Expands the second operand of `P ::[n] Q`, with one copy for each place of the pool.
pub(super) fn pool(
    count: &Node,
    span: Span,
    group: &mut Group<'_>,
    copy: &mut dyn FnMut(&mut Group<'_>) -> Expr,
) -> Option<Vec<Expr>> {
    let what = format!("the number of copies that may run at the same time, from 1 to {}", index::COUNT_MAX);
    let expected = Expected { help: Some("write `found ::[3] handle`"), ..Expected::new(1..=index::COUNT_MAX, what) };
    let places = expected.read(count, &mut group.reader())?;
    let mut copies = Vec::new();
    let mut runs: BTreeMap<usize, Span> = BTreeMap::new();
    let mut rounds = group.diagnostics().rounds();
    for place in 0..places {
        let around = group.pool.replace(place);
        let copy = copy(group);
        group.pool = around;
        group.diagnostics().end_round(&mut rounds);
        if group.is_full() {
            return None;
        }
        if let Some(shared) = shared(&copy, &mut runs, place > 0) {
            let message = format!("one instance would run up to {places} times at the same time");
            let diagnostic = Diagnostic::new(Code::E0401, shared, message).reason(span, "started again by each value");
            group
                .diagnostics()
                .push(diagnostic.help(format!("declare an instance for each copy: `name[{places}] instof ...`")));
            return None;
        }
        copies.push(copy);
    }
    Some(copies)
}

/// Returns the place of an instance that both this copy and an earlier copy run.
fn shared(copy: &Expr, runs: &mut BTreeMap<usize, Span>, is_later: bool) -> Option<Span> {
    let mut own = BTreeMap::new();
    collect(copy, &mut own);
    let shared = own.iter().find(|(slot, _)| is_later && runs.contains_key(slot)).map(|(_, &span)| span);
    runs.extend(own);
    shared
}

fn collect(expr: &Expr, runs: &mut BTreeMap<usize, Span>) {
    if let ExprKind::Run(slot, _) = &expr.kind {
        runs.insert(*slot, expr.span);
    }
    expr.parts().into_iter().for_each(|part| collect(part, runs));
}

/// Reads the two ends of `0..4`. Each end may also be the name of a number.
fn range(node: &Node, group: &mut Group<'_>) -> Option<(usize, usize)> {
    let consts = group.scope.consts;
    let tokens: Vec<Token> = node.tokens().collect();
    let dots = tokens.iter().position(|token| token.kind() == DotDot)?;
    let (start, end) = (tokens.get(dots.checked_sub(1)?)?, tokens.get(dots + 1)?);
    let named = match (whole(start, consts), whole(end, consts)) {
        (CountValue::Broken, _) | (_, CountValue::Broken) => return None,
        (CountValue::Number(start), CountValue::Number(end)) if start < end && end - start <= index::COUNT_MAX => {
            return Some((start, end));
        }
        (CountValue::Other(named), _) | (_, CountValue::Other(named)) => named,
        (CountValue::Number(_), CountValue::Number(_)) => consts.get(end.text()).or_else(|| consts.get(start.text())),
    };
    let message = format!("expected a range such as `0..4`, of at most {}", index::COUNT_MAX);
    group.diagnostics().push(count::wrong(node.span(), named, message));
    None
}

/// Returns the instance that `name[index][labels]` runs, and the labels. The first brackets hold an index if they hold
/// a number, or if `name` is the name of an array. In a pool, an array needs no index, because the place is the
/// default.
pub(super) fn run_of(node: &Node, name: Name, group: &mut Group<'_>) -> Option<(Name, Vec<Name>)> {
    let brackets: Vec<Node> = node.children_of(Labels).collect();
    let is_array = group.names.arrays.contains_key(&name.text);
    let is_number = brackets.first().is_some_and(|first| first.token(Number).is_some());
    match brackets.split_first() {
        None | Some(_) if is_array && group.pool.is_some() && !is_number && !is_index(&brackets, group) => {
            let (place, count) = (group.pool.unwrap_or(0), group.names.arrays[&name.text]);
            if place >= count {
                let message =
                    format!("more copies may run at the same time than the {count} instances of `{}`", name.text);
                let help = format!("declare more instances, or write `::[{count}]`");
                group.diagnostics().push(Diagnostic::new(Code::E0203, name.span, message).help(help));
                return None;
            }
            let labels = brackets.iter().flat_map(|labels| labels.names().collect::<Vec<_>>()).collect();
            Some((Name { text: index::element(&name.text, place), span: name.span }, labels))
        }
        Some((first, rest)) if is_array || is_number => {
            let name = index::written_out(&name, first, &mut group.names, &group.indices)?;
            Some((name, rest.iter().flat_map(|labels| labels.names().collect::<Vec<_>>()).collect()))
        }
        None if is_array => {
            let diagnostic = index::without_index(&name, group.names.arrays[&name.text]);
            group.diagnostics().push(diagnostic);
            None
        }
        Some(_) if group.names.find(&name.text).is_none() && index::is_misspelt(&name, &mut group.names) => None,
        Some(_) | None => {
            let labels = brackets.iter().flat_map(|labels| labels.names().collect::<Vec<_>>()).collect();
            Some((name, labels))
        }
    }
}

/// Returns whether the first brackets hold a bound index variable.
fn is_index(brackets: &[Node], group: &Group<'_>) -> bool {
    let names = brackets.first().map(|first| first.names().collect::<Vec<_>>()).unwrap_or_default();
    names.len() == 1 && group.indices.iter().any(|(known, _)| *known == names[0].text)
}
