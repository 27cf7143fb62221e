//! Finds values that get lost: `look : match { found => skip, missing => ask } : grasp` starts `grasp` without the
//! value that `look` has found.

use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Expr, ExprKind, Outcome, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use std::collections::BTreeSet;

/// Reports each step that drops a value with which the next step would start.
pub(super) fn check(spec: &Spec, process: &Process, expr: &Expr, diagnostics: &mut Diagnostics) {
    let walk = Walk { spec, process };
    walk.visit(expr, diagnostics);
}

struct Walk<'a> {
    spec: &'a Spec,
    process: &'a Process,
}

impl<'a> Walk<'a> {
    fn visit(&self, expr: &Expr, diagnostics: &mut Diagnostics) {
        let mut chain = Vec::new();
        flatten(expr, &mut chain);
        for steps in chain.windows(3) {
            let (before, step, next) = (steps[0], steps[1], steps[2]);
            let place = dropped(step, &valued(self.spec, self.process, before)).filter(|_| starts(next));
            diagnostics.extend(place.map(|place| self.report(before, place, next)));
        }
        if chain.len() == 1 {
            return expr.parts().into_iter().for_each(|part| self.visit(part, diagnostics));
        }
        chain.into_iter().for_each(|step| self.visit(step, diagnostics));
    }

    fn report(&self, before: &Expr, place: Span, next: &Expr) -> Diagnostic {
        let name = |expr: &Expr| {
            if let ExprKind::Run(slot, _) = &expr.kind {
                return format!("`{}`", self.process.instances[*slot].name.text);
            }
            "the next step".to_owned()
        };
        let message = format!("this step drops the value of an earlier step: {} starts without this value", name(next));
        let found = Diagnostic::new(Code::W0424, place, message).label("leaves no value");
        let found = found.reason(before.span, "leaves a value").reason(next.span, "gets no value");
        found.help(
            "put the step that needs the value directly after the step that leaves it, as in `look : match { found => grasp, missing => ask }`",
        )
    }
}

/// Collects the steps of `a : b ;; c ::[n] d`. Each step starts with the value of the previous step.
fn flatten<'e>(expr: &'e Expr, chain: &mut Vec<&'e Expr>) {
    if let ExprKind::Conditional(parts) = &expr.kind {
        parts.iter().for_each(|part| flatten(part, chain));
    } else if let ExprKind::Recurrent(first, second) = &expr.kind {
        [first, second].into_iter().for_each(|part| flatten(part, chain));
    } else if let ExprKind::Asynchronous(source, pool) = &expr.kind {
        flatten(source, chain);
        // The places differ only in their instances, so one of them is enough.
        pool.iter().take(1).for_each(|part| flatten(part, chain));
    } else {
        chain.push(expr);
    }
}

/// Returns the outcomes with which an expression leaves a value. At this point, no group contains itself.
fn valued(spec: &Spec, process: &Process, expr: &Expr) -> BTreeSet<String> {
    let rest = |part: &Expr| valued(spec, process, part);
    let all = |parts: Vec<&Expr>| parts.into_iter().flat_map(rest).collect();
    match &expr.kind {
        ExprKind::Run(slot, _) => match process.instances[*slot].target {
            Target::Module(module) => with_value(&spec.modules[module].outcomes),
            Target::Process(inner) => {
                let inner = &spec.processes[inner];
                inner.actions.as_ref().map(|actions| valued(spec, inner, actions)).unwrap_or_default()
            }
            Target::Unknown => BTreeSet::new(),
        },
        ExprKind::Sequence(parts) | ExprKind::Conditional(parts) => parts.last().map(rest).unwrap_or_default(),
        ExprKind::Finally(first, _) => rest(first),
        ExprKind::Tagged(tag, part) if !rest(part).is_empty() => BTreeSet::from([tag.text.clone()]),
        ExprKind::Repeat(until, part) => {
            rest(part).into_iter().filter(|outcome| until.iter().any(|name| name.text == *outcome)).collect()
        }
        ExprKind::Disable(_)
        | ExprKind::Otherwise(_)
        | ExprKind::Catch(..)
        | ExprKind::AnyOf(1, _)
        | ExprKind::Match(_)
        | ExprKind::Retry(..)
        | ExprKind::Within(..)
        | ExprKind::Shield(..)
        | ExprKind::Using(..)
        | ExprKind::With(..)
        | ExprKind::Named(..) => all(expr.parts()),
        ExprKind::Chart(model) => with_value(&model.outcomes),
        ExprKind::Tagged(..)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Skip
        | ExprKind::Never
        | ExprKind::Fail(_)
        | ExprKind::Wait(_)
        | ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::Recurrent(..)
        | ExprKind::Asynchronous(..)
        | ExprKind::Broken => BTreeSet::new(),
    }
}

