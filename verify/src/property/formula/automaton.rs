//! An automaton that accepts exactly the runs on which a formula holds.
//!
//! Each state determines which atoms have to be true and which false at its position, and which formulas are owed from
//! the next position on. A run is accepted if, for each `p U q`, it is infinitely often in a state where `p U q` is
//! not owed or `q` holds. Source: Gerth, Peled, Vardi, Wolper 1995, "Simple on-the-fly automatic verification of
//! linear temporal logic".

use language::sites::{Atom, Formula};
use std::collections::{BTreeMap, BTreeSet};

/// The most states of an automaton; a larger one is not built.
pub(super) const STATES_MAX: usize = 2000;
/// The most ways to fulfil the owed formulas, over all states.
const WAYS_MAX: usize = 100_000;
/// The most atoms, and the most `p U q`; both are bits of a word.
const BITS_MAX: usize = 32;

/// A set of formulas by their numbers.
type Set = BTreeSet<usize>;

/// A formula in which only atoms are negated. It refers to its parts by their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Constant(bool),
    /// An atom, and whether it has to be true.
    Atom(usize, bool),
    And(usize, usize),
    Or(usize, usize),
    Until(usize, usize),
    Release(usize, usize),
}

/// Formulas with shared parts.
#[derive(Debug, Default)]
pub(super) struct Parts {
    parts: Vec<Part>,
    numbers: BTreeMap<Part, usize>,
    /// The atoms, each once.
    pub(super) atoms: Vec<Atom>,
}

impl Parts {
    /// Adds a formula; returns its number and the number of its negation.
    pub(super) fn add(&mut self, formula: &Formula) -> (usize, usize) {
        match formula {
            Formula::Constant(value) => (self.part(Part::Constant(*value)), self.part(Part::Constant(!value))),
            Formula::Atom(atom) => {
                let known = self.atoms.iter().position(|other| other == atom);
                let number = known.unwrap_or_else(|| {
                    self.atoms.push(atom.clone());
                    self.atoms.len() - 1
                });
                (self.part(Part::Atom(number, true)), self.part(Part::Atom(number, false)))
            }
            Formula::Not(of) => {
                let (holds, fails) = self.add(of);
                (fails, holds)
            }
            Formula::And(p, q) => self.both(p, q, Part::And, Part::Or),
            Formula::Or(p, q) => self.both(p, q, Part::Or, Part::And),
            Formula::Until(p, q) => self.both(p, q, Part::Until, Part::Release),
            Formula::Release(p, q) => self.both(p, q, Part::Release, Part::Until),
            Formula::WeakUntil(p, q) => {
                let ((p, no_p), (q, no_q)) = (self.add(p), self.add(q));
                let (either, neither) = (self.part(Part::Or(p, q)), self.part(Part::And(no_p, no_q)));
                (self.part(Part::Release(q, either)), self.part(Part::Until(no_q, neither)))
            }
            Formula::Same(p, q) => {
                let ((p, no_p), (q, no_q)) = (self.add(p), self.add(q));
                let (both, neither) = (self.part(Part::And(p, q)), self.part(Part::And(no_p, no_q)));
                let (first, second) = (self.part(Part::And(p, no_q)), self.part(Part::And(no_p, q)));
                (self.part(Part::Or(both, neither)), self.part(Part::Or(first, second)))
            }
        }
    }

    fn both(
        &mut self,
        p: &Formula,
        q: &Formula,
        holds: fn(usize, usize) -> Part,
        fails: fn(usize, usize) -> Part,
    ) -> (usize, usize) {
        let ((p, no_p), (q, no_q)) = (self.add(p), self.add(q));
        (self.part(holds(p, q)), self.part(fails(no_p, no_q)))
    }

    fn part(&mut self, part: Part) -> usize {
        let next = self.parts.len();
        let number = *self.numbers.entry(part).or_insert(next);
        if number == next {
            self.parts.push(part);
        }
        number
    }

    /// Returns whether every violation of a formula happens at some position of the run, regardless of the rest of the
    /// run.
    pub(super) fn is_safe(&self, number: usize) -> bool {
        self.below(number).iter().all(|&part| !matches!(self.parts[part], Part::Until(..)))
    }

    /// Returns a formula and all its parts.
    fn below(&self, number: usize) -> Set {
        let (mut all, mut open) = (Set::new(), vec![number]);
        while let Some(number) = open.pop() {
            if all.insert(number) {
                match self.parts[number] {
                    Part::Constant(_) | Part::Atom(..) => {}
                    Part::And(p, q) | Part::Or(p, q) | Part::Until(p, q) | Part::Release(p, q) => open.extend([p, q]),
                }
            }
        }
        all
    }
}

/// A state of an automaton.
#[derive(Debug)]
pub(super) struct State {
    /// The atoms that have to be true at the state's position, and those that have to be false.
    is_true: u32,
    is_false: u32,
    /// The numbers of the `p U q` for which visits to this state are counted.
    pub(super) fulfils: u32,
    /// Whether nothing is owed from the next position on: every run that reaches this state is accepted.
    pub(super) is_free: bool,
    pub(super) next: Vec<u16>,
}

