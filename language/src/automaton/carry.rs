//! Finds the configuration of a running activity in its changed chart.
//!
//! The names of states and variables decide which states and variables are the same. Kept values stay in their order.
//! Timers are the same if they have the same state, the same time, and the same position among the equal timers of that
//! state.

use super::chart::{StateKind, Trigger, Variable};
use super::configuration::Configuration;
use super::shape::Automaton;
use crate::algebra::{Activity, Value};
use std::collections::BTreeMap;
use std::mem::discriminant;

/// An activity that has moved to its changed chart.
#[derive(Debug)]
pub(crate) struct Moved {
    /// The configuration in the new chart.
    pub(crate) place: Configuration,
    /// The new number of each old state that is still there.
    pub(crate) states: Vec<Option<usize>>,
    /// The transitions whose timers run on: the old number and the new number of each.
    pub(crate) timers: Vec<(usize, usize)>,
    /// The old transitions whose timers run, but that have no counterpart in the new chart.
    pub(crate) cancelled: Vec<usize>,
    /// The new transitions of active states whose timers begin now.
    pub(crate) armed: Vec<usize>,
}

/// Finds the configuration that a running activity has in another chart.
///
/// # Errors
/// Why the activity has no such configuration, as a clause of a sentence.
pub(crate) fn carry(old: &Automaton, place: &Configuration, new: &Automaton) -> Result<Moved, &'static str> {
    if place.is_waiting() {
        return Err("a transition of the activity waits for a stop");
    }
    let change = Change { old, place, new, states: mapped(old, new) };
    let mut next = Configuration::new(new);
    change.states(&mut next)?;
    change.memories(&mut next)?;
    change.variables(&mut next)?;
    next.slots.clone_from(&place.slots);
    next.slots.resize(new.chart().slots, Value::EMPTY);
    Ok(change.timers(next))
}

/// Returns, for each old state, the new state of the same name. The root stays the root.
fn mapped(old: &Automaton, new: &Automaton) -> Vec<Option<usize>> {
    let states = new.chart().states.iter().enumerate().skip(1);
    let names: BTreeMap<&str, usize> = states.map(|(number, state)| (state.name.as_str(), number)).collect();
    let states = old.chart().states.iter().enumerate();
    let there = |(number, state): (usize, &super::ChartState)| match number {
        0 => Some(0),
        _ => names.get(state.name.as_str()).copied(),
    };
    states.map(there).collect()
}

/// Returns the value that the new variable has in place of the value of the old variable.
fn value_in(new: &Variable, old: &Variable, value: i32) -> Result<i32, &'static str> {
    if new.names.is_empty() != old.names.is_empty() {
        return Err("a variable of the activity has numbers in place of names, or names in place of numbers");
    }
    let name = usize::try_from(value).ok().and_then(|value| old.names.get(value));
    if let Some(name) = name {
        let there = new.names.iter().position(|other| other == name).and_then(|there| i32::try_from(there).ok());
        return there.ok_or("a variable of the activity has a value that does not exist any more");
    }
    let is_inside = (new.min..=new.max).contains(&value);
    if is_inside { Ok(value) } else { Err("a variable of the activity has a value that is outside its new range") }
}

/// The change from one chart to another one.
struct Change<'a> {
    old: &'a Automaton,
    place: &'a Configuration,
    new: &'a Automaton,
    /// The new number of each old state that is still there.
    states: Vec<Option<usize>>,
}

