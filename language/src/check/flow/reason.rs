//! Checks the reasons of failures that activities and `else match` name: a part that runs there must be able to fail for them.

use crate::automaton::{Failure, Target as Leads, Trigger};
use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{Expr, ExprKind, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::DEADLINE;
use std::collections::BTreeSet;

/// Reports transitions `on aborted("TEXT")` and arms `"TEXT" =>` if the text is in no `fail` and in no `abort` of the parts that run there.
pub(super) fn check(spec: &Spec, process: &Process, diagnostics: &mut Diagnostics) {
    let Some(actions) = &process.actions else { return };
    arms(spec, process, actions, diagnostics);
    let ExprKind::Chart(model) = &actions.kind else { return };
    for (transition, &span) in model.chart.chart.transitions.iter().zip(&model.places) {
        let Trigger::Aborted(Some(failure)) = &transition.trigger else { continue };
        let mut reasons = Reasons::new(spec);
        let runs = model
            .runs
            .iter()
            .filter(|(state, _)| model.chart.chart.upward(*state).any(|around| around == transition.source));
        runs.for_each(|(_, run)| reasons.of(process, run));
        let asked = Asked { failure, what: "this transition", all: "write `on aborted`" };
        diagnostics.extend(
            asked.report(reasons).map(|(message, help)| Diagnostic::new(Code::W0905, span, message).help(help)),
        );
    }
}

/// Checks the arms of each `else match`.
fn arms(spec: &Spec, process: &Process, expr: &Expr, diagnostics: &mut Diagnostics) {
    if let ExprKind::Catch(first, arms) = &expr.kind {
        for arm in arms {
            let Some(failure) = &arm.failure else { continue };
            let mut reasons = Reasons::new(spec);
            reasons.of(process, first);
            let asked = Asked { failure, what: "this arm", all: "write `else`" };
            let found = asked.report(reasons);
            diagnostics.extend(found.map(|(message, help)| {
                Diagnostic::new(Code::W0422, arm.span, message).reason(first.span, "fails for other reasons").help(help)
            }));
        }
    }
    expr.parts().into_iter().for_each(|part| arms(spec, process, part, diagnostics));
}

/// A failure that a transition or an arm asks for.
struct Asked<'s> {
    failure: &'s Failure,
    what: &'static str,
    /// The advice how to ask for every failure.
    all: &'static str,
}

impl Asked<'_> {
    /// Returns the message and the help, if no part can fail for this reason.
    fn report(&self, reasons: Reasons<'_>) -> Option<(String, String)> {
        let Self { what, all, .. } = self;
        if *self.failure == Failure::Timeout && !reasons.has_limit {
            let message = format!("{what} is never taken: no part that runs here has a limit");
            return Some((message, "add a limit: `process within 5 s`".to_owned()));
        }
        let Failure::Failed(text) = self.failure else { return None };
        if reasons.texts.contains(text.as_str()) {
            return None;
        }
        let message = format!("{what} is never taken: nothing that runs here fails with \"{text}\"");
        let texts: Vec<&str> = reasons.texts.into_iter().collect();
        let help = match texts.as_slice() {
            [] => format!(
                "{all}, or give a `fail` or an `abort` inside this text; the texts of a program's own reports are not compared"
            ),
            texts => format!("the texts of failures here are {}", listed(texts.iter().copied())),
        };
        Some((message, help))
    }
}

/// The reasons for which an expression may fail.
struct Reasons<'s> {
    spec: &'s Spec,
    /// The processes that were visited.
    known: BTreeSet<usize>,
    texts: BTreeSet<&'s str>,
    /// Whether the expression has a time limit.
    has_limit: bool,
}

impl<'s> Reasons<'s> {
    fn new(spec: &'s Spec) -> Self {
        Self { spec, known: BTreeSet::new(), texts: BTreeSet::new(), has_limit: false }
    }

    /// Adds the reasons of an expression in a group.
    fn of(&mut self, process: &'s Process, expr: &'s Expr) {
        if let ExprKind::Fail(text) = &expr.kind {
            self.texts.insert(text);
            self.has_limit |= text.starts_with(DEADLINE);
        } else if let ExprKind::Within(..) = &expr.kind {
            self.has_limit = true;
        } else if let ExprKind::Chart(model) = &expr.kind {
            let aborts = model.chart.chart.transitions.iter().filter_map(|transition| match &transition.target {
                Leads::Abort(text) => Some(text.as_str()),
                Leads::Stay | Leads::States(_) | Leads::Resume | Leads::Done(_) => None,
            });
            self.texts.extend(aborts);
        } else if let ExprKind::Run(slot, _) = &expr.kind
            && let Target::Process(inner) = process.instances[*slot].target
            && self.known.insert(inner)
        {
            let inner = &self.spec.processes[inner];
            inner.actions.iter().for_each(|actions| self.of(inner, actions));
        }
        expr.parts().into_iter().for_each(|part| self.of(process, part));
    }
}