impl State {
    /// Returns whether the state can be at a position with these atoms.
    pub(super) fn fits(&self, letter: u32) -> bool {
        letter & self.is_true == self.is_true && letter & self.is_false == 0
    }
}

/// An automaton.
#[derive(Debug)]
pub(super) struct Automaton {
    pub(super) states: Vec<State>,
    pub(super) first: Vec<u16>,
    /// The number of `p U q`.
    pub(super) promises: usize,
}

/// The formulas that hold at a position, and the formulas that are owed from the next position on.
type Way = (Set, Set);

impl Automaton {
    /// Builds the automaton of a formula; none if it gets too large.
    pub(super) fn of(parts: &Parts, formula: usize) -> Option<Self> {
        let below = parts.below(formula);
        let untils: Vec<(usize, usize)> = below
            .iter()
            .filter_map(|&number| match parts.parts[number] {
                Part::Until(_, q) => Some((number, q)),
                Part::Constant(_) | Part::Atom(..) | Part::And(..) | Part::Or(..) | Part::Release(..) => None,
            })
            .collect();
        if parts.atoms.len() > BITS_MAX || untils.len() > BITS_MAX {
            return None;
        }
        let mut build = Build { parts, untils: &untils, ways: 0, numbers: BTreeMap::new(), states: Vec::new() };
        let first = build.states_of(&Set::from([formula]))?;
        let mut known: BTreeMap<Set, Vec<u16>> = BTreeMap::new();
        let mut state = 0;
        while state < build.states.len() {
            let owed = build.states[state].1.clone();
            let next = match known.get(&owed) {
                Some(next) => next.clone(),
                None => {
                    let next = build.states_of(&owed)?;
                    known.insert(owed, next.clone());
                    next
                }
            };
            build.states[state].0.next = next;
            state += 1;
        }
        let states = build.states.into_iter().map(|(state, _)| state).collect();
        Some(Self { states, first, promises: untils.len() })
    }
}

struct Build<'b> {
    parts: &'b Parts,
    untils: &'b [(usize, usize)],
    ways: usize,
    numbers: BTreeMap<Way, u16>,
    /// The states, each with the formulas that are owed from the next position on.
    states: Vec<(State, Set)>,
}

impl Build<'_> {
    /// Returns the states in which all owed formulas hold.
    fn states_of(&mut self, owed: &Set) -> Option<Vec<u16>> {
        let mut states = Vec::new();
        let mut open = vec![(owed.iter().copied().collect::<Vec<_>>(), Set::new(), Set::new())];
        while let Some((mut todo, mut holds, mut next)) = open.pop() {
            self.ways += 1;
            if self.ways > WAYS_MAX {
                return None;
            }
            let Some(number) = todo.pop() else {
                let state = self.state(&holds, next)?;
                if !states.contains(&state) {
                    states.push(state);
                }
                continue;
            };
            if !holds.insert(number) {
                open.push((todo, holds, next));
                continue;
            }
            match self.parts.parts[number] {
                Part::Constant(false) => continue,
                Part::Constant(true) => {}
                Part::Atom(atom, value) => {
                    let opposite = self.parts.numbers.get(&Part::Atom(atom, !value));
                    if opposite.is_some_and(|opposite| holds.contains(opposite)) {
                        continue;
                    }
                }
                Part::And(p, q) => todo.extend([p, q]),
                Part::Or(p, q) => {
                    open.push(([&todo[..], &[p]].concat(), holds.clone(), next.clone()));
                    todo.push(q);
                }
                Part::Until(p, q) => {
                    let mut later = next.clone();
                    later.insert(number);
                    open.push(([&todo[..], &[p]].concat(), holds.clone(), later));
                    todo.push(q);
                }
                Part::Release(p, q) => {
                    open.push(([&todo[..], &[p, q]].concat(), holds.clone(), next.clone()));
                    next.insert(number);
                    todo.push(q);
                }
            }
            open.push((todo, holds, next));
        }
        states.sort_unstable();
        Some(states)
    }

    /// Returns the state at whose position these formulas hold. Among them, only atoms and promises distinguish
    /// states.
    fn state(&mut self, holds: &Set, next: Set) -> Option<u16> {
        let mut state = State { is_true: 0, is_false: 0, fulfils: 0, is_free: next.is_empty(), next: Vec::new() };
        let mut kept = Set::new();
        for &number in holds {
            if let Part::Atom(atom, value) = self.parts.parts[number] {
                kept.insert(number);
                *(if value { &mut state.is_true } else { &mut state.is_false }) |= 1 << atom;
            }
        }
        for (bit, (until, q)) in self.untils.iter().enumerate() {
            let owes = holds.contains(until);
            state.fulfils |= u32::from(!owes || holds.contains(q)) << bit;
            kept.extend([until, q].into_iter().filter(|number| holds.contains(number)));
        }
        let number = u16::try_from(self.states.len()).ok().filter(|_| self.states.len() < STATES_MAX)?;
        let way = (kept, next);
        if let Some(known) = self.numbers.get(&way) {
            return Some(*known);
        }
        let owed = way.1.clone();
        self.numbers.insert(way, number);
        self.states.push((state, owed));
        Some(number)
    }
}