/// Returns the names of the outcomes that have a value.
fn with_value(outcomes: &[Outcome]) -> BTreeSet<String> {
    let valued = outcomes.iter().filter(|outcome| outcome.kind.is_some());
    valued.map(|outcome| outcome.name.text.clone()).collect()
}

/// Returns the part of a step that is started with one of these outcomes and drops its value.
fn dropped(step: &Expr, valued: &BTreeSet<String>) -> Option<Span> {
    if valued.is_empty() {
        return None;
    }
    match &step.kind {
        ExprKind::Skip | ExprKind::Wait(_) => Some(step.span),
        ExprKind::Match(arms) => arms.iter().find_map(|arm| {
            let named = || arms.iter().filter_map(|arm| arm.tag.as_ref()).map(|tag| &tag.text);
            let own: BTreeSet<String> = match &arm.tag {
                Some(tag) => valued.iter().filter(|outcome| **outcome == tag.text).cloned().collect(),
                None => valued.iter().filter(|outcome| named().all(|tag| tag != *outcome)).cloned().collect(),
            };
            dropped(&arm.body, &own)
        }),
        ExprKind::Within(_, part)
        | ExprKind::Shield(_, part)
        | ExprKind::Using(_, part)
        | ExprKind::Tagged(_, part) => dropped(part, valued),
        ExprKind::Run(..)
        | ExprKind::Chart(_)
        | ExprKind::With(..)
        | ExprKind::Named(..)
        | ExprKind::Never
        | ExprKind::Fail(_)
        | ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Disable(_)
        | ExprKind::Sequence(_)
        | ExprKind::Conditional(_)
        | ExprKind::Otherwise(_)
        | ExprKind::Recurrent(..)
        | ExprKind::Retry(..)
        | ExprKind::Repeat(..)
        | ExprKind::Catch(..)
        | ExprKind::Asynchronous(..)
        | ExprKind::Finally(..)
        | ExprKind::Broken => None,
    }
}

/// Returns whether an expression starts a process with its own start value.
fn starts(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Run(..) | ExprKind::Named(..) => true,
        ExprKind::Sequence(parts) | ExprKind::Otherwise(parts) => parts.first().is_some_and(starts),
        ExprKind::Catch(first, _) => starts(first),
        ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Disable(_)
        | ExprKind::Retry(..)
        | ExprKind::Repeat(..)
        | ExprKind::Within(..)
        | ExprKind::Shield(..)
        | ExprKind::Using(..)
        | ExprKind::Tagged(..) => expr.parts().into_iter().any(starts),
        ExprKind::Skip
        | ExprKind::Chart(_)
        // `with` gives the process another value.
        | ExprKind::With(..)
        | ExprKind::Never
        | ExprKind::Fail(_)
        | ExprKind::Wait(_)
        | ExprKind::Conditional(_)
        | ExprKind::Recurrent(..)
        | ExprKind::Match(_)
        | ExprKind::Asynchronous(..)
        | ExprKind::Finally(..)
        | ExprKind::Broken => false,
    }
}
