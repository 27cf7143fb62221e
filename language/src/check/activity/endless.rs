//! Finds failures that are tried again for ever: a cycle of states without a change of any variable that a condition uses.

use super::ActivityReader;
use crate::automaton::{Action, Formula, StateKind, Target, Transition, Trigger};
use crate::diagnostic::{Code, Diagnostic};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The largest number of states that are named in one remark.
const NAMES_MAX: usize = 8;

impl ActivityReader<'_, '_> {
    /// Reports each transition of an abort after which the activity can return to the same state without any outside
    /// event. On this way, no variable changes that a condition uses.
    pub(super) fn endless(&self) -> Vec<Diagnostic> {
        let looked_at = self.looked_at();
        let mut found = Vec::new();
        for (number, transition) in self.chart.transitions.iter().enumerate() {
            let is_abort = matches!(transition.trigger, Trigger::Aborted(_));
            if !is_abort || self.counts(transition, &looked_at) {
                continue;
            }
            let Some(way) = self.way_back(transition, &looked_at) else { continue };
            let named = |state: &usize| self.chart.states[*state].name.as_str();
            let names: Vec<&str> = way.iter().take(NAMES_MAX).map(named).collect();
            let more = if way.len() > NAMES_MAX { " -> ..." } else { "" };
            let message = format!("failures are tried again for ever: {}{more}", names.join(" -> "));
            let diagnostic = Diagnostic::new(Code::W0907, self.places[number].span, message);
            let diagnostic = diagnostic.label("no condition on this path reads a variable that changes on the path");
            found.push(diagnostic.help("count the tries on this path, or add a pause to it: `on after 5 s -> STATE;`"));
        }
        found
    }

    /// Returns the variables that conditions use.
    fn looked_at(&self) -> BTreeSet<usize> {
        let mut all = BTreeSet::new();
        let guards = self.chart.transitions.iter().filter_map(|transition| transition.guard.as_ref());
        guards.for_each(|guard| variables(guard, &mut all));
        all
    }

    /// Returns whether a transition changes a variable that conditions use. Entry and exit actions are included.
    fn counts(&self, transition: &Transition, looked_at: &BTreeSet<usize>) -> bool {
        let changes =
            |action: &Action| matches!(action, Action::Assign { variable, .. } if looked_at.contains(variable));
        let entered = self.entered(&transition.target);
        let border = entered.iter().flat_map(|&state| &self.chart.states[state].entry);
        let exit = &self.chart.states[transition.source].exit;
        transition.actions.iter().chain(border).chain(exit).any(changes)
    }

    /// Returns the states on the way from a transition back to its source.
    fn way_back(&self, transition: &Transition, looked_at: &BTreeSet<usize>) -> Option<Vec<usize>> {
        let mut before: BTreeMap<usize, usize> = BTreeMap::new();
        let mut waiting: VecDeque<usize> = VecDeque::new();
        let mut visit = |target: &Target, from: usize, waiting: &mut VecDeque<usize>| {
            for state in self.entered(target) {
                if let std::collections::btree_map::Entry::Vacant(place) = before.entry(state) {
                    place.insert(from);
                    waiting.push_back(state);
                }
            }
        };
        visit(&transition.target, transition.source, &mut waiting);
        let mut is_back = false;
        while let Some(state) = waiting.pop_front() {
            if state == transition.source {
                is_back = true;
                break;
            }
            let own = self.chart.transitions.iter().filter(|next| next.source == state);
            for next in own.filter(|next| goes_on(&next.trigger) && !self.counts(next, looked_at)) {
                visit(&next.target, state, &mut waiting);
            }
        }
        if !is_back {
            return None;
        }
        let mut way = vec![transition.source];
        let mut at = transition.source;
        while let Some(&earlier) = before.get(&at).filter(|_| way.len() <= self.chart.states.len()) {
            way.push(earlier);
            if earlier == transition.source {
                break;
            }
            at = earlier;
        }
        way.reverse();
        Some(way)
    }

    /// Returns the states that a target enters, together with their initial states.
    fn entered(&self, target: &Target) -> BTreeSet<usize> {
        let Target::States(targets) = target else { return BTreeSet::new() };
        let states = &self.chart.states;
        let mut entered = BTreeSet::new();
        let mut waiting: Vec<usize> = targets.clone();
        while let Some(state) = waiting.pop() {
            if !entered.insert(state) {
                continue;
            }
            match &states[state].kind {
                StateKind::Compound { initial } => waiting.extend(initial),
                StateKind::History { default, .. } => waiting.extend(default),
                StateKind::Parallel => {
                    waiting.extend((0..states.len()).filter(|&inner| states[inner].parent == Some(state)));
                }
                StateKind::Atomic | StateKind::Final | StateKind::Suspended => {}
            }
        }
        entered
    }
}

/// Returns whether a trigger needs no outside event, only ends of the activity's own runs.
fn goes_on(trigger: &Trigger) -> bool {
    matches!(trigger, Trigger::Done(_) | Trigger::Aborted(_) | Trigger::Complete | Trigger::Always)
}

fn variables(formula: &Formula, all: &mut BTreeSet<usize>) {
    match formula {
        Formula::Variable(variable) => drop(all.insert(*variable)),
        Formula::Number(_) | Formula::In(_) => {}
        Formula::Not(a) => variables(a, all),
        Formula::And(a, b)
        | Formula::Or(a, b)
        | Formula::Compare(_, a, b)
        | Formula::Add(a, b)
        | Formula::Subtract(a, b)
        | Formula::Multiply(a, b) => {
            variables(a, all);
            variables(b, all);
        }
    }
}