impl Change<'_> {
    /// Moves the active states, and checks that their runs can continue.
    fn states(&self, next: &mut Configuration) -> Result<(), &'static str> {
        for state in (0..self.states.len()).filter(|&state| self.place.active[state]) {
            let there = self.states[state].ok_or("a state that the activity is in does not exist any more")?;
            if self.new.parent(there) != self.old.parent(state).and_then(|parent| self.states[parent]) {
                return Err("a state that the activity is in stands inside another state");
            }
            if discriminant(self.old.kind(state)) != discriminant(self.new.kind(there)) {
                return Err("a state that the activity is in is of another kind");
            }
            let is_running = self.place.runs[state].activity != Activity::Idle;
            if is_running && self.new.chart().states[there].run.is_none() {
                return Err("a state that the activity is in runs nothing any more");
            }
            next.active[there] = true;
        }
        let is_whole = |state: usize| {
            *self.new.kind(state) != StateKind::Parallel || self.new.children(state).all(|inner| next.active[inner])
        };
        match (0..next.active.len()).all(|state| !next.active[state] || is_whole(state)) {
            true => Ok(()),
            false => Err("a `parallel state` that the activity is in has other states inside"),
        }
    }

    /// Moves the numbers of runs, and the memories of histories and suspended states. A history forgets states that are gone.
    fn memories(&self, next: &mut Configuration) -> Result<(), &'static str> {
        for (state, there) in self.states.iter().enumerate() {
            let Some(there) = *there else { continue };
            next.runs[there] = self.place.runs[state];
            let memory = self.place.memories[state].iter().map(|&remembered| self.states[remembered]);
            let around = self.new.inside(self.new.parent(there).unwrap_or(0));
            let memory: Option<Vec<usize>> = memory.collect();
            let memory = memory.filter(|memory| memory.iter().all(|inner| around.contains(inner)));
            let is_suspended = *self.old.kind(state) == StateKind::Suspended && self.place.active[state];
            if is_suspended && memory.is_none() {
                return Err("a state to which the suspended activity returns does not exist any more");
            }
            next.memories[there] = memory.unwrap_or_default();
        }
        Ok(())
    }

    fn variables(&self, next: &mut Configuration) -> Result<(), &'static str> {
        for (number, variable) in self.new.chart().variables.iter().enumerate() {
            let known = self.old.chart().variables.iter().position(|other| other.name == variable.name);
            let Some(known) = known else { continue };
            next.variables[number] =
                value_in(variable, &self.old.chart().variables[known], self.place.variables[known])?;
        }
        Ok(())
    }

    /// Finds the timers that run on, the timers that are cancelled, and the timers that begin.
    fn timers(self, mut next: Configuration) -> Moved {
        let (mut kept, mut cancelled, mut known) = (Vec::new(), Vec::new(), Vec::new());
        for number in 0..self.old.chart().transitions.len() {
            let counterpart = self.counterpart(number);
            known.extend(counterpart);
            let timer = self.place.timers[number];
            match counterpart {
                Some(other) => {
                    next.timers[other] = timer;
                    kept.extend(timer.is_armed.then_some((number, other)));
                }
                None => cancelled.extend(timer.is_armed.then_some(number)),
            }
        }
        let begins = |&number: &usize| {
            let transition = self.new.transition(number);
            transition.trigger.time().is_some() && next.active[transition.source] && !known.contains(&number)
        };
        let armed: Vec<usize> = (0..self.new.chart().transitions.len()).filter(begins).collect();
        for &number in &armed {
            next.timers[number].is_armed = true;
            next.timers[number].activation.0 += 1;
        }
        Moved { place: next, states: self.states, timers: kept, cancelled, armed }
    }

    /// Returns the new transition with the same timer in the same state.
    fn counterpart(&self, number: usize) -> Option<usize> {
        let transition = self.old.transition(number);
        let is_timer = matches!(transition.trigger, Trigger::After(_) | Trigger::Every(_));
        let there = self.states[transition.source].filter(|_| is_timer)?;
        let same = |automaton: &Automaton, source: usize| -> Vec<usize> {
            let of = automaton.transitions_of(source).iter().copied();
            of.filter(|&other| automaton.transition(other).trigger == transition.trigger).collect()
        };
        let rank = same(self.old, transition.source).iter().position(|&other| other == number)?;
        same(self.new, there).get(rank).copied()
    }
}
