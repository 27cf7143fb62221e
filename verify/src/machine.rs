//! A plan as variables and guarded changes, for model checkers, which explore it themselves.
//!
//! The model is written from the rules of the manual, operator by operator, and never calls `algebra::step`. So if this model
//! and the explorer have equal state spaces, this is evidence for both.
//!
//! One reaction is a chain of silent changes: `act` is the next action, and `at` is the node that performs it. A node is called
//! to start or to stop. It calls its operands, and reports to the operator around it that it runs, or how it has ended. Nothing
//! else can happen during the chain, and exactly one silent change is possible at a time. So the chain is inert: the model and
//! the transition system are branching bisimilar, and no chain is endless.

mod groups;
mod joins;
mod rules;
mod text;
mod writer;

use crate::model::Model;
use language::plan::Plan;
use language::sites::Sites;

/// Returns a plan as a model in JANI (jani-model), of the type `mdp` with probabilities of 1.
pub fn jani(plan: &Plan, sites: &Sites) -> String {
    text::jani(&plan.name, &Machine::of(plan, sites))
}

/// Returns a plan as a specification in mCRL2: one linear process.
pub fn mcrl2(plan: &Plan, sites: &Sites) -> String {
    text::mcrl2(&Machine::of(plan, sites))
}

/// Variables and changes.
#[derive(Debug, Default)]
pub(crate) struct Machine {
    variables: Vec<Variable>,
    changes: Vec<Change>,
}

/// A variable: a number from 0, its first value, up to a largest value.
#[derive(Debug)]
struct Variable {
    name: String,
    most: u32,
}

/// The index of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Var(usize);

/// A change that can happen when all its tests hold. Without a word it is silent.
#[derive(Debug)]
struct Change {
    word: Option<String>,
    tests: Vec<Test>,
    sets: Vec<(Var, Term)>,
}

#[derive(Clone, Debug)]
enum Test {
    Is(Var, u32),
    Not(Var, u32),
    Same(Var, Var),
    Less(Var, Var),
    All(Vec<Self>),
    Any(Vec<Self>),
    Fails(Box<Self>),
}

/// A number, computed from the values before the change.
#[derive(Clone, Copy, Debug)]
enum Term {
    Number(u32),
    Of(Var),
    OneMore(Var),
    /// One less than a variable, but not below 0.
    OneLess(Var),
    /// One less than a variable if it is greater than another variable; otherwise its own value.
    MovesUp(Var, Var),
}

impl Machine {
    fn of(plan: &Plan, sites: &Sites) -> Self {
        writer::write(&Model::of_groups(plan, sites))
    }

    /// Returns a new variable for numbers up to `most`, and at least up to 1. Storm 2.0 damages the variables next to one with
    /// a single value.
    fn variable(&mut self, name: String, most: usize) -> Var {
        self.variables.push(Variable { name, most: u32::try_from(most.max(1)).unwrap_or(u32::MAX) });
        Var(self.variables.len() - 1)
    }
}
