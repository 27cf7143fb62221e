//! Checked event actions: expressions, and the charts of activities.

use super::{Kind, Outcome, Port, Value};
use crate::automaton::{Failure, StateKind, Trigger};
use crate::plan::StateChart;
use crate::source::Span;
use crate::syntax::ast::Name;
use std::collections::BTreeMap;
use std::time::Duration;

/// An event-action expression, in which slots replace names.
#[derive(Debug)]
pub(crate) struct Expr {
    pub(crate) span: Span,
    pub(crate) kind: ExprKind,
}

#[derive(Debug)]
pub(crate) enum ExprKind {
    /// The slot, and the open sets as indices into [`Process::sets`].
    Run(usize, Vec<usize>),
    Skip,
    Never,
    Fail(String),
    Wait(Duration),
    Concurrent(Vec<Expr>),
    FailFast(Vec<Expr>),
    AnyOf(u32, Vec<Expr>),
    AtLeast(u32, Vec<Expr>),
    Disable(Vec<Expr>),
    Sequence(Vec<Expr>),
    Conditional(Vec<Expr>),
    Otherwise(Vec<Expr>),
    Recurrent(Box<Expr>, Box<Expr>),
    /// `P else match { ... }`
    Catch(Box<Expr>, Vec<CatchArm>),
    /// The number of further attempts, and the pause before each of them.
    Retry(u32, Option<Duration>, Box<Expr>),
    /// The outcomes that end the repetition. Any other outcome starts the operand again.
    Repeat(Vec<Name>, Box<Expr>),
    Within(Duration, Box<Expr>),
    Match(Vec<Arm>),
    Shield(Option<Duration>, Box<Expr>),
    /// A process with the resources that it takes, as indices into [`Process::resources`].
    Using(Vec<usize>, Box<Expr>),
    /// The source, and the expanded pool.
    Asynchronous(Box<Expr>, Vec<Expr>),
    Finally(Box<Expr>, Box<Expr>),
    /// The tag that the outcome gets.
    Tagged(Name, Box<Expr>),
    /// The start value.
    With(StartValue, Box<Expr>),
    /// A name for the start value. The operand starts with nothing.
    Named(Name, Box<Expr>),
    /// The states of an activity.
    Chart(Box<ChartModel>),
    /// A text that could not be read or resolved, which is already reported.
    Broken,
}

/// The value that an expression starts with.
#[derive(Debug)]
pub(crate) enum StartValue {
    /// A value of the text, or a parameter of the group.
    Known(Value),
    /// The content of an opaque variable of the activity: its number, and its name.
    Kept(usize, Name),
    /// The value to which an [`ExprKind::Named`] around it gives this name.
    Result(Name),
}

/// The states of an activity, with their runs.
#[derive(Debug)]
pub(crate) struct ChartModel {
    /// Everything but the runs.
    pub(crate) chart: StateChart,
    /// The runs, each with the number of its state.
    pub(crate) runs: Vec<(usize, Expr)>,
    /// The place where each notice of the chart is used first.
    pub(crate) notices: Vec<Span>,
    /// The place of each transition.
    pub(crate) places: Vec<Span>,
    /// The trigger and the condition of each transition in the words of the text.
    pub(crate) labels: Vec<String>,
    /// The expression of each run in the words of the text.
    pub(crate) run_labels: Vec<String>,
    /// The message ports of the activity.
    pub(crate) ports: Vec<Port>,
    /// The normal ends of the activity, if they have names.
    pub(crate) outcomes: Vec<Outcome>,
    /// The declared types of opaque variables, by slot.
    pub(crate) kinds: BTreeMap<usize, Kind>,
    /// The scripts, in the order of the chart.
    pub(crate) scripts: Vec<ScriptModel>,
}

/// A script of an activity, before the types of its values are known.
#[derive(Debug)]
pub(crate) struct ScriptModel {
    /// The text with its braces.
    pub(crate) span: Span,
    /// The variable that gets the result.
    pub(crate) variable: Name,
    /// The slot of this variable.
    pub(crate) slot: usize,
    /// The names that the script may read.
    pub(crate) known: Vec<Readable>,
}

/// A name that a script may read.
#[derive(Debug)]
pub(crate) struct Readable {
    pub(crate) name: String,
    pub(crate) value: ReadableValue,
}

/// The value of a name that a script may read.
#[derive(Clone, Debug)]
pub(crate) enum ReadableValue {
    /// A finite variable.
    Variable(usize),
    /// An opaque variable: its slot.
    Slot(usize),
    /// The value of the event of a transition that leaves this state.
    Event { trigger: Trigger, state: usize },
}

impl ChartModel {
    /// Returns the path from the activity to the run of a state, through the states around it. The run of a state and the inner states are
    /// parallel. The inner states are also parallel to each other if the state is parallel.
    fn way_to(&self, state: usize) -> Path {
        let states = &self.chart.chart.states;
        let mut way: Path = vec![(0, true)];
        for state in self.chart.chart.upward(state) {
            let Some(outer) = states.get(state).and_then(|it| states.get(it.parent?)) else { break };
            way.extend([(state, outer.kind == StateKind::Parallel), (1, true)]);
        }
        way.reverse();
        way
    }
}

/// The path from the root of an expression to a place in it: for each operator, the index of the operand, and whether it runs in parallel
/// to others.
pub(crate) type Path = Vec<(usize, bool)>;

/// Returns whether two places run in parallel. The innermost operator that joins them decides. Returns none if no operator joins them,
/// because they are the same place, or one is inside the other.
pub(crate) fn are_parallel(one: &Path, other: &Path) -> Option<bool> {
    std::iter::zip(one, other).find(|((a, _), (b, _))| a != b).map(|((_, is_parallel), _)| *is_parallel)
}

