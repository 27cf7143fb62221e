//! A chart that was checked.

use super::chart::{Action, Chart, Fragment, StateKind, Target, Transition, Trigger, ValueSource};
use super::configuration::Configuration;
use super::formula::Formula;
use crate::algebra::TAG_MAX;
use crate::plan::DEPTH_MAX;
use crate::script::{SCRIPT_INPUTS_MAX, SCRIPT_TEXT_MAX, Script, ScriptSource};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// The most states of a chart.
pub const STATES_MAX: usize = 10_000;

/// A chart that was checked, with the tables of [`step`](super::step()).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Automaton {
    chart: Chart,
    /// For each state, one past the last state inside it.
    ends: Vec<usize>,
    /// For each state, its transitions in document order.
    transitions_of: Vec<Vec<usize>>,
    #[serde(skip)]
    scripts: Scripts,
}

/// How the results of scripts are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scripts {
    /// Each script runs.
    #[default]
    Run,
    /// A script runs if all its inputs are known. Otherwise its result is an empty value, which stands for any value.
    Known,
    /// No script runs: each result is an empty value, or the script fails because an explorer wants this.
    Assumed,
}

/// A place in a chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChartPlace {
    /// A state.
    State(usize),
    /// A transition.
    Transition(usize),
}

impl std::fmt::Display for ChartPlace {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::State(number) => write!(f, "state {number}"),
            Self::Transition(number) => write!(f, "transition {number}"),
        }
    }
}

/// Why a chart is not an automaton.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChartError {
    /// The states are not a tree in document order.
    #[error(
        "state {0} is not in document order: its parent has to come before it, with only its own inner states between"
    )]
    Order(usize),
    /// The number of states is 0 or too great.
    #[error("a chart has 1 to {STATES_MAX} states")]
    Size,
    /// States are nested too deep.
    #[error("state {0} is nested deeper than {DEPTH_MAX} levels")]
    Depth(usize),
    /// The kind of a state does not fit its place.
    #[error("state {state} {why}")]
    Kind {
        /// The state.
        state: usize,
        /// The predicate of the sentence that says the error.
        why: &'static str,
    },
    /// Targets that cannot be entered together, or that are not where they have to be.
    #[error("the targets of {place} {why}")]
    Targets {
        /// The state or transition that names them.
        place: ChartPlace,
        /// The predicate of the sentence that says the error.
        why: &'static str,
    },
    /// A trigger that its state cannot have.
    #[error("transition {transition} {why}")]
    Trigger {
        /// The transition.
        transition: usize,
        /// The predicate of the sentence that says the error.
        why: &'static str,
    },
    /// A number that stands for nothing.
    #[error("{0} does not exist")]
    Missing(String),
    /// A variable whose initial value is outside its range.
    #[error("variable {0} begins outside its range")]
    Range(usize),
}

impl Automaton {
    /// Checks a chart.
    ///
    /// # Errors
    /// If the chart breaks one of the rules that [`step`](super::step()) rests on.
    pub fn new(chart: Chart) -> Result<Self, ChartError> {
        let ends = ends(&chart)?;
        let mut transitions_of = vec![Vec::new(); chart.states.len()];
        for (number, transition) in chart.transitions.iter().enumerate() {
            let of = transitions_of.get_mut(transition.source);
            of.ok_or_else(|| ChartError::Missing(format!("state {}", transition.source)))?.push(number);
        }
        let automaton = Self { chart, ends, transitions_of, scripts: Scripts::Run };
        (0..automaton.ends.len()).try_for_each(|state| automaton.check_state(state))?;
        (0..automaton.chart.transitions.len()).try_for_each(|number| automaton.check_transition(number))?;
        let mut variables = automaton.chart.variables.iter();
        match variables.position(|variable| !(variable.min..=variable.max).contains(&variable.initial)) {
            Some(variable) => Err(ChartError::Range(variable)),
            None => Ok(automaton),
        }
    }

    /// Returns the chart.
    pub fn chart(&self) -> &Chart {
        &self.chart
    }

    /// Returns how the results of scripts are found.
    pub(super) fn scripts(&self) -> Scripts {
        self.scripts
    }

