//! Compares the declared types of opaque variables with the values that they keep, and with the programs that start with
//! them. Without a declared type, an opaque variable may keep any value.

use super::result::outcome_kind;
use super::start::{declared, takers};
use crate::automaton::{Action, Trigger, ValueSource};
use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{ChartModel, Kind, Process, Spec};
use crate::diagnostic::{Code, Diagnostic};

/// Compares the types of all opaque variables. At this point, no group contains itself.
pub(in crate::check) fn check(spec: &Spec, diagnostics: &mut Diagnostics) {
    for process in spec.processes.iter().filter(|process| !process.damage.actions) {
        if let Some(model) = process.chart().filter(|model| !model.kinds.is_empty()) {
            let mut check = KeptCheck { spec, process, model, diagnostics };
            check.transitions();
            check.runs();
        }
    }
}

/// Returns the declared type of the value of an event for a transition that leaves this state.
pub(in crate::check) fn event_kind<'a>(
    spec: &'a Spec,
    process: &'a Process,
    trigger: &Trigger,
    state: usize,
) -> Option<&'a Kind> {
    let model = process.chart()?;
    match trigger {
        // The inputs are before the outputs.
        Trigger::Message { port, .. } => model.ports.get(*port)?.kind.as_ref(),
        Trigger::Done(tag) => {
            let (_, run) = model.runs.iter().find(|(of, _)| *of == state)?;
            outcome_kind(spec, process, run, tag.as_deref()?)
        }
        Trigger::Always
        | Trigger::Any
        | Trigger::Signal(_)
        | Trigger::Notice(_)
        | Trigger::Aborted(_)
        | Trigger::Complete
        | Trigger::After(_)
        | Trigger::Every(_) => None,
    }
}

struct KeptCheck<'a, 'd> {
    spec: &'a Spec,
    process: &'a Process,
    model: &'a ChartModel,
    diagnostics: &'d mut Diagnostics,
}

impl KeptCheck<'_, '_> {
    /// Compares the variables with the values of events.
    fn transitions(&mut self) {
        let transitions = &self.model.chart.chart.transitions;
        for (transition, span) in transitions.iter().zip(&self.model.places) {
            for action in &transition.actions {
                let Action::Keep { slot, value: ValueSource::Event } = action else { continue };
                let given = event_kind(self.spec, self.process, &transition.trigger, transition.source);
                let Some((given, kind)) = given.zip(self.model.kinds.get(slot)) else { continue };
                if !self.spec.is_same(given, kind) {
                    let message = format!("a variable of type `{kind}` cannot keep the `{given}` of this event");
                    let found = Diagnostic::new(Code::E0910, *span, message);
                    self.diagnostics.push(found.reason(kind.span, "declared here"));
                }
            }
        }
    }

    /// Compares the variables with the programs that start with them.
    fn runs(&mut self) {
        for (state, run) in &self.model.runs {
            let Some(ValueSource::Slot(slot)) = self.model.chart.chart.states[*state].run else { continue };
            let Some(kind) = self.model.kinds.get(&slot) else { continue };
            for (module, start) in declared(&takers(self.spec, self.process, run)) {
                let Some(wanted) = start.kind.as_ref().filter(|wanted| !self.spec.is_same(kind, wanted)) else {
                    continue;
                };
                let message =
                    format!("this run begins with a {kind}, and `{}` starts with a {wanted}", module.name.text);
                let found = Diagnostic::new(Code::E0213, run.span, message).reason(kind.span, "declared here");
                self.diagnostics.push(found.reason(start.name.span, "this program takes it"));
            }
        }
    }
}
