//! Finds the states that are entered, by rules 41, 42 and 60 to 64.

use super::chart::{StateKind, Target, Transition};
use super::configuration::Configuration;
use super::shape::Automaton;
use std::collections::BTreeSet;

/// Returns the states that a transition leads to. The memories of histories and of `resume` take their places.
pub(super) fn effective_targets(
    automaton: &Automaton,
    configuration: &Configuration,
    transition: &Transition,
) -> Vec<usize> {
    match &transition.target {
        Target::Stay | Target::Done(_) | Target::Abort(_) => Vec::new(),
        Target::States(targets) => resolved(automaton, configuration, targets),
        Target::Resume => {
            let memory = &configuration.memories[transition.source];
            match automaton.parent(transition.source).map(|parent| automaton.kind(parent)) {
                Some(StateKind::Compound { initial }) if memory.is_empty() => {
                    resolved(automaton, configuration, initial)
                }
                _ => memory.clone(),
            }
        }
    }
}

fn resolved(automaton: &Automaton, configuration: &Configuration, targets: &[usize]) -> Vec<usize> {
    let mut states = Vec::new();
    for &target in targets {
        match automaton.kind(target) {
            StateKind::History { default, .. } => {
                let memory = &configuration.memories[target];
                states.extend(if memory.is_empty() { default } else { memory });
            }
            StateKind::Atomic
            | StateKind::Compound { .. }
            | StateKind::Parallel
            | StateKind::Final
            | StateKind::Suspended => states.push(target),
        }
    }
    states
}

/// Returns the states inside `domain` that are entered on the way to `targets`.
pub(super) fn entry_set(
    automaton: &Automaton,
    configuration: &Configuration,
    domain: usize,
    targets: &[usize],
) -> BTreeSet<usize> {
    let mut entered = BTreeSet::new();
    add(automaton, &mut entered, domain, targets);
    // Each addition is inside the current state, so it comes later in document order.
    let mut next = Some(domain);
    while let Some(state) = next {
        let is_missing = |entered: &BTreeSet<usize>, state: usize| {
            let mut all = entered.range(state..automaton.inside(state).end);
            all.next().is_none()
        };
        match automaton.kind(state) {
            StateKind::Compound { initial } => {
                if entered.range(automaton.inside(state)).next().is_none() {
                    add(automaton, &mut entered, state, &resolved(automaton, configuration, initial));
                }
            }
            StateKind::Parallel => {
                for region in automaton.children(state) {
                    if is_missing(&entered, region) {
                        entered.insert(region);
                    }
                }
            }
            StateKind::Atomic | StateKind::Final | StateKind::Suspended | StateKind::History { .. } => {}
        }
        next = entered.range(state + 1..).next().copied();
    }
    entered
}

/// Adds the targets, and all states between them and the state `around`.
fn add(automaton: &Automaton, entered: &mut BTreeSet<usize>, around: usize, targets: &[usize]) {
    for &target in targets {
        entered.extend(automaton.upward(target).take_while(|&state| state != around));
    }
}
