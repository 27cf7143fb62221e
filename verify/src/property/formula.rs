//! `holds ltl "..."`: checks a formula of linear temporal logic with an automaton for the runs on which the formula
//! does not hold.
//!
//! Some formulas can only be violated at some position, such as `G (a -> b)`. They are proved for every run, including
//! failures and stops, like `never`. A formula that promises something, such as `F b`, is proved for runs without
//! failures and stops, like `eventually`. Parts that are joined by `&` are proved one by one.

mod automaton;
mod run;
mod trace;

use super::watch::Seats;
use super::{Question, is_running};
use crate::explore::{Graph, Limits, Observer, explore};
use crate::finding::Finding;
use crate::story::tell_run;
use crate::system::{Change, Frame, Label, Mode, System};
use automaton::{Automaton, Parts};
use language::sites::{Atom, EventKind, Formula, ProcessRef};
use run::{Run, Seen};
pub(super) use trace::{Breaks, Followed};

/// The answer for a formula above the limit.
const TOO_LARGE: &str = "the formula is too large: write several sentences, or fewer `U`, `F` and `W` in one";

impl Question<'_, '_, '_> {
    /// Whether a formula holds.
    pub(super) fn holds(&self, formula: &Formula) -> Finding {
        let mut open = vec![formula];
        while let Some(part) = open.pop() {
            if let Formula::And(p, q) = part {
                open.extend([&**q, &**p]);
            } else if let Some(found) = self.part_holds(part) {
                return found;
            }
        }
        self.proved()
    }

    /// Returns nothing if the formula holds.
    fn part_holds(&self, formula: &Formula) -> Option<Finding> {
        let mut parts = Parts::default();
        let (holds, fails) = parts.add(formula);
        let Some(automaton) = Automaton::of(&parts, fails) else { return Some(self.open(TOO_LARGE)) };
        let mode = match parts.is_safe(holds) {
            true => Mode { aborts: true, crashes: true, stops: true, ..Mode::default() },
            false => Mode::default(),
        };
        let whom: Vec<ProcessRef> = parts.atoms.iter().map(process).collect();
        let mut system = self.system(&whom, mode);
        let is_begun = |atom: &&Atom| !matches!(atom, Atom::Happens(event) if event.kind != EventKind::Started);
        let begun = parts.atoms.iter().filter(is_begun);
        super::follow_starts(&mut system, &begun.map(process).collect::<Vec<_>>());
        let is_failure = |atom: &&Atom| matches!(atom, Atom::Happens(event) if event.kind == EventKind::Aborted);
        let failing = parts.atoms.iter().filter(is_failure);
        super::follow_failures(&mut system, &failing.map(process).collect::<Vec<_>>());
        system.notes = parts.atoms.len().div_ceil(8);
        let letters = Letters { atoms: &parts.atoms, seats: Seats::new(&system, &whom) };
        let graph = explore(&system, self.limits, true, &letters).graph;
        if let Some(reached) = graph.reached {
            return Some(self.open(reached.words()));
        }
        match accepted(&system, &graph, &parts.atoms, &automaton, self.limits) {
            Ok(run) => run.map(|run| self.does_not_hold(&system, &run)),
            Err(reached) => Some(self.open(reached.words())),
        }
    }

    fn does_not_hold(&self, system: &System<'_>, run: &Run) -> Finding {
        let why = match &run.again {
            None => "after that, the sentence can no longer hold",
            Some(again) if again.is_empty() => "nothing happens after that",
            Some(_) => "the last steps can repeat for ever",
        };
        let mut found = self.fails(why, None);
        found.story = Some(tell_run(system, &run.first, run.again.as_deref()));
        found
    }
}

/// Searches a run on which the formula of an automaton holds.
fn accepted(
    system: &System<'_>,
    graph: &Graph,
    atoms: &[Atom],
    automaton: &Automaton,
    limits: &Limits<'_>,
) -> Result<Option<Run>, crate::explore::Reached> {
    let letters: Vec<u32> = (0..graph.store.count()).map(|state| letter(system, graph.store.get(state))).collect();
    let events = atoms.iter().zip(0..).filter(|(atom, _)| matches!(atom, Atom::Happens(_)));
    // In a system in which programs do not fail by themselves, a failure comes from an inner group.
    let is_natural = |label| system.is_natural(label) || matches!(label, Label::Aborted(..)) && !system.mode.aborts;
    let seen = Seen {
        graph,
        letters: &letters,
        events: events.fold(0, |bits, (_, bit)| bits | 1 << bit),
        configurations: &configurations(system, graph),
        is_natural: &is_natural,
    };
    run::find(&seen, automaton, limits)
}

/// Returns the true atoms that are noted with a state.
fn letter(system: &System<'_>, bytes: &[u8]) -> u32 {
    let notes = &bytes[bytes.len() - system.notes..];
    notes.iter().rev().fold(0, |letter, byte| letter << 8 | u32::from(*byte))
}

/// Returns a number for the configuration of each state. The notes are not part of a configuration.
fn configurations(system: &System<'_>, graph: &Graph) -> Vec<u32> {
    let count = graph.store.count();
    let bytes = |state: u32| {
        let bytes = graph.store.get(state);
        &bytes[..bytes.len() - system.notes]
    };
    let mut order: Vec<u32> = (0..count).collect();
    order.sort_by(|one, other| bytes(*one).cmp(bytes(*other)));
    let mut numbers = vec![0; count as usize];
    for pair in order.windows(2) {
        let is_new = bytes(pair[0]) != bytes(pair[1]);
        numbers[pair[1] as usize] = numbers[pair[0] as usize] + u32::from(is_new);
    }
    numbers
}

fn process(atom: &Atom) -> ProcessRef {
    match atom {
        Atom::Active(who) | Atom::Running(who) | Atom::Stopping(who) => *who,
        Atom::Happens(event) => event.who,
    }
}

/// Notes with each state the atoms that are true there.
struct Letters<'l> {
    atoms: &'l [Atom],
    seats: Seats,
}

impl Letters<'_> {
    /// Returns the atoms that are true at a position.
    fn at(&self, system: &System<'_>, changes: &[Change], frame: &Frame) -> u32 {
        let is_true = |(_, atom): &(u32, &Atom)| self.is_true(system, atom, changes, frame);
        (0_u32..).zip(self.atoms).filter(is_true).fold(0, |letter, (bit, _)| letter | 1 << bit)
    }

    fn is_true(&self, system: &System<'_>, atom: &Atom, changes: &[Change], frame: &Frame) -> bool {
        let is_active = |who| self.seats.is_active(system, frame, who) && self.seats.has_begun(system, frame, who);
        match atom {
            Atom::Active(who) => is_active(*who),
            Atom::Running(who) => is_active(*who) && is_running(system, frame, *who),
            Atom::Stopping(who) => is_active(*who) && !is_running(system, frame, *who),
            Atom::Happens(event) => changes.iter().any(|change| self.seats.is(change, event)),
        }
    }
}

impl Observer for Letters<'_> {
    fn sees(&self, system: &System<'_>, _: bool, changes: &[Change], after: &mut Frame) -> bool {
        after.notes.fill(0);
        for (bit, atom) in self.atoms.iter().enumerate() {
            let is_true = self.is_true(system, atom, changes, after);
            after.notes[bit / 8] |= u8::from(is_true) << (bit % 8);
        }
        true
    }
}