    /// Changes how the results of scripts are found.
    pub(crate) fn set_scripts(&mut self, scripts: Scripts) {
        self.scripts = scripts;
    }

    /// The states inside a state, at any depth.
    pub(super) fn inside(&self, state: usize) -> Range<usize> {
        state + 1..self.ends[state]
    }

    /// The states directly inside a state, without histories.
    pub(super) fn children(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        let place = self.inside(state);
        let first = Some(place.start).filter(|&first| first < place.end);
        let all = std::iter::successors(first, move |&child| Some(self.ends[child]).filter(|&next| next < place.end));
        all.filter(|&child| !matches!(self.kind(child), StateKind::History { .. }))
    }

    pub(super) fn kind(&self, state: usize) -> &StateKind {
        &self.chart.states[state].kind
    }

    pub(super) fn parent(&self, state: usize) -> Option<usize> {
        self.chart.states[state].parent
    }

    /// A state, its parent, and so on to the root.
    pub(super) fn upward(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        self.chart.upward(state)
    }

    pub(super) fn transition(&self, transition: usize) -> &Transition {
        &self.chart.transitions[transition]
    }

    /// The transitions of a state in document order.
    pub(super) fn transitions_of(&self, state: usize) -> &[usize] {
        &self.transitions_of[state]
    }

    /// Rules 18 to 20: the domain of a transition that leads to these states.
    pub(super) fn domain(&self, transition: &Transition, targets: &[usize]) -> usize {
        let are_inside = |state: &usize| targets.iter().all(|target| self.inside(*state).contains(target));
        let is_internal = transition.internal && matches!(self.kind(transition.source), StateKind::Compound { .. });
        let mut around = self.upward(transition.source).skip(usize::from(!is_internal));
        around.find(are_inside).unwrap_or(0)
    }

    /// Rule 29: whether a state has completed.
    pub(super) fn is_complete(&self, configuration: &Configuration, state: usize) -> bool {
        match self.kind(state) {
            StateKind::Compound { .. } => {
                self.children(state).any(|child| configuration.active[child] && *self.kind(child) == StateKind::Final)
            }
            StateKind::Parallel => self.children(state).all(|region| self.is_complete(configuration, region)),
            StateKind::Atomic | StateKind::Final | StateKind::Suspended | StateKind::History { .. } => false,
        }
    }

    /// The states that complete because this one was entered, inner ones first.
    pub(super) fn completed_by(&self, configuration: &Configuration, state: usize) -> Vec<usize> {
        if *self.kind(state) != StateKind::Final {
            return Vec::new();
        }
        let mut around = self.upward(state).skip(1);
        let first = around.next();
        let is_next =
            |&state: &usize| *self.kind(state) == StateKind::Parallel && self.is_complete(configuration, state);
        first.into_iter().chain(around.take_while(is_next)).collect()
    }

    fn check_state(&self, number: usize) -> Result<(), ChartError> {
        let state = &self.chart.states[number];
        let wrong = |why| Err(ChartError::Kind { state: number, why });
        let inner = self.inside(number);
        let (is_root, is_empty) = (state.parent.is_none(), self.children(number).next().is_none());
        let is_region = state.parent.is_some_and(|parent| *self.kind(parent) == StateKind::Parallel);
        match &state.kind {
            StateKind::Compound { .. } | StateKind::Parallel if is_empty => return wrong("has no inner state"),
            StateKind::Compound { initial } => self.check_targets(initial, number, ChartPlace::State(number))?,
            StateKind::Parallel => {}
            StateKind::Atomic if inner.is_empty() => {}
            StateKind::Atomic => return wrong("is atomic and has inner states"),
            StateKind::Final | StateKind::Suspended | StateKind::History { .. } if !inner.is_empty() => {
                return wrong("cannot have inner states");
            }
            StateKind::Final | StateKind::Suspended if is_root || is_region => return wrong("cannot be a region"),
            StateKind::History { .. } if is_root => return wrong("is a history and cannot be the root"),
            StateKind::Final if state.run.is_some() || !self.transitions_of[number].is_empty() => {
                return wrong("is final and can have neither a run nor a transition");
            }
            StateKind::Final | StateKind::Suspended => {}
            StateKind::History { default, .. } => {
                let has_more = !self.transitions_of[number].is_empty() || !state.entry.is_empty();
                if has_more || !state.exit.is_empty() || state.run.is_some() {
                    return wrong("is a history and can have neither a run, nor actions, nor a transition");
                }
                let parent = state.parent.unwrap_or(0);
                self.check_targets(default, parent, ChartPlace::State(number))?;
                if default.iter().any(|&target| matches!(self.kind(target), StateKind::History { .. })) {
                    return wrong("is a history and cannot lead to another history");
                }
            }
        }
        let begins = |target: &usize| *self.kind(*target) == StateKind::Suspended;
        if let StateKind::Compound { initial } = &state.kind
            && initial.iter().any(begins)
        {
            return wrong("cannot begin in a suspended state");
        }
        if state.run == Some(ValueSource::Event) {
            return wrong("starts its run after the event, so the value of the event has to be kept");
        }
        state.run.iter().try_for_each(|value| self.check_value(value))?;
        self.check_actions(&state.entry)?;
        self.check_actions(&state.exit)
    }

