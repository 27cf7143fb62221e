//! The states and transitions of an activity, as data.

use super::failure::Failure;
use super::formula::Formula;
use crate::algebra::Value;
use crate::script::Script;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// An activity that was not checked yet. States are numbered in document order, and number 0 is the activity itself.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Chart {
    /// The states. Each state comes before the states inside it.
    pub states: Vec<ChartState>,
    /// The transitions in document order.
    pub transitions: Vec<Transition>,
    /// The finite variables.
    pub variables: Vec<Variable>,
    /// How many values the activity can keep.
    pub slots: usize,
    /// For each input port, the number of messages that may wait.
    pub ports: Vec<usize>,
    /// The scripts, whose numbers are in [`Action::Compute`].
    pub scripts: Vec<Script>,
}

/// One state of a chart.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChartState {
    /// The name, which only people read.
    pub name: String,
    /// The state directly around this state. The root has none.
    pub parent: Option<usize>,
    /// The kind of the state.
    pub kind: StateKind,
    /// The start value of the run, or none if the state has no run.
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
        /// The states or histories inside the state with which the state begins.
        initial: Vec<usize>,
    },
    /// A state whose inner states are active together.
    Parallel,
    /// A state whose entry completes its parent.
    Final,
    /// An atomic state that remembers which states were active before.
    Suspended,
    /// A target that leads to the states that were active before.
    History {
        /// How many states the history remembers.
        depth: History,
        /// The states that the history leads to while it remembers nothing.
        default: Vec<usize>,
    },
}

/// How many states a history remembers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum History {
    /// It remembers the active state directly inside the parent.
    Shallow,
    /// It remembers all active atomic states inside the parent.
    Deep,
}

/// A transition of a state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transition {
    /// The state that the transition belongs to.
    pub source: usize,
    /// The event that the transition waits for.
    pub trigger: Trigger,
    /// The condition. Without one, the transition is always allowed.
    pub guard: Option<Formula>,
    /// The target.
    pub target: Target,
    /// Whether the transition stays inside its source, if that is possible.
    pub internal: bool,
    /// The actions, which come after the exits and before the entries.
    pub actions: Vec<Action>,
}

/// The event that a transition waits for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Trigger {
    /// No event: the transition is taken as soon as its guard holds.
    Always,
    /// A message at a port. If there is a filter, the filter has to let the message through.
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
    /// An event outside the activity: for example a host is lost, or a person asks to suspend.
    Notice(usize),
    /// The run of the source is done. If there is a tag, the outcome has to have this tag.
    Done(Option<String>),
    /// A run in the source has aborted. If there is a cause, the abort has to have this cause.
    Aborted(Option<Failure>),
    /// The source has completed.
    Complete,
    /// The source has been active for this time.
    After(Duration),
    /// This time has passed, again and again.
    Every(Duration),
}

impl Chart {
    /// Returns a state, its parent, and so on to the root.
    pub(crate) fn upward(&self, state: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(state), |&state| self.states.get(state)?.parent)
    }
}

/// The target of a transition.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Target {
    /// No target: no state is left.
    Stay,
    /// The transition leads to these states or histories.
    States(Vec<usize>),
    /// The transition leads to the states that the suspended source remembers.
    Resume,
    /// The transition ends the activity normally, with a value.
    Done(ValueSource),
    /// The transition aborts the activity, with a text.
    Abort(String),
}

/// A value that starts a run, or that is kept or sent.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ValueSource {
    /// A constant.
    Constant(Value),
    /// A value that the activity has kept.
    Slot(usize),
    /// The value of the event: of a message, of the end of a run, or of the start of the activity.
    Event,
    /// A value with the tag of an outcome before it.
    Tagged {
        /// The tag.
        tag: String,
        /// The value.
        of: Box<Self>,
    },
    /// A text of several fragments, in the bytes that a program reads.
    Text(Vec<Fragment>),
    /// The value of a formula, in the bytes of a number that a program reads.
    Number(Formula),
}

/// An action of an activity.
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
    /// Writes a line that people read.
    Log(Vec<Fragment>),
    /// Keeps the result of a script.
    Compute {
        /// The number of the slot.
        slot: usize,
        /// The number of the script.
        script: usize,
    },
}

/// A part of a line that people read, or of a text that is sent.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fragment {
    /// A constant text.
    Text(String),
    /// The value of a formula.
    Number(Formula),
    /// The name of the value of a formula. The first name is the name of the value 0.
    Name(Formula, Vec<String>),
}

/// A finite variable. A `bool` is 0 or 1, and an enumeration counts from 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Variable {
    /// The name, which only people read.
    pub name: String,
    /// The least value.
    pub min: i32,
    /// The greatest value.
    pub max: i32,
    /// The value at the start.
    pub initial: i32,
    /// The names of the values, beginning with `min`. The list is empty if the values are numbers.
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
    /// Returns the time of a timer, or none for other triggers.
    pub fn time(&self) -> Option<Duration> {
        if let Self::After(time) | Self::Every(time) = self { Some(*time) } else { None }
    }
}

impl Transition {
    /// Returns a transition without a guard and without actions.
    pub fn new(source: usize, trigger: Trigger, target: Target) -> Self {
        Self { source, trigger, guard: None, target, internal: false, actions: Vec::new() }
    }
}
