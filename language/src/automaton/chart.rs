//! The states and transitions of an activity, as data.

use super::failure::Failure;
use super::formula::Formula;
use crate::algebra::Value;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// An activity before it is checked. States are numbered in document order, and number 0 is the activity itself.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Chart {
    /// The states, each before the states inside it.
    pub states: Vec<ChartState>,
    /// The transitions in document order.
    pub transitions: Vec<Transition>,
    /// The finite variables.
    pub variables: Vec<Variable>,
    /// How many values the activity can keep.
    pub slots: usize,
    /// For each input port, how many messages may wait.
    pub ports: Vec<usize>,
}

/// One state of a chart.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChartState {
    /// The name, for people.
    pub name: String,
    /// The state that it is directly inside; none for the root.
    pub parent: Option<usize>,
    /// The kind of the state.
    pub kind: StateKind,
    /// The value that its run starts with; none if it runs nothing.
    pub run: Option<ValueSource>,
    /// The actions on entry.
    pub entry: Vec<Action>,
    /// The actions on exit.
    pub exit: Vec<Action>,
}

/// The kind of a state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StateKind {
    /// A state without inner states.
    Atomic,
    /// A state with one active inner state at a time.
    Compound {
        /// Where it begins: states or histories inside it.
        initial: Vec<usize>,
    },
    /// A state whose inner states are active together.
    Parallel,
    /// The end of its parent.
    Final,
    /// An atomic state that remembers what was active before.
    Suspended,
    /// A place that leads to the states that were active before.
    History {
        /// How much it remembers.
        depth: History,
        /// The states that it leads to at first.
        default: Vec<usize>,
    },
}

/// How much a history remembers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum History {
    /// The active state directly inside the parent.
    Shallow,
    /// All active atomic states inside the parent.
    Deep,
}

/// A transition of a state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    /// The state that it belongs to.
    pub source: usize,
    /// The event that it waits for.
    pub trigger: Trigger,
    /// The condition; none holds always.
    pub guard: Option<Formula>,
    /// Where it leads.
    pub target: Target,
    /// Whether it stays inside its source, if it can.
    pub internal: bool,
    /// The actions between exits and entries.
    pub actions: Vec<Action>,
}

/// The event that a transition waits for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Trigger {
    /// No event: it is taken as soon as its guard holds.
    Always,
    /// A message at a port, and perhaps only one that a filter lets through.
    Message {
        /// The number of the port.
        port: usize,
        /// The number of the filter.
        filter: Option<usize>,
    },
    /// Any message or signal.
    Any,
    /// A signal that an action has raised.
    Signal(usize),
    /// Something that the surroundings have noticed: a lost host, a wish to suspend.
    Notice(usize),
    /// The run of the source is done, and perhaps only with this tag.
    Done(Option<String>),
    /// A run in the source has aborted, and perhaps only for this cause.
    Aborted(Option<Failure>),
    /// The source has completed.
    Complete,
    /// The source has been active for a time.
    After(Duration),
    /// A time has passed, again and again.
    Every(Duration),
}

impl Chart {
    /// Returns a state, its parent, and so on to the root.
    pub(crate) fn upward(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(state), |&state| self.states.get(state)?.parent)
    }
}

/// Where a transition leads.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Target {
    /// Nowhere: no state is left.
    Stay,
    /// To these states or histories.
    States(Vec<usize>),
    /// To what the suspended source remembers.
    Resume,
    /// To the normal end of the activity, with a value.
    Done(ValueSource),
    /// To the abort of the activity, with a text.
    Abort(String),
}

/// A value that a run starts with, or that is kept or sent.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ValueSource {
    /// This value.
    Constant(Value),
    /// A value that the activity has kept.
    Slot(usize),
    /// The value of the event: of a message, of the end of a run, or of the start.
    Event,
    /// A value behind the tag of an outcome.
    Tagged {
        /// The tag.
        tag: String,
        /// The value.
        of: Box<Self>,
    },
    /// A text that is put together, as a program reads it.
    Text(Vec<Fragment>),
    /// The value of a formula, as a program reads a number.
    Number(Formula),
}

/// Something that an activity does at a moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Action {
    /// Assigns a finite variable.
    Assign {
        /// The number of the variable.
        variable: usize,
        /// The new value.
        formula: Formula,
    },
    /// Keeps a value.
    Keep {
        /// The number of the slot.
        slot: usize,
        /// The value.
        value: ValueSource,
    },
    /// Raises a signal for the activity itself.
    Raise(usize),
    /// Sends a value through an output port.
    Send {
        /// The number of the output port.
        output: usize,
        /// The value.
        value: ValueSource,
    },
    /// Writes a line for people.
    Log(Vec<Fragment>),
}

/// A part of a line for people.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fragment {
    /// This text.
    Text(String),
    /// The value of a formula.
    Number(Formula),
    /// The name of the value of a formula: the first one is that of 0.
    Name(Formula, Vec<String>),
}

/// A finite variable. A `bool` is 0 or 1, and an enumeration counts from 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Variable {
    /// The name, for people.
    pub name: String,
    /// The least value.
    pub min: i32,
    /// The greatest value.
    pub max: i32,
    /// The value at the start.
    pub initial: i32,
    /// The names of the values from `min` on; none if the values are numbers.
    pub names: Vec<String>,
}

impl ChartState {
    fn new(name: &str, parent: Option<usize>, kind: StateKind) -> Self {
        Self { name: name.into(), parent, kind, run: None, entry: Vec::new(), exit: Vec::new() }
    }

    /// Returns an atomic state inside `parent`.
    pub fn atomic(name: &str, parent: usize) -> Self {
        Self::new(name, Some(parent), StateKind::Atomic)
    }

    /// Returns a compound state that begins with the state `initial`.
    pub fn compound(name: &str, parent: Option<usize>, initial: usize) -> Self {
        Self::new(name, parent, StateKind::Compound { initial: vec![initial] })
    }

    /// Returns the same state with another kind.
    #[must_use]
    pub fn with_kind(self, kind: StateKind) -> Self {
        Self { kind, ..self }
    }
}

impl Trigger {
    /// Returns how long a timer runs; none for other triggers.
    pub fn time(&self) -> Option<Duration> {
        if let Self::After(time) | Self::Every(time) = self { Some(*time) } else { None }
    }
}

impl Transition {
    /// Returns a transition without guard and actions.
    pub fn new(source: usize, trigger: Trigger, target: Target) -> Self {
        Self { source, trigger, guard: None, target, internal: false, actions: Vec::new() }
    }
}
