//! Remarks on an activity as a whole: transitions that are never taken, states that are never entered.

use super::ActivityReader;
use crate::automaton::{StateKind, Target, Transition, Trigger};
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::ast::Node;
use std::collections::BTreeSet;

impl ActivityReader<'_, '_> {
    /// Reports transitions that are never taken, and states that are never entered.
    pub(super) fn remarks(&mut self, root: &Node) {
        if !self.is_sound {
            return;
        }
        let mut found = self.hidden();
        found.extend(self.never_completed());
        found.extend(self.ticked_twice());
        for (name, is_raised) in &self.heard.signals {
            if !is_raised {
                let message = format!("no action raises the signal `{}`", name.text);
                found.push(Diagnostic::new(Code::W0905, name.span, message));
            }
        }
        found.extend(self.unreachable(root));
        found.extend(self.endless());
        self.group.diagnostics().extend(found);
    }

    /// Finds transitions that are never taken, because an earlier transition of the same state is always taken instead.
    fn hidden(&self) -> Vec<Diagnostic> {
        let mut found = Vec::new();
        for (number, transition) in self.chart.transitions.iter().enumerate() {
            let covers = |other: &Trigger| match (other, &transition.trigger) {
                (Trigger::Done(None), Trigger::Done(_)) | (Trigger::Aborted(None), Trigger::Aborted(_)) => true,
                (Trigger::Message { port, filter: None }, Trigger::Message { port: own, .. }) => port == own,
                (Trigger::Any, Trigger::Message { .. } | Trigger::Signal(_) | Trigger::Any) => true,
                (Trigger::After(_) | Trigger::Every(_), _) => false,
                (other, own) => other == own,
            };
            let earlier = self.chart.transitions[..number]
                .iter()
                .position(|other| other.source == transition.source && other.guard.is_none() && covers(&other.trigger));
            if let Some(earlier) = earlier {
                let message = "this transition is never taken, because an earlier transition is always taken instead";
                let diagnostic = Diagnostic::new(Code::W0905, self.places[number].span, message);
                found.push(diagnostic.reason(self.places[earlier].span, "taken instead"));
            }
        }
        found
    }

    /// Finds transitions that wait for the completion of the activity. It has ended then.
    fn never_completed(&self) -> Vec<Diagnostic> {
        let transitions = self.chart.transitions.iter().zip(&self.places);
        let never =
            transitions.filter(|(transition, _)| transition.source == 0 && transition.trigger == Trigger::Complete);
        let message = "this transition is never taken, because the activity ends once its states are complete";
        never.map(|(_, place)| Diagnostic::new(Code::W0905, place.span, message)).collect()
    }

    /// Finds pairs of `every` with one time that look like a choice. The first one does not leave its state, so the second one is taken too.
    fn ticked_twice(&self) -> Vec<Diagnostic> {
        let mut found = Vec::new();
        for (number, transition) in self.chart.transitions.iter().enumerate() {
            let is_before = |earlier: &Transition| {
                let is_alike = earlier.source == transition.source && earlier.trigger == transition.trigger;
                is_alike && earlier.target == Target::Stay && transition.guard.is_none()
            };
            let Trigger::Every(_) = transition.trigger else { continue };
            let Some(earlier) = self.chart.transitions[..number].iter().position(is_before) else { continue };
            let message = "this transition is also taken at each tick at which the earlier one is taken";
            let diagnostic = Diagnostic::new(Code::W0908, self.places[number].span, message);
            let diagnostic = diagnostic.reason(self.places[earlier].span, "taken before it");
            found.push(diagnostic.help("write one transition, or give this one a condition"));
        }
        found
    }

    /// Finds states that no transition leads to.
    fn unreachable(&self, root: &Node) -> Vec<Diagnostic> {
        let states = &self.chart.states;
        let mut entered = BTreeSet::new();
        let mut waiting = vec![0];
        while let Some(state) = waiting.pop() {
            if !entered.insert(state) {
                continue;
            }
            waiting.extend(states[state].parent);
            match &states[state].kind {
                StateKind::Compound { initial } => waiting.extend(initial),
                StateKind::Parallel => {
                    let regions = (0..states.len()).filter(|&inner| states[inner].parent == Some(state));
                    waiting.extend(regions.filter(|&inner| !matches!(states[inner].kind, StateKind::History { .. })));
                }
                StateKind::History { default, .. } => waiting.extend(default),
                StateKind::Atomic | StateKind::Final | StateKind::Suspended => {}
            }
            for transition in self.chart.transitions.iter().filter(|transition| transition.source == state) {
                if let Target::States(targets) = &transition.target {
                    waiting.extend(targets);
                }
            }
        }
        let missing = (0..states.len()).filter(|state| !entered.contains(state));
        // If a state is never entered, its inner states get no remark of their own.
        let outermost = missing.filter(|&state| states[state].parent.is_none_or(|parent| entered.contains(&parent)));
        let remark = |state: usize| {
            let name = &states[state].name;
            let place = self.names.get(name).map_or(root.span(), |(_, name)| name.span);
            Diagnostic::new(Code::W0906, place, format!("the state `{name}` is never entered"))
        };
        outermost.map(remark).collect()
    }
}
