//! The configuration of an activity.

use super::select::Cue;
use super::shape::Automaton;
use crate::algebra::{Activation, Activity, Outcome, Reason, Value};
use crate::script::{SCRIPTS_MAX, ScriptErrorKind};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The configuration of one activity: its active states, variables and memories. It belongs to one [`Automaton`].
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Configuration {
    pub(super) active: Vec<bool>,
    /// The states that were entered in this reaction, and whose runs and timers have not begun yet.
    pub(super) fresh: Vec<bool>,
    pub(super) variables: Vec<i32>,
    pub(super) slots: Vec<Value>,
    /// The memory of each history and of each suspended state.
    pub(super) memories: Vec<Vec<usize>>,
    /// The runs of the states.
    pub(super) runs: Vec<Run>,
    /// The timers of the transitions.
    pub(super) timers: Vec<Timer>,
    /// Signals and completions that were raised. The oldest comes first.
    pub(super) raised: VecDeque<Cue>,
    /// Events that wait. The next event comes first.
    pub(super) queue: Vec<Queued>,
    /// The transitions that wait until runs have ended.
    pub(super) pending: Option<Pending>,
    /// The first error in the current step between configurations.
    pub(super) error: Option<Reason>,
    /// The scripts of this reaction.
    pub(super) scripts: ScriptAllowance,
}

/// The scripts that may still run in a reaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct ScriptAllowance {
    /// How many may still run.
    pub(super) left: u8,
    /// The failure of the next script, if an explorer lets it fail.
    pub(super) failure: Option<ScriptErrorKind>,
}

/// The run of a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Run {
    /// The number of the latest activation. It is 0 before the first activation.
    pub(super) activation: Activation,
    pub(super) activity: Activity,
}

/// The timer of a transition.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Timer {
    /// The number of the latest arming. It is 0 before the first arming.
    pub(super) activation: Activation,
    pub(super) is_armed: bool,
}

/// An event that waits for its reaction.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Queued {
    /// An event with a greater priority comes first. Ends and timers have a greater priority than all messages.
    pub(super) priority: u16,
    pub(super) cue: Cue,
}

impl Queued {
    /// Returns whether the event is a message at this port.
    pub(super) fn is_at(&self, port: usize) -> bool {
        matches!(&self.cue, Cue::Message { port: other, .. } if *other == port)
    }
}

/// A step between configurations that waits for the end of runs.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) struct Pending {
    /// The transitions that will be carried out. The list is empty if the activity ends.
    pub(super) chosen: Vec<usize>,
    /// The value of the event.
    pub(super) value: Value,
    /// The outcome of the activity, if no transition decides it.
    pub(super) ending: Option<Outcome>,
    /// The first stop that was not confirmed.
    pub(super) unconfirmed: Option<Reason>,
}

impl Configuration {
    /// Returns the configuration of an activity that was never started.
    pub fn new(automaton: &Automaton) -> Self {
        let chart = automaton.chart();
        let states = chart.states.len();
        Self {
            active: vec![false; states],
            fresh: vec![false; states],
            variables: chart.variables.iter().map(|variable| variable.initial).collect(),
            slots: vec![Value::EMPTY; chart.slots],
            memories: vec![Vec::new(); states],
            runs: vec![Run { activation: Activation(0), activity: Activity::Idle }; states],
            timers: vec![Timer::default(); chart.transitions.len()],
            raised: VecDeque::new(),
            queue: Vec::new(),
            pending: None,
            error: None,
            scripts: ScriptAllowance { left: SCRIPTS_MAX, failure: None },
        }
    }

    /// Begins a reaction to an event: its scripts get their budget. A reaction has several steps if runs end at once.
    pub fn begin_reaction(&mut self) {
        self.scripts.left = SCRIPTS_MAX;
    }

    /// Lets the next script fail.
    pub(crate) fn fail_script(&mut self, kind: ScriptErrorKind) {
        self.scripts.failure = Some(kind);
    }

    /// Returns whether the next script will fail.
    pub(crate) fn fails_script(&self) -> bool {
        self.scripts.failure.is_some()
    }

    /// Returns whether the activity does not run.
    pub fn is_idle(&self) -> bool {
        !self.active.first().is_some_and(|&active| active)
    }

    /// Returns whether a state is active.
    pub fn is_active(&self, state: usize) -> bool {
        self.active.get(state).is_some_and(|&active| active)
    }

    /// Returns the active states without active inner states, in document order.
    pub fn leaves<'a>(&'a self, automaton: &'a Automaton) -> impl Iterator<Item = usize> + 'a {
        let states = 0..self.active.len();
        states.filter(move |&state| self.active[state] && automaton.inside(state).all(|inner| !self.active[inner]))
    }

    /// Returns whether transitions wait until runs have ended.
    pub fn is_waiting(&self) -> bool {
        self.pending.is_some()
    }

    /// Returns whether a message of this priority at this port would be lost by rule 51.
    pub fn has_no_room(&self, automaton: &Automaton, port: usize, priority: u8) -> bool {
        let waiting = || self.queue.iter().filter(|queued| queued.is_at(port));
        let limit = automaton.chart().ports.get(port).copied().unwrap_or(0);
        let is_last = || waiting().all(|queued| queued.priority >= u16::from(priority));
        self.is_waiting() && waiting().count() >= limit && is_last()
    }

    /// Returns the value of a finite variable.
    pub fn variable(&self, variable: usize) -> Option<i32> {
        self.variables.get(variable).copied()
    }

    /// Returns a value that the activity keeps.
    pub fn slot(&self, slot: usize) -> Option<&Value> {
        self.slots.get(slot)
    }

    /// Returns the latest activation of the run of a state, and the activity of that run.
    pub fn run(&self, state: usize) -> (Activation, Activity) {
        self.runs.get(state).map_or((Activation(0), Activity::Idle), |run| (run.activation, run.activity))
    }

    /// Returns the number of the latest arming of a transition's timer, and whether the timer is armed.
    pub fn timer(&self, transition: usize) -> (Activation, bool) {
        self.timers.get(transition).map_or((Activation(0), false), |timer| (timer.activation, timer.is_armed))
    }

    /// Returns the same configuration with all numbers of activations set to 1, and with changed values. State-space
    /// explorers call it, because these numbers and values do not matter to them.
    pub(crate) fn without_numbers(&self, change: &dyn Fn(&Value) -> Value) -> Self {
        let mut plain = self.clone();
        plain.runs.iter_mut().for_each(|run| run.activation = Activation(1));
        plain.timers.iter_mut().for_each(|timer| timer.activation = Activation(1));
        plain.slots.iter_mut().for_each(|value| *value = change(value));
        plain.queue.iter_mut().for_each(|queued| queued.cue.change_value(change));
        if let Some(pending) = &mut plain.pending {
            pending.value = change(&pending.value);
        }
        plain
    }

    /// Queues an event after the events of the same or a higher priority.
    pub(super) fn enqueue(&mut self, priority: u16, cue: Cue) {
        let place = self.queue.partition_point(|queued| queued.priority >= priority);
        self.queue.insert(place, Queued { priority, cue });
    }

    /// Returns whether any run was asked to stop and has not ended.
    pub(super) fn awaits_runs(&self) -> bool {
        self.runs.iter().any(|run| run.activity == Activity::Stopping)
    }

    /// Resets everything but the runs and the timers, whose numbers of activations continue.
    pub(super) fn reset(&mut self, automaton: &Automaton) {
        let (runs, timers) = (std::mem::take(&mut self.runs), std::mem::take(&mut self.timers));
        *self = Self { runs, timers, ..Self::new(automaton) };
    }
}
