//! Texts of aborts that activities wait for: something that runs there has to fail with the text.

use crate::automaton::{Failure, Target as Leads, Trigger};
use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{Expr, ExprKind, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::DEADLINE;
use std::collections::BTreeSet;

/// Reports transitions `on aborted("TEXT")` whose text no `fail` and no `abort` has in what runs there.
pub(super) fn check(spec: &Spec, process: &Process, diagnostics: &mut Diagnostics) {
    let Some(ExprKind::Chart(model)) = process.actions.as_ref().map(|actions| &actions.kind) else { return };
    for (transition, &span) in model.chart.chart.transitions.iter().zip(&model.places) {
        let Trigger::Aborted(Some(Failure::Failed(text))) = &transition.trigger else { continue };
        let mut reasons = Reasons { spec, known: BTreeSet::new(), texts: BTreeSet::new() };
        let runs = model
            .runs
            .iter()
            .filter(|(state, _)| model.chart.chart.upward(*state).any(|around| around == transition.source));
        runs.for_each(|(_, run)| reasons.of(process, run));
        if reasons.texts.contains(text.as_str()) || text.starts_with(DEADLINE) {
            continue;
        }
        let message = format!("this transition is never taken: nothing that runs here fails with \"{text}\"");
        let texts: Vec<&str> = reasons.texts.into_iter().collect();
        let help = match texts.as_slice() {
            [] => "write `on aborted`, or give a `fail` or an `abort` inside this text".to_owned(),
            texts => format!("the texts of failures here are {}", listed(texts.iter().copied())),
        };
        diagnostics.push(Diagnostic::new(Code::W0905, span, message).help(help));
    }
}

/// The texts with which something may fail.
struct Reasons<'s> {
    spec: &'s Spec,
    /// The processes that were looked at.
    known: BTreeSet<usize>,
    texts: BTreeSet<&'s str>,
}

impl<'s> Reasons<'s> {
    /// Adds the texts of an expression of a group.
    fn of(&mut self, process: &'s Process, expr: &'s Expr) {
        if let ExprKind::Fail(text) = &expr.kind {
            self.texts.insert(text);
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