    /// Targets are inside a state, and they can be active together: each two are in different regions.
    fn check_targets(&self, targets: &[usize], around: usize, place: ChartPlace) -> Result<(), ChartError> {
        let wrong = |why| Err(ChartError::Targets { place, why });
        if targets.is_empty() {
            return wrong("are missing");
        }
        if let Some(target) = targets.iter().find(|&&target| target >= self.ends.len()) {
            return Err(ChartError::Missing(format!("state {target}")));
        }
        if targets.iter().any(|target| !self.inside(around).contains(target)) {
            return wrong("are not inside it");
        }
        for (place, &target) in targets.iter().enumerate() {
            for &other in &targets[..place] {
                let mut both = self.upward(target).filter(|&state| state <= other && other < self.ends[state]);
                let common = both.next().unwrap_or(0);
                let fills = |history: usize| {
                    matches!(self.kind(history), StateKind::History { .. }) && self.parent(history) == Some(common)
                };
                let is_parallel = *self.kind(common) == StateKind::Parallel;
                if common == target || common == other || !is_parallel || fills(target) || fills(other) {
                    return wrong("cannot be active together");
                }
            }
        }
        Ok(())
    }

    fn check_transition(&self, number: usize) -> Result<(), ChartError> {
        let transition = &self.chart.transitions[number];
        let wrong = |why| Err(ChartError::Trigger { transition: number, why });
        let source = &self.chart.states[transition.source];
        let has_children = matches!(source.kind, StateKind::Compound { .. } | StateKind::Parallel);
        match &transition.trigger {
            Trigger::Done(_) if source.run.is_none() => return wrong("waits for a run, and its state has none"),
            Trigger::Complete if !has_children => return wrong("waits for the completion of an atomic state"),
            Trigger::After(time) | Trigger::Every(time) if time.is_zero() => return wrong("waits for no time"),
            Trigger::Message { port, .. } if *port >= self.chart.ports.len() => {
                return Err(ChartError::Missing(format!("port {port}")));
            }
            Trigger::Always
            | Trigger::Message { .. }
            | Trigger::Any
            | Trigger::Signal(_)
            | Trigger::Notice(_)
            | Trigger::Done(_)
            | Trigger::Aborted(_)
            | Trigger::Complete
            | Trigger::After(_)
            | Trigger::Every(_) => {}
        }
        match &transition.target {
            Target::Stay | Target::Abort(_) => {}
            Target::States(targets) => self.check_targets(targets, 0, ChartPlace::Transition(number))?,
            Target::Resume if source.kind == StateKind::Suspended => {}
            Target::Resume => return wrong("resumes, and its state is not suspended"),
            Target::Done(value) => self.check_value(value)?,
        }
        transition.guard.iter().try_for_each(|guard| self.check_formula(guard, 1))?;
        self.check_actions(&transition.actions)
    }

