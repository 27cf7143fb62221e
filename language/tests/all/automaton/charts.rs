//! Random activities: small trees with all kinds of states, triggers and actions.

use crate::random::Random;
use language::Layout;
use language::algebra::Value;
use language::automaton::{
    Action, Chart, ChartState, Failure, Formula, Fragment, History, Relation, StateKind, Target, Transition, Trigger,
    ValueSource, Variable,
};
use language::script::{Script, ScriptInput, ScriptResult, ScriptSource};
use std::time::Duration;

pub(super) const FILTERS: usize = 2;
pub(super) const NOTICES: usize = 2;
pub(super) const PORTS: usize = 2;
pub(super) const TAGS: [&str; 2] = ["found", "lost"];
/// The scripts: a formula, a kept number, an error, and a script without an end.
pub(super) const SUM: &str = "v0 * 2 + v1";
pub(super) const COPY: &str = "s0";
pub(super) const THROW: &str = "throw \"no\"";
pub(super) const ENDLESS: &str = "fn again() { again() }\nagain()";
const SIGNALS: usize = 3;
const VARIABLES: usize = 2;
const SLOTS: usize = 2;

/// Returns a random chart with about `size` states. Some are refused by `Automaton::new`.
pub(super) fn chart(random: &mut Random, size: usize) -> Chart {
    let mut maker = Maker { random, chart: Chart { slots: SLOTS, ports: vec![1, 2], ..Chart::default() } };
    maker.chart.variables = (0..VARIABLES)
        .map(|number| Variable { name: format!("v{number}"), min: -1, max: 2, initial: 0, names: Vec::new() })
        .collect();
    maker.chart.scripts = scripts();
    maker.grow(None, size, 1);
    maker.begin();
    for state in 0..maker.chart.states.len() {
        maker.furnish(state);
    }
    let mut transitions = std::mem::take(&mut maker.chart.transitions);
    transitions.sort_by_key(|transition| transition.source);
    Chart { transitions, ..maker.chart }
}

fn scripts() -> Vec<Script> {
    let number = || Layout::Number { of: "Number".to_owned() };
    let input = |name: &str, source: ScriptSource| ScriptInput { name: name.to_owned(), source };
    let inputs = || {
        let variables = (0..VARIABLES).map(|number| input(&format!("v{number}"), ScriptSource::Variable(number)));
        variables.collect()
    };
    let kept = vec![input("s0", ScriptSource::Slot { slot: 0, layout: number() })];
    let all = [(SUM, inputs()), (COPY, kept), (THROW, vec![]), (ENDLESS, vec![])];
    let result = || ScriptResult { variable: "s".to_owned(), of: "Number".to_owned(), layout: number() };
    all.map(|(text, inputs)| Script { text: text.to_owned(), inputs, result: result() }).to_vec()
}

struct Maker<'a> {
    random: &'a mut Random,
    chart: Chart,
}