/// One arm of a `match`.
#[derive(Debug)]
pub(crate) struct Arm {
    /// The tag. An `else` arm has none.
    pub(crate) tag: Option<Name>,
    pub(crate) body: Expr,
}

/// One arm of an `else match`.
#[derive(Debug)]
pub(crate) struct CatchArm {
    /// The failure. An `else` arm has none.
    pub(crate) failure: Option<Failure>,
    /// The place of its cause or text.
    pub(crate) span: Span,
    pub(crate) body: Expr,
}

impl Expr {
    /// Returns whether the direct parts of the expression run in parallel.
    pub(crate) fn is_parallel(&self) -> bool {
        match self.kind {
            ExprKind::Concurrent(_)
            | ExprKind::FailFast(_)
            | ExprKind::AnyOf(..)
            | ExprKind::AtLeast(..)
            | ExprKind::Disable(_)
            | ExprKind::Asynchronous(..) => true,
            ExprKind::Run(..)
            | ExprKind::Chart(_)
            | ExprKind::Skip
            | ExprKind::Never
            | ExprKind::Fail(_)
            | ExprKind::Wait(_)
            | ExprKind::Sequence(_)
            | ExprKind::Conditional(_)
            | ExprKind::Otherwise(_)
            | ExprKind::Catch(..)
            | ExprKind::Recurrent(..)
            | ExprKind::Retry(..)
            | ExprKind::Repeat(..)
            | ExprKind::Within(..)
            | ExprKind::Match(_)
            | ExprKind::Shield(..)
            | ExprKind::Using(..)
            | ExprKind::Finally(..)
            | ExprKind::Tagged(..)
            | ExprKind::With(..)
            | ExprKind::Named(..)
            | ExprKind::Broken => false,
        }
    }

    /// Returns the path to one of the direct parts.
    pub(crate) fn way_to(&self, index: usize) -> Path {
        if let ExprKind::Chart(model) = &self.kind {
            return model.runs.get(index).map(|(state, _)| model.way_to(*state)).unwrap_or_default();
        }
        vec![(index, self.is_parallel())]
    }

    /// Returns whether two of the direct parts can run at the same time.
    pub(crate) fn runs_together(&self, one: usize, other: usize) -> bool {
        are_parallel(&self.way_to(one), &self.way_to(other)).unwrap_or(false)
    }

    /// Returns the direct parts that begin together with the expression, with the same start value. An arm of a `match` is left out,
    /// because it gets only a part of the value.
    pub(crate) fn first_parts(&self) -> Vec<&Self> {
        match &self.kind {
            ExprKind::Concurrent(parts)
            | ExprKind::FailFast(parts)
            | ExprKind::AnyOf(_, parts)
            | ExprKind::AtLeast(_, parts)
            | ExprKind::Disable(parts) => parts.iter().collect(),
            ExprKind::Sequence(parts) | ExprKind::Conditional(parts) | ExprKind::Otherwise(parts) => {
                parts.iter().take(1).collect()
            }
            ExprKind::Recurrent(part, _)
            | ExprKind::Catch(part, _)
            | ExprKind::Asynchronous(part, _)
            | ExprKind::Finally(part, _)
            | ExprKind::Retry(_, _, part)
            | ExprKind::Repeat(_, part)
            | ExprKind::Within(_, part)
            | ExprKind::Shield(_, part)
            | ExprKind::Using(_, part)
            | ExprKind::Tagged(_, part) => vec![part],
            ExprKind::Run(..)
            | ExprKind::With(..)
            | ExprKind::Named(..)
            | ExprKind::Match(_)
            | ExprKind::Chart(_)
            | ExprKind::Skip
            | ExprKind::Never
            | ExprKind::Fail(_)
            | ExprKind::Wait(_)
            | ExprKind::Broken => Vec::new(),
        }
    }

    /// Returns the direct parts, from left to right.
    pub(crate) fn parts(&self) -> Vec<&Self> {
        match &self.kind {
            ExprKind::Concurrent(parts)
            | ExprKind::FailFast(parts)
            | ExprKind::AnyOf(_, parts)
            | ExprKind::AtLeast(_, parts)
            | ExprKind::Disable(parts)
            | ExprKind::Sequence(parts)
            | ExprKind::Conditional(parts)
            | ExprKind::Otherwise(parts) => parts.iter().collect(),
            ExprKind::Recurrent(first, second) | ExprKind::Finally(first, second) => vec![first, second],
            ExprKind::Retry(_, _, part)
            | ExprKind::Repeat(_, part)
            | ExprKind::Within(_, part)
            | ExprKind::Shield(_, part)
            | ExprKind::Using(_, part)
            | ExprKind::Tagged(_, part)
            | ExprKind::With(_, part)
            | ExprKind::Named(_, part) => vec![part],
            ExprKind::Match(arms) => arms.iter().map(|arm| &arm.body).collect(),
            ExprKind::Catch(first, arms) => std::iter::once(&**first).chain(arms.iter().map(|arm| &arm.body)).collect(),
            ExprKind::Asynchronous(source, pool) => std::iter::once(&**source).chain(pool).collect(),
            ExprKind::Chart(model) => model.runs.iter().map(|(_, run)| run).collect(),
            ExprKind::Run(..)
            | ExprKind::Skip
            | ExprKind::Never
            | ExprKind::Fail(_)
            | ExprKind::Wait(_)
            | ExprKind::Broken => Vec::new(),
        }
    }
}
