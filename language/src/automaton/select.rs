//! Chooses the transitions that an event takes, by rules 23 to 35.

use super::chart::{Target, Transition, Trigger};
use super::configuration::Configuration;
use super::enter::effective_targets;
use super::event::Event;
use super::shape::Automaton;
use crate::algebra::{Cause, Reason, Value};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// An event in the form that transitions are compared with.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum Cue {
    Always,
    Message {
        port: usize,
        filters: Vec<usize>,
        value: Value,
    },
    Signal(usize),
    Notice(usize),
    Done {
        state: usize,
        value: Value,
    },
    Aborted {
        state: usize,
        reason: Reason,
    },
    Complete(usize),
    /// The timer of a transition.
    Timer(usize),
}

impl Cue {
    /// The state whose run or timer the event concerns, or the state that has completed.
    pub(super) fn state(&self, automaton: &Automaton) -> Option<usize> {
        match self {
            Self::Always | Self::Message { .. } | Self::Signal(_) | Self::Notice(_) => None,
            Self::Done { state, .. } | Self::Aborted { state, .. } | Self::Complete(state) => Some(*state),
            Self::Timer(transition) => Some(automaton.transition(*transition).source),
        }
    }

    /// Replaces the value of the event.
    pub(super) fn change_value(&mut self, change: &dyn Fn(&Value) -> Value) {
        match self {
            Self::Message { value, .. } | Self::Done { value, .. } => *value = change(value),
            Self::Aborted { reason, .. } => {
                if let Cause::Reported(report) = &mut reason.cause {
                    *report = change(report);
                }
            }
            Self::Always | Self::Signal(_) | Self::Notice(_) | Self::Complete(_) | Self::Timer(_) => {}
        }
    }

    /// Returns the value that the actions of these transitions see.
    pub(super) fn value(self, automaton: &Automaton, chosen: &[usize]) -> Value {
        match self {
            Self::Message { value, .. } => value,
            Self::Done { value, .. } => {
                let has_tag = |&number: &usize| matches!(automaton.transition(number).trigger, Trigger::Done(Some(_)));
                if chosen.iter().any(has_tag) { value.without_tag() } else { value }
            }
            Self::Always
            | Self::Signal(_)
            | Self::Notice(_)
            | Self::Aborted { .. }
            | Self::Complete(_)
            | Self::Timer(_) => Value::EMPTY,
        }
    }
}

impl Configuration {
    /// Returns whether a transition would take this message or notice now. For all other events, the result is `false`.
    pub fn takes(&self, automaton: &Automaton, event: Event) -> bool {
        let cue = match event {
            Event::Message { port, filters, value, .. } => Cue::Message { port, filters, value },
            Event::Notice(notice) => Cue::Notice(notice),
            Event::Start(_) | Event::Stop | Event::Ended { .. } | Event::Elapsed { .. } | Event::Overrun => {
                return false;
            }
        };
        !select(automaton, self, &cue).is_empty()
    }
}

/// Returns the transitions that an event takes, in the order in which they are found.
pub(super) fn select(automaton: &Automaton, configuration: &Configuration, cue: &Cue) -> Vec<usize> {
    let first = |state: usize, only_own: bool| {
        let levels = if only_own { 1 } else { usize::MAX };
        let mut states = automaton.upward(state).take(levels);
        states.find_map(|source| {
            let mut of = automaton.transitions_of(source).iter().copied();
            of.find(|&number| is_enabled(automaton, configuration, number, cue))
        })
    };
    match cue {
        Cue::Done { state, .. } | Cue::Complete(state) => first(*state, true).into_iter().collect(),
        Cue::Aborted { state, .. } => first(*state, false).into_iter().collect(),
        Cue::Timer(number) => {
            Some(*number).filter(|_| is_enabled(automaton, configuration, *number, cue)).into_iter().collect()
        }
        Cue::Always | Cue::Message { .. } | Cue::Signal(_) | Cue::Notice(_) => {
            let mut found: Vec<usize> = Vec::new();
            for number in configuration.leaves(automaton).filter_map(|leaf| first(leaf, false)) {
                if !found.contains(&number) {
                    found.push(number);
                }
            }
            without_conflicts(automaton, configuration, found)
        }
    }
}