    fn check_actions(&self, actions: &[Action]) -> Result<(), ChartError> {
        actions.iter().try_for_each(|action| match action {
            Action::Assign { variable, formula } => {
                self.check_formula(&Formula::Variable(*variable), 1)?;
                self.check_formula(formula, 1)
            }
            Action::Keep { slot, value } => {
                self.check_value(&ValueSource::Slot(*slot))?;
                self.check_value(value)
            }
            Action::Raise(_) => Ok(()),
            Action::Send { value, .. } => self.check_value(value),
            Action::Log(fragments) => self.check_fragments(fragments),
            Action::Compute { slot, script } => {
                let script = self.chart.scripts.get(*script);
                self.check_script(script.ok_or_else(|| ChartError::Missing("a script".to_owned()))?)?;
                self.check_value(&ValueSource::Slot(*slot))
            }
        })
    }

    fn check_script(&self, script: &Script) -> Result<(), ChartError> {
        if script.text.len() > SCRIPT_TEXT_MAX {
            return Err(ChartError::Missing(format!("a script of {} bytes", script.text.len())));
        }
        if script.inputs.len() > SCRIPT_INPUTS_MAX {
            return Err(ChartError::Missing(format!("a script with {} inputs", script.inputs.len())));
        }
        script.inputs.iter().try_for_each(|input| match input.source {
            ScriptSource::Event(_) => Ok(()),
            ScriptSource::Slot { slot, .. } => self.check_value(&ValueSource::Slot(slot)),
            ScriptSource::Variable(variable) => self.check_formula(&Formula::Variable(variable), 1),
        })
    }

    fn check_fragments(&self, fragments: &[Fragment]) -> Result<(), ChartError> {
        fragments.iter().try_for_each(|fragment| match fragment {
            Fragment::Text(_) => Ok(()),
            Fragment::Number(formula) | Fragment::Name(formula, _) => self.check_formula(formula, 1),
        })
    }

    fn check_value(&self, value: &ValueSource) -> Result<(), ChartError> {
        match value {
            ValueSource::Slot(slot) if *slot >= self.chart.slots => Err(ChartError::Missing(format!("slot {slot}"))),
            ValueSource::Slot(_) | ValueSource::Constant(_) | ValueSource::Event => Ok(()),
            ValueSource::Tagged { of, .. } if matches!(**of, ValueSource::Tagged { .. }) => {
                Err(ChartError::Missing("a value with one tag".to_owned()))
            }
            ValueSource::Tagged { tag, .. } if tag.is_empty() || tag.len() > TAG_MAX => {
                Err(ChartError::Missing(format!("a tag of 1 to {TAG_MAX} bytes: `{tag}`")))
            }
            ValueSource::Tagged { of, .. } => self.check_value(of),
            ValueSource::Text(fragments) => self.check_fragments(fragments),
            ValueSource::Number(formula) => self.check_formula(formula, 1),
        }
    }

    fn check_formula(&self, formula: &Formula, depth: usize) -> Result<(), ChartError> {
        if depth > DEPTH_MAX {
            return Err(ChartError::Missing(format!("a formula {depth} levels deep")));
        }
        let variables = self.chart.variables.len();
        if let Formula::Variable(variable) = formula
            && *variable >= variables
        {
            return Err(ChartError::Missing(format!("variable {variable}")));
        }
        if let Formula::In(state) = formula
            && *state >= self.ends.len()
        {
            return Err(ChartError::Missing(format!("state {state}")));
        }
        formula.operands().into_iter().flatten().try_for_each(|operand| self.check_formula(operand, depth + 1))
    }
}

/// For each state, one past the last state inside it.
fn ends(chart: &Chart) -> Result<Vec<usize>, ChartError> {
    if !(1..=STATES_MAX).contains(&chart.states.len()) {
        return Err(ChartError::Size);
    }
    let (mut ends, mut open) = (vec![chart.states.len(); chart.states.len()], Vec::new());
    for (number, state) in chart.states.iter().enumerate() {
        while let Some(last) = open.pop_if(|last| Some(*last) != state.parent) {
            ends[last] = number;
        }
        if open.is_empty() != (number == 0) || (number == 0) != state.parent.is_none() {
            return Err(ChartError::Order(number));
        }
        open.push(number);
        if open.len() > DEPTH_MAX {
            return Err(ChartError::Depth(number));
        }
    }
    Ok(ends)
}
