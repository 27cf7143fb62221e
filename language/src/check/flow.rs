//! What runs with what, what ends, and what never does.

mod outcome;
mod resource;
mod service;

use super::spec::{Expr, ExprKind, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use std::collections::BTreeMap;

/// Infers services, then checks every event action. Groups nest finitely here.
pub(super) fn check(spec: &mut Spec, diagnostics: &mut Vec<Diagnostic>) {
    service::infer(spec);
    for process in spec.processes.iter().filter(|process| !process.damage.actions) {
        let Some(actions) = &process.actions else { continue };
        let mut clashes = BTreeMap::new();
        instances_of(actions, &mut clashes);
        diagnostics.extend(clashes.into_iter().map(|(slot, places)| runs_twice(process, slot, places)));
        check_loops(actions, diagnostics);
        service::check(spec, process, actions, diagnostics);
        resource::check(process, actions, diagnostics);
    }
    outcome::check(spec, diagnostics);
}

/// Returns the instances that an expression runs, each with one place; collects those that run twice at once, each with
/// two places.
fn instances_of(expr: &Expr, clashes: &mut BTreeMap<usize, (Span, Span)>) -> BTreeMap<usize, Span> {
    if let ExprKind::Run(slot, _) = &expr.kind {
        return BTreeMap::from([(*slot, expr.span)]);
    }
    let mut all: BTreeMap<usize, Span> = BTreeMap::new();
    for part in expr.parts() {
        for (slot, span) in instances_of(part, clashes) {
            let first = *all.entry(slot).or_insert(span);
            if expr.is_parallel() && first != span {
                clashes.entry(slot).or_insert((first, span));
            }
        }
    }
    all
}

fn runs_twice(process: &Process, slot: usize, (first, second): (Span, Span)) -> Diagnostic {
    let name = &process.instances[slot].name;
    let message = format!("`{}` can run twice at the same time", name.text);
    let diagnostic = Diagnostic::new(Code::E0401, second, message).reason(first, "runs here too");
    diagnostic.reason(name.span, "this is one instance").help("declare a second instance, or run it once")
}

/// How an expression can end without running or waiting for anything.
#[derive(Clone, Copy)]
struct AtOnce {
    done: bool,
    aborted: bool,
}

/// Reports loops that could turn without end at one instant.
fn check_loops(expr: &Expr, diagnostics: &mut Vec<Diagnostic>) {
    let is_endless = if let ExprKind::Recurrent(first, second) = &expr.kind {
        at_once(first).done && at_once(second).done
    } else if let ExprKind::Asynchronous(source, pool) = &expr.kind {
        at_once(source).done && pool.iter().any(|part| at_once(part).done)
    } else {
        false
    };
    if is_endless {
        let diagnostic =
            Diagnostic::new(Code::E0410, expr.span, "the repeated expression ends at the instant it starts");
        diagnostics.push(diagnostic.help("put a process or a `wait` on each way through it"));
    }
    for part in expr.parts() {
        check_loops(part, diagnostics);
    }
}

fn at_once(expr: &Expr) -> AtOnce {
    let parts: Vec<AtOnce> = expr.parts().into_iter().map(at_once).collect();
    let done = |parts: &[AtOnce]| parts.iter().filter(|part| part.done).count();
    let any_aborted = parts.iter().any(|part| part.aborted);
    match &expr.kind {
        ExprKind::Run(..) | ExprKind::Never | ExprKind::Wait(_) | ExprKind::Broken => {
            AtOnce { done: false, aborted: false }
        }
        ExprKind::Skip => AtOnce { done: true, aborted: false },
        ExprKind::Fail(_) => AtOnce { done: false, aborted: true },
        ExprKind::Concurrent(_) | ExprKind::FailFast(_) => {
            AtOnce { done: done(&parts) == parts.len(), aborted: any_aborted }
        }
        ExprKind::AnyOf(count, _) => AtOnce { done: done(&parts) >= *count as usize, aborted: any_aborted },
        ExprKind::Disable(_) | ExprKind::Within(..) => AtOnce { done: done(&parts) > 0, aborted: any_aborted },
        ExprKind::Sequence(_) | ExprKind::Conditional(_) => {
            let reached = parts.iter().take_while(|part| part.done).count();
            let aborted = parts.iter().take(reached + 1).any(|part| part.aborted);
            AtOnce { done: reached == parts.len(), aborted }
        }
        ExprKind::Otherwise(_) | ExprKind::Retry(..) => {
            let failed = parts.iter().take_while(|part| part.aborted && !part.done).count();
            AtOnce { done: parts.iter().take(failed + 1).any(|part| part.done), aborted: failed == parts.len() }
        }
        ExprKind::Recurrent(..) | ExprKind::Asynchronous(..) => AtOnce { done: false, aborted: any_aborted },
        ExprKind::Match(_) | ExprKind::Shield(..) | ExprKind::Using(..) => {
            AtOnce { done: done(&parts) > 0, aborted: any_aborted }
        }
    }
}

/// The group that an expression runs, when it is just that.
fn group_of<'a>(spec: &'a Spec, process: &Process, expr: &Expr) -> Option<&'a Process> {
    let ExprKind::Run(slot, _) = &expr.kind else { return None };
    match process.instances[*slot].target {
        Target::Process(target) => Some(&spec.processes[target]),
        Target::Module(_) | Target::Unknown => None,
    }
}
