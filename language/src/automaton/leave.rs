//! The memories of histories and suspended states, by rules 59, 62 and 63.

use super::chart::{History, StateKind};
use super::configuration::Configuration;
use super::shape::Automaton;
use std::collections::BTreeSet;

/// Stores in each history whose parent is left which states are active.
pub(super) fn remember(automaton: &Automaton, configuration: &mut Configuration, exits: &BTreeSet<usize>) {
    for history in 0..configuration.active.len() {
        let (StateKind::History { depth, .. }, Some(parent)) = (automaton.kind(history), automaton.parent(history))
        else {
            continue;
        };
        if !exits.contains(&parent) {
            continue;
        }
        configuration.memories[history] = match depth {
            History::Shallow => automaton.children(parent).filter(|&child| configuration.active[child]).collect(),
            History::Deep => {
                let inside = automaton.inside(parent);
                configuration.leaves(automaton).filter(|leaf| inside.contains(leaf)).collect()
            }
        };
    }
}

/// Stores in each suspended state that will be entered which atomic states inside its parent are left.
pub(super) fn suspend(
    automaton: &Automaton,
    configuration: &mut Configuration,
    leaves: &[usize],
    entered: &BTreeSet<usize>,
) {
    let mut notes = Vec::new();
    for &suspended in entered.iter().filter(|&&state| *automaton.kind(state) == StateKind::Suspended) {
        let parent = automaton.parent(suspended).unwrap_or(0);
        let mut memory: Vec<usize> =
            leaves.iter().copied().filter(|leaf| automaton.inside(parent).contains(leaf)).collect();
        if let [only] = memory[..]
            && *automaton.kind(only) == StateKind::Suspended
            && automaton.parent(only) == Some(parent)
        {
            memory = configuration.memories[only].clone();
        }
        if !memory.is_empty() {
            notes.push((suspended, memory));
        }
    }
    notes.into_iter().for_each(|(suspended, memory)| configuration.memories[suspended] = memory);
}
