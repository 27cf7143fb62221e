//! Checks a formula in a recorded run. A run can only decide formulas that are violated at some position.

use super::automaton::{Automaton, Parts};
use super::{Letters, process};
use crate::property::watch::Seats;
use crate::system::{Change, Frame, System};
use language::sites::{Formula, ProcessRef};
use std::collections::BTreeSet;

/// The parts of a formula, joined by `&`, that a run can violate.
#[derive(Debug, Default)]
pub(in crate::property) struct Breaks {
    parts: Vec<(Parts, Automaton)>,
    /// Whether some part promises an event, or is too large. A run does not decide such a part.
    pub(in crate::property) is_partial: bool,
}

/// The state of these parts while a run is followed.
pub(in crate::property) struct Followed<'b> {
    parts: Vec<(Letters<'b>, &'b Automaton, BTreeSet<u16>)>,
    /// Whether the next position is the first one.
    is_first: bool,
}

impl Breaks {
    /// Takes a formula apart.
    pub(in crate::property) fn of(formula: &Formula) -> Self {
        let (mut breaks, mut open) = (Self::default(), vec![formula]);
        while let Some(part) = open.pop() {
            if let Formula::And(p, q) = part {
                open.extend([&**q, &**p]);
                continue;
            }
            let mut parts = Parts::default();
            let (holds, fails) = parts.add(part);
            let automaton = Automaton::of(&parts, fails).filter(|_| parts.is_safe(holds));
            breaks.is_partial |= automaton.is_none();
            breaks.parts.extend(automaton.map(|automaton| (parts, automaton)));
        }
        breaks
    }

    /// The processes named in the formulas that a run can violate.
    pub(in crate::property) fn processes(&self) -> Vec<ProcessRef> {
        self.parts.iter().flat_map(|(parts, _)| parts.atoms.iter().map(process)).collect()
    }

    /// Prepares to check these parts in a run of a system.
    pub(in crate::property) fn follow(&self, system: &System<'_>) -> Followed<'_> {
        let follow = |(parts, automaton): &'_ (Parts, Automaton)| {
            let seats = Seats::new(system, &parts.atoms.iter().map(process).collect::<Vec<_>>());
            (seats, automaton.first.iter().copied().collect())
        };
        let parts = self.parts.iter().map(|part| {
            let (seats, first) = follow(part);
            (Letters { atoms: &part.0.atoms, seats }, &part.1, first)
        });
        Followed { parts: parts.collect(), is_first: true }
    }
}

impl Followed<'_> {
    /// Notes that the group is started, possibly again: a new run begins.
    pub(in crate::property) fn begins(&mut self) {
        for (_, automaton, states) in &mut self.parts {
            *states = automaton.first.iter().copied().collect();
        }
        self.is_first = true;
    }

    /// Takes the next position. Returns false if a part is violated there.
    pub(in crate::property) fn sees(&mut self, system: &System<'_>, changes: &[Change], frame: &Frame) -> bool {
        let is_first = std::mem::take(&mut self.is_first);
        self.parts.iter_mut().all(|(letters, automaton, states)| {
            let letter = letters.at(system, changes, frame);
            let state = |state: u16| &automaton.states[usize::from(state)];
            let open: BTreeSet<u16> = match is_first {
                true => states.clone(),
                false => states.iter().flat_map(|from| state(*from).next.iter().copied()).collect(),
            };
            *states = open.into_iter().filter(|to| state(*to).fits(letter)).collect();
            !states.iter().any(|at| state(*at).is_free)
        })
    }
}