/// Returns whether the trigger of a transition fits, and its guard holds.
fn is_enabled(automaton: &Automaton, configuration: &Configuration, number: usize, cue: &Cue) -> bool {
    let transition = automaton.transition(number);
    let fits = match (&transition.trigger, cue) {
        (Trigger::Always, Cue::Always)
        | (Trigger::Any, Cue::Message { .. } | Cue::Signal(_))
        | (Trigger::Complete, Cue::Complete(_)) => true,
        (Trigger::Message { port, filter }, Cue::Message { port: arrived, filters, .. }) => {
            port == arrived && filter.is_none_or(|filter| filters.contains(&filter))
        }
        (Trigger::Signal(signal), Cue::Signal(raised)) => signal == raised,
        (Trigger::Notice(notice), Cue::Notice(noticed)) => notice == noticed,
        (Trigger::Done(tag), Cue::Done { value, .. }) => tag.as_deref().is_none_or(|tag| value.tag() == Some(tag)),
        (Trigger::Aborted(failure), Cue::Aborted { reason, .. }) => {
            failure.as_ref().is_none_or(|failure| failure.is_of(&reason.cause))
        }
        (Trigger::After(_) | Trigger::Every(_), Cue::Timer(elapsed)) => *elapsed == number,
        (
            Trigger::Always
            | Trigger::Message { .. }
            | Trigger::Any
            | Trigger::Signal(_)
            | Trigger::Notice(_)
            | Trigger::Done(_)
            | Trigger::Aborted(_)
            | Trigger::Complete
            | Trigger::After(_)
            | Trigger::Every(_),
            _,
        ) => false,
    };
    fits && transition.guard.as_ref().is_none_or(|guard| guard.value(configuration) != 0)
}

/// Drops transitions that conflict with others, by rules 32 to 34.
fn without_conflicts(automaton: &Automaton, configuration: &Configuration, found: Vec<usize>) -> Vec<usize> {
    if found.len() < 2 {
        return found;
    }
    let exit_set = |number: usize| exit_set(automaton, configuration, automaton.transition(number));
    let mut kept: Vec<(usize, BTreeSet<usize>)> = Vec::new();
    for number in found {
        let exits = exit_set(number);
        let inside = |other: usize| {
            let source = automaton.transition(number).source;
            automaton.inside(automaton.transition(other).source).contains(&source)
        };
        let conflicts = |other: &BTreeSet<usize>| !exits.is_disjoint(other);
        if kept.iter().all(|(other, exits)| !conflicts(exits) || inside(*other)) {
            kept.retain(|(_, exits)| !conflicts(exits));
            kept.push((number, exits));
        }
    }
    kept.into_iter().map(|(number, _)| number).collect()
}

/// Returns the active states that a transition leaves, by rule 21.
pub(super) fn exit_set(
    automaton: &Automaton,
    configuration: &Configuration,
    transition: &Transition,
) -> BTreeSet<usize> {
    let inside = match &transition.target {
        Target::Stay => return BTreeSet::new(),
        Target::Done(_) | Target::Abort(_) => 0..configuration.active.len(),
        Target::States(_) | Target::Resume => {
            let targets = effective_targets(automaton, configuration, transition);
            automaton.inside(automaton.domain(transition, &targets))
        }
    };
    inside.filter(|&state| configuration.active[state]).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Action, Chart, ChartState, Fragment, step};
    use super::*;

    /// A transition that leaves no state and only writes a line takes its event, although nothing changes.
    #[test]
    fn a_transition_that_only_logs_takes_its_event() {
        let stay = |source, trigger, actions| Transition { actions, ..Transition::new(source, trigger, Target::Stay) };
        let says = vec![Action::Log(vec![Fragment::Text("heard".into())])];
        let chart = Chart {
            states: vec![ChartState::compound("lamp", None, 1), ChartState::atomic("dark", 0)],
            transitions: vec![
                stay(1, Trigger::Message { port: 0, filter: Some(4) }, says.clone()),
                stay(1, Trigger::Notice(2), says),
            ],
            ports: vec![8],
            ..Chart::default()
        };
        let lamp = Automaton::new(chart).expect("it is an automaton");
        let mut place = Configuration::new(&lamp);
        let message = |filters| Event::Message { port: 0, filters, priority: 0, value: Value::EMPTY };
        assert!(!place.takes(&lamp, message(vec![4])), "it does not run");
        step(&lamp, &mut place, Event::Start(Value::EMPTY), &mut Vec::new());
        let before = place.clone();
        for (event, takes) in [
            (message(vec![4]), true),
            (message(vec![3]), false),
            (Event::Notice(2), true),
            (Event::Notice(1), false),
            (Event::Stop, false),
        ] {
            assert_eq!(place.takes(&lamp, event.clone()), takes, "{event:?}");
            if event != Event::Stop {
                step(&lamp, &mut place, event, &mut Vec::new());
                assert_eq!(place, before);
            }
        }
    }
}