impl Maker<'_> {
    /// Adds a state with the states inside it.
    fn grow(&mut self, parent: Option<usize>, size: usize, depth: usize) {
        let number = self.chart.states.len();
        let name = format!("s{number}");
        let inside_parallel = parent.is_none_or(|parent| self.chart.states[parent].kind == StateKind::Parallel);
        let state = ChartState { name, parent, kind: StateKind::Atomic, run: None, entry: vec![], exit: vec![] };
        self.chart.states.push(state);
        if size < 2 || depth > 5 {
            if !inside_parallel {
                let kinds = [StateKind::Final, StateKind::Suspended];
                let which = self.random.below(6);
                self.chart.states[number].kind = kinds.get(which).cloned().unwrap_or(StateKind::Atomic);
            }
            return;
        }
        let is_parallel = self.random.one_in(3);
        self.chart.states[number].kind =
            if is_parallel { StateKind::Parallel } else { StateKind::Compound { initial: vec![] } };
        let children = 1 + self.random.below(size.min(4));
        for _ in 0..children {
            self.grow(Some(number), (size - 1) / children, depth + 1);
        }
        if self.random.one_in(3) {
            let depth = if self.random.one_in(2) { History::Shallow } else { History::Deep };
            let mut history = ChartState::atomic(&format!("h{number}"), number);
            history.kind = StateKind::History { depth, default: vec![] };
            self.chart.states.push(history);
        }
    }

    /// Chooses where compound states and histories lead.
    fn begin(&mut self) {
        for state in 0..self.chart.states.len() {
            let kind = match self.chart.states[state].kind.clone() {
                StateKind::Compound { .. } => StateKind::Compound { initial: self.inner(state) },
                StateKind::History { depth, .. } => {
                    let parent = self.chart.states[state].parent.expect("a history has a parent");
                    StateKind::History { depth, default: self.inner(parent) }
                }
                other => other,
            };
            self.chart.states[state].kind = kind;
        }
    }

    /// A state or two inside a state, mostly the first one.
    fn inner(&mut self, state: usize) -> Vec<usize> {
        let is_inside = |&inner: &usize| {
            std::iter::successors(Some(inner), |&of| self.chart.states[of].parent).skip(1).any(|of| of == state)
        };
        let all: Vec<usize> = (0..self.chart.states.len()).filter(is_inside).collect();
        let first = if self.random.one_in(4) { all[self.random.below(all.len())] } else { all[0] };
        if self.random.one_in(6) { vec![first, all[self.random.below(all.len())]] } else { vec![first] }
    }

    /// Gives a state its run, actions and transitions.
    fn furnish(&mut self, state: usize) {
        if matches!(self.chart.states[state].kind, StateKind::History { .. }) {
            return;
        }
        self.chart.states[state].entry = self.actions(3);
        self.chart.states[state].exit = self.actions(3);
        if self.chart.states[state].kind == StateKind::Final {
            return;
        }
        if self.random.one_in(2) {
            let slot = ValueSource::Slot(self.random.below(SLOTS));
            let constant = ValueSource::Constant(Value::new(b"go"));
            self.chart.states[state].run = Some(if self.random.one_in(2) { slot } else { constant });
        }
        for _ in 0..self.random.below(4) {
            let transition = self.transition(state);
            self.chart.transitions.push(transition);
        }
    }

    fn transition(&mut self, source: usize) -> Transition {
        let trigger = self.trigger(source);
        let is_free = trigger == Trigger::Always;
        // Most activities shall come to rest.
        let rarity = if is_free { 8 } else { 2 };
        let guard = (is_free || self.random.one_in(3)).then(|| self.formula(2));
        let target = match self.random.below(24) {
            0..=3 => Target::Stay,
            4 if self.random.below(2) == 0 => {
                let of = Box::new(self.value());
                Target::Done(ValueSource::Tagged { tag: "held".to_owned(), of })
            }
            4 => Target::Done(self.value()),
            5 => Target::Abort("enough".into()),
            6..=8 if self.chart.states[source].kind != StateKind::Suspended => self.target(),
            6..=8 => Target::Resume,
            _ => self.target(),
        };
        Transition { source, trigger, guard, target, internal: self.random.one_in(3), actions: self.actions(rarity) }
    }

    fn target(&mut self) -> Target {
        let count = self.chart.states.len();
        let any = |random: &mut Random| if count == 1 { 0 } else { 1 + random.below(count - 1) };
        let first = any(self.random);
        let both = self.random.one_in(5);
        Target::States(if both { vec![first, any(self.random)] } else { vec![first] })
    }

    fn trigger(&mut self, source: usize) -> Trigger {
        let state = &self.chart.states[source];
        let has_inner = matches!(state.kind, StateKind::Compound { .. } | StateKind::Parallel);
        let has_run = state.run.is_some();
        let seconds = Duration::from_secs(1 + self.random.below(3) as u64);
        match self.random.below(16) {
            0..=1 => Trigger::Always,
            2..=4 => Trigger::Message {
                port: self.random.below(PORTS),
                filter: self.random.one_in(2).then(|| self.random.below(FILTERS)),
            },
            5 => Trigger::Any,
            6..=7 => Trigger::Signal(self.random.below(SIGNALS)),
            8 => Trigger::Notice(self.random.below(NOTICES)),
            9..=10 if has_run => Trigger::Done(self.random.one_in(2).then(|| TAGS[self.random.below(2)].to_owned())),
            11 => Trigger::Aborted(self.random.one_in(2).then(|| self.failure())),
            12 if has_inner => Trigger::Complete,
            13 => Trigger::After(seconds),
            14 => Trigger::Every(seconds),
            _ => Trigger::Message { port: 0, filter: None },
        }
    }

    fn failure(&mut self) -> Failure {
        let failures = [
            Failure::Reported,
            Failure::Busy,
            Failure::StopUnconfirmed,
            Failure::ServiceEnded,
            Failure::Failed("f".into()),
            Failure::NoMatch,
            Failure::Timeout,
            Failure::Crash,
            Failure::HostLost,
        ];
        failures[self.random.below(failures.len())].clone()
    }

    fn actions(&mut self, rarity: usize) -> Vec<Action> {
        if !self.random.one_in(rarity) {
            return vec![];
        }
        (0..=self.random.below(2)).map(|_| self.action()).collect()
    }

    fn action(&mut self) -> Action {
        match self.random.below(7) {
            0..=1 => Action::Assign { variable: self.random.below(VARIABLES), formula: self.formula(2) },
            2 => Action::Keep { slot: self.random.below(SLOTS), value: self.value() },
            // Signals that raise signals fill whole reactions, and each costs as much as a thousand other events.
            3 if self.random.one_in(4) => Action::Raise(self.random.below(SIGNALS)),
            4 if self.random.one_in(2) => {
                Action::Log(vec![Fragment::Name(self.formula(2), vec!["slow".into(), "fast".into()])])
            }
            4 => Action::Log(vec![Fragment::Text("n ".into()), Fragment::Number(self.formula(2))]),
            5 => {
                // Most scripts shall give a value.
                let scripts = if self.random.one_in(4) { self.chart.scripts.len() } else { 2 };
                Action::Compute { slot: self.random.below(SLOTS), script: self.random.below(scripts) }
            }
            _ => Action::Send { output: self.random.below(9), value: self.value() },
        }
    }

    fn value(&mut self) -> ValueSource {
        match self.random.below(5) {
            0 => ValueSource::Event,
            1 => ValueSource::Slot(self.random.below(SLOTS)),
            2 => ValueSource::Text(vec![Fragment::Text("n ".into()), Fragment::Number(self.formula(2))]),
            3 => ValueSource::Number(self.formula(2)),
            _ => ValueSource::Constant(Value::new(b"k")),
        }
    }

    fn formula(&mut self, depth: usize) -> Formula {
        if depth == 0 || self.random.one_in(3) {
            return match self.random.below(4) {
                0 => Formula::Number(self.random.below(4) as i64 - 1),
                1 => Formula::In(self.random.below(self.chart.states.len())),
                _ => Formula::Variable(self.random.below(VARIABLES)),
            };
        }
        match self.random.below(9) {
            0 => Formula::Not(Box::new(self.formula(depth - 1))),
            1 => self.both(depth, Formula::And),
            2 => self.both(depth, Formula::Or),
            3..=4 => self.both(depth, |a, b| Formula::Compare(Relation::Less, a, b)),
            5 => self.both(depth, |a, b| Formula::Compare(Relation::Equal, a, b)),
            6 => self.both(depth, |a, b| Formula::Compare(Relation::AtMost, a, b)),
            7 => self.both(depth, Formula::Add),
            _ => match self.random.below(2) {
                0 => self.both(depth, Formula::Subtract),
                _ => self.both(depth, Formula::Multiply),
            },
        }
    }
    /// Makes a formula of two.
    fn both(&mut self, depth: usize, make: impl Fn(Box<Formula>, Box<Formula>) -> Formula) -> Formula {
        let (a, b) = (Box::new(self.formula(depth - 1)), Box::new(self.formula(depth - 1)));
        make(a, b)
    }
}
