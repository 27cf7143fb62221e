//! Finds the place in the text of each node of a lowered expression. The nodes have the same order
//! as in `expression::lower`.

use super::expression::{CHAIN_MAX, wait_first};
use crate::check::spec::{Expr, ExprKind};
use crate::source::Span;

/// A node with its place.
struct Placed {
    span: Span,
    parts: Vec<Self>,
}

/// Returns the places of the nodes of a lowered expression. Each node comes before its operands.
pub(crate) fn places(expr: &Expr) -> Vec<Span> {
    let mut all = Vec::new();
    flatten(&placed(expr), &mut all);
    all
}

fn flatten(node: &Placed, all: &mut Vec<Span>) {
    all.push(node.span);
    node.parts.iter().for_each(|part| flatten(part, all));
}

fn placed(expr: &Expr) -> Placed {
    let span = expr.span;
    let node = |parts| Placed { span, parts };
    let parts = || expr.parts().into_iter().map(placed).collect::<Vec<_>>();
    let leaf = || node(Vec::new());
    match &expr.kind {
        ExprKind::Sequence(_) | ExprKind::Conditional(_) | ExprKind::Otherwise(_) => balance(parts(), span),
        ExprKind::Retry(times, pause, part) => {
            let tries = (0..=*times).map(|number| match wait_first(*pause, number) {
                Some(_) => node(vec![leaf(), placed(part)]),
                None => placed(part),
            });
            balance(tries.collect(), span)
        }
        ExprKind::Within(_, part) => node(vec![placed(part), node(vec![leaf(), leaf()])]),
        ExprKind::Run(..)
        | ExprKind::Skip
        | ExprKind::Never
        | ExprKind::Fail(_)
        | ExprKind::Wait(_)
        | ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Disable(_)
        | ExprKind::Recurrent(..)
        | ExprKind::Repeat(..)
        | ExprKind::Catch(..)
        | ExprKind::Match(_)
        | ExprKind::Shield(..)
        | ExprKind::Using(..)
        | ExprKind::Asynchronous(..)
        | ExprKind::Finally(..)
        | ExprKind::Tagged(..)
        | ExprKind::With(..)
        | ExprKind::Named(..)
        | ExprKind::Chart(_)
        | ExprKind::Broken => node(parts()),
    }
}

fn balance(mut parts: Vec<Placed>, span: Span) -> Placed {
    if parts.len() < 2 {
        return parts.pop().unwrap_or(Placed { span, parts: Vec::new() });
    }
    let half = if parts.len() <= CHAIN_MAX { 1 } else { parts.len() / 2 };
    let right = parts.split_off(half);
    Placed { span, parts: vec![balance(parts, span), balance(right, span)] }
}
