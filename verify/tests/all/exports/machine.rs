//! An exported model as a reader has read it, and its state space by the semantics of its language.

use std::collections::{BTreeMap, BTreeSet};
use verify::Transitions;

/// The longest chain of silent changes.
const CHAIN_MAX: usize = 100_000;

#[derive(Clone, Debug)]
pub(crate) enum Expr {
    Number(i64),
    Variable(usize),
    /// A sign of mCRL2: `&&` `||` `!` `==` `!=` `<` `+` `-` `if`.
    Of(&'static str, Vec<Self>),
}

#[derive(Debug)]
pub(crate) struct Variable {
    pub(crate) name: String,
    pub(crate) first: i64,
    /// The greatest number, if the language has one.
    pub(crate) most: Option<i64>,
}

#[derive(Debug)]
pub(crate) struct Change {
    /// Nothing if the change is silent.
    pub(crate) word: Option<String>,
    pub(crate) guard: Expr,
    pub(crate) sets: Vec<(usize, Expr)>,
}

#[derive(Debug)]
pub(crate) struct Machine {
    variables: Vec<Variable>,
    changes: Vec<Change>,
    /// The index of the variable `todo`.
    todo: usize,
    /// The possible changes, by the value of the variable `todo` in their guards.
    by_todo: BTreeMap<i64, Vec<usize>>,
}

type State = Vec<i64>;

impl Expr {
    fn of(&self, state: &State) -> i64 {
        let (sign, of) = match self {
            Self::Number(number) => return *number,
            Self::Variable(variable) => return state[*variable],
            Self::Of(sign, of) => (*sign, of),
        };
        let value = |index: usize| of[index].of(state);
        match sign {
            "&&" => i64::from(of.iter().all(|part| part.of(state) != 0)),
            "||" => i64::from(of.iter().any(|part| part.of(state) != 0)),
            "!" => i64::from(value(0) == 0),
            "==" => i64::from(value(0) == value(1)),
            "!=" => i64::from(value(0) != value(1)),
            "<" => i64::from(value(0) < value(1)),
            "+" => value(0) + value(1),
            "-" => value(0) - value(1),
            "if" => value(if value(0) == 0 { 2 } else { 1 }),
            _ => panic!("an unknown sign `{sign}`"),
        }
    }

    /// Returns the number that a variable must have for this expression to hold, if the expression tests it.
    fn asks(&self, variable: usize) -> Option<i64> {
        match self {
            Self::Of("&&", of) => of.iter().find_map(|part| part.asks(variable)),
            Self::Of("==", of) => match of.as_slice() {
                [Self::Variable(own), Self::Number(number)] if *own == variable => Some(*number),
                _ => None,
            },
            Self::Of(..) | Self::Number(_) | Self::Variable(_) => None,
        }
    }
}

impl Machine {
    /// Sorts the changes, so that few are considered in each state.
    pub(crate) fn new(variables: Vec<Variable>, changes: Vec<Change>) -> Self {
        let todo = variables.iter().position(|variable| variable.name == "todo").expect("there is a `todo`");
        let mut by_todo: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
        for (index, change) in changes.iter().enumerate() {
            let asked = change.guard.asks(todo).expect("every guard asks for a `todo`");
            by_todo.entry(asked).or_default().push(index);
        }
        Self { variables, changes, todo, by_todo }
    }

    fn first(&self) -> State {
        self.variables.iter().map(|variable| variable.first).collect()
    }

    fn possible(&self, state: &State) -> Vec<&Change> {
        let all = self.by_todo.get(&state[self.todo]).into_iter().flatten().map(|&index| &self.changes[index]);
        all.filter(|change| change.guard.of(state) != 0).collect()
    }

    fn after(&self, state: &State, change: &Change) -> Result<State, String> {
        let mut next = state.clone();
        for (variable, expr) in &change.sets {
            next[*variable] = expr.of(state);
            let Variable { name, most, .. } = &self.variables[*variable];
            if next[*variable] < 0 || most.is_some_and(|most| next[*variable] > most) {
                return Err(format!("`{name}` becomes {}", next[*variable]));
            }
        }
        Ok(next)
    }

    /// Follows the silent changes to a state that has none. There must be only one way to it.
    fn settled(&self, mut state: State) -> Result<State, String> {
        for _ in 0..CHAIN_MAX {
            let possible = self.possible(&state);
            if possible.iter().all(|change| change.word.is_some()) {
                return Ok(state);
            }
            let [change] = possible.as_slice() else {
                return Err(format!("{} changes beside a silent one: {}", possible.len(), self.told(&state)));
            };
            state = self.after(&state, change)?;
        }
        Err("a chain of silent changes without end".to_owned())
    }

    fn told(&self, state: &State) -> String {
        let told = self.variables.iter().zip(state).filter(|(_, value)| **value != 0);
        told.map(|(variable, value)| format!("{} {value}", variable.name)).collect::<Vec<_>>().join(", ")
    }

    /// Walks through both models, state by state. Both are deterministic except for inert silent changes. So they are
    /// branching bisimilar if the same words are possible in all reached pairs of states, and no chain of silent
    /// changes is endless. Returns the number of pairs.
    pub(crate) fn compare(&self, all: &Transitions, named: impl Fn(&str) -> String) -> Result<usize, String> {
        let mut edges: BTreeMap<u32, BTreeMap<String, u32>> = BTreeMap::new();
        for (from, word, to) in &all.all {
            if edges.entry(*from).or_default().insert(named(word), *to).is_some() {
                return Err(format!("the explorer has `{word}` twice in one state"));
            }
        }
        let none = BTreeMap::new();
        let mut known = BTreeSet::new();
        let mut open = vec![(0, self.settled(self.first())?)];
        while let Some((at, state)) = open.pop() {
            if !known.insert((at, state.clone())) {
                continue;
            }
            let theirs = edges.get(&at).unwrap_or(&none);
            let mut ours = BTreeSet::new();
            for change in self.possible(&state) {
                let word = change.word.clone().unwrap_or_default();
                let next = self.settled(self.after(&state, change)?)?;
                let Some(target) = theirs.get(&word) else {
                    return Err(format!("only the export has `{word}` in {}", self.told(&state)));
                };
                open.push((*target, next));
                if !ours.insert(word.clone()) {
                    return Err(format!("the export has `{word}` twice in {}", self.told(&state)));
                }
            }
            if let Some(word) = theirs.keys().find(|word| !ours.contains(*word)) {
                return Err(format!("only the explorer has `{word}` in {}", self.told(&state)));
            }
        }
        Ok(known.len())
    }
}
