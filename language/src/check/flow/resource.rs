//! `using`: what waits for itself, and what may wait for each other.

use crate::check::spec::{Expr, ExprKind, Path, Process, are_parallel};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;

/// Of so many nested `using`s each is compared with each.
const NESTED_MAX: usize = 200;

/// A `using` inside another one.
struct Nested {
    holds: usize,
    wants: usize,
    span: Span,
    path: Path,
}

/// Reports a `using` that can never start, and pairs of them that take the same things in different orders.
pub(super) fn check(process: &Process, actions: &Expr, diagnostics: &mut Vec<Diagnostic>) {
    let mut nested = Vec::new();
    collect(process, actions, (&mut Vec::new(), &mut Vec::new()), (&mut nested, diagnostics));
    if nested.len() > NESTED_MAX {
        return;
    }
    for (index, one) in nested.iter().enumerate() {
        let is_crossed = |other: &&Nested| {
            let crosses = one.holds == other.wants && one.wants == other.holds;
            crosses && are_parallel(&one.path, &other.path) == Some(true)
        };
        let Some(other) = nested[index + 1..].iter().find(is_crossed) else { continue };
        let name = |index: usize| &process.resources[index].text;
        let (holds, wants) = (name(other.holds), name(other.wants));
        let message = format!("`{holds}` and `{wants}` are taken in both orders: each may wait for the other for ever");
        let diagnostic = Diagnostic::new(Code::W0413, other.span, message);
        let diagnostic = diagnostic.label(format!("waits for `{wants}` and has `{holds}`"));
        let diagnostic = diagnostic.reason(one.span, format!("waits for `{holds}` and has `{wants}`"));
        diagnostics.push(diagnostic.help(format!("take both at once: `using({wants}, {holds})`")));
    }
}

fn collect(
    process: &Process,
    expr: &Expr,
    (path, held): (&mut Path, &mut Vec<(usize, Span)>),
    (nested, diagnostics): (&mut Vec<Nested>, &mut Vec<Diagnostic>),
) {
    let before = held.len();
    if let ExprKind::Using(taken, _) = &expr.kind {
        for &wants in taken {
            if let Some((_, outer)) = held.iter().find(|(holds, _)| *holds == wants) {
                let name = &process.resources[wants].text;
                let message = format!("`{name}` is taken already by what waits for it here, so it never gets it");
                let diagnostic = Diagnostic::new(Code::E0413, expr.span, message);
                diagnostics.push(diagnostic.reason(*outer, "taken here").help("take it once"));
            }
            let edges = held.iter().filter(|(holds, _)| *holds != wants);
            nested.extend(edges.map(|&(holds, _)| Nested { holds, wants, span: expr.span, path: path.clone() }));
        }
        held.extend(taken.iter().map(|&taken| (taken, expr.span)));
    }
    for (index, part) in expr.parts().into_iter().enumerate() {
        path.push((index, expr.is_parallel()));
        collect(process, part, (path, held), (nested, diagnostics));
        path.pop();
    }
    held.truncate(before);
}
