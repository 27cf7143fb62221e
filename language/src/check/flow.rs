//! Checks event actions: members that run at the same time, members that end, and members that never start.

mod dead;
mod ends;
mod instant;
mod notice;
mod outcome;
mod reason;
mod resource;
mod service;
mod value;

use super::diagnostics::Diagnostics;
use super::spec::{Expr, ExprKind, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use std::collections::BTreeMap;

/// Infers services, then checks every event action. At this point, no group contains itself.
pub(super) fn check(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    service::infer(spec);
    let members = ends::members(spec);
    for (process, members) in spec.processes.iter().zip(&members).filter(|(process, _)| !process.damage.actions) {
        let Some(actions) = &process.actions else { continue };
        let mut clashes = BTreeMap::new();
        instances_of(actions, &mut clashes);
        diagnostics.extend(clashes.into_iter().map(|(slot, (first, second))| runs_twice(process, slot, first, second)));
        service::Order::new(spec, process, members, diagnostics).walk(actions);
        dead::check(members, actions, diagnostics);
        value::check(spec, process, actions, diagnostics);
        resource::check(process, actions, diagnostics);
        notice::check(spec, process, diagnostics);
        reason::check(spec, process, diagnostics);
        resource::kept(process, &service::members(spec, process), actions, diagnostics);
    }
    instant::check(spec, diagnostics);
    outcome::check(spec, diagnostics);
}

/// Returns the instances that an expression runs, each with one place. Collects the instances that run twice at the
/// same time, each with
/// two places.
fn instances_of(expr: &Expr, clashes: &mut BTreeMap<usize, (Span, Span)>) -> BTreeMap<usize, Span> {
    if let ExprKind::Run(slot, _) = &expr.kind {
        return BTreeMap::from([(*slot, expr.span)]);
    }
    let is_activity = matches!(expr.kind, ExprKind::Chart(_));
    let may_clash = is_activity || expr.is_parallel();
    let mut all: BTreeMap<usize, Vec<(usize, Span)>> = BTreeMap::new();
    for (index, part) in expr.parts().into_iter().enumerate() {
        for (slot, span) in instances_of(part, clashes) {
            let known = all.entry(slot).or_default();
            let clashes_with = |(other, first): &&(usize, Span)| *first != span && expr.runs_together(*other, index);
            let clash = known.iter().filter(|_| may_clash).find(clashes_with);
            if let Some((_, first)) = clash {
                clashes.entry(slot).or_insert((*first, span));
            }
            // Only in an activity do some parts run together and other parts not.
            if known.is_empty() || is_activity {
                known.push((index, span));
            }
        }
    }
    all.into_iter().filter_map(|(slot, places)| Some((slot, places.first()?.1))).collect()
}

fn runs_twice(process: &Process, slot: usize, first: Span, second: Span) -> Diagnostic {
    let name = &process.instances[slot].name;
    let message = format!("`{}` can run twice at the same time", name.text);
    let diagnostic = Diagnostic::new(Code::E0401, second, message).reason(first, "runs here too");
    diagnostic.reason(name.span, "this is one instance").help("declare a second instance, or run it once")
}

/// Returns the group that an expression runs, if the expression does nothing else. A `using` around it is skipped.
fn group_of<'a>(spec: &'a Spec, process: &Process, expr: &Expr) -> Option<&'a Process> {
    let inner = if let ExprKind::Using(_, inner) = &expr.kind { inner } else { expr };
    let ExprKind::Run(slot, _) = &inner.kind else { return None };
    match process.instances[*slot].target {
        Target::Process(target) => Some(&spec.processes[target]),
        Target::Module(_) | Target::Unknown => None,
    }
}
