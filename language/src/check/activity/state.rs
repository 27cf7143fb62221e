//! States, with the kind and the run of each.

use super::{ActivityReader, question};
use crate::algebra::Value;
use crate::automaton::{ChartState, History, STATES_MAX, StateKind, ValueSource};
use crate::check::expression;
use crate::check::names::twice;
use crate::check::spec::{Expr, ExprKind, StartValue, ValueKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::plan::text_value;
use crate::syntax::SyntaxKind::{self, Text};
use crate::syntax::ast::{Name, Node};

/// The words before the name of a state, and the name.
struct Head {
    words: Vec<Name>,
    name: Name,
}

impl Head {
    fn of(node: &Node) -> Option<Self> {
        let mut words: Vec<Name> = node.names().collect();
        let name = words.pop()?;
        Some(Self { words, name }).filter(|head| !head.words.is_empty())
    }

    fn has(&self, word: &str) -> bool {
        self.words.iter().any(|other| other.text == word)
    }
}

impl ActivityReader<'_, '_> {
    /// Reads all states, each before the states inside it. Then reads their runs and their initial states.
    pub(super) fn states(&mut self, node: &Node) {
        let name = node.title().map_or_else(String::new, |name| name.text);
        self.add_state(node, ChartState::compound(&name, None, 0));
        self.inner_states(node, 0);
        question::add_states(self, node, 0);
        if self.nodes.len() > STATES_MAX {
            let message = format!("more than {STATES_MAX} states");
            self.report(Diagnostic::new(Code::E0701, node.span(), message));
        }
        for state in 0..self.nodes.len() {
            self.run_of(state);
            self.kind_of(state);
        }
    }

    pub(super) fn add_state(&mut self, node: &Node, state: ChartState) -> usize {
        self.nodes.push(node.clone());
        self.chart.states.push(state);
        self.nodes.len() - 1
    }

    fn inner_states(&mut self, node: &Node, parent: usize) {
        for inner in node.children_of(SyntaxKind::State).collect::<Vec<_>>() {
            let Some(head) = Head::of(&inner) else { continue };
            let number = self.add_state(&inner, ChartState::atomic(&head.name.text, parent));
            if let Some((_, first)) = self.names.get(&head.name.text) {
                let diagnostic = twice("state", &head.name.text, head.name.span, first.span);
                self.report(diagnostic.help("each state of an activity has a name of its own"));
            } else {
                self.names.insert(head.name.text.clone(), (number, head.name));
            }
            self.inner_states(&inner, number);
            question::add_states(self, &inner, number);
        }
    }

    /// Reads the run of a state, with its start value.
    fn run_of(&mut self, state: usize) {
        let node = self.nodes[state].clone();
        let mut runs = node.children_of(SyntaxKind::StateRun);
        let Some(run) = runs.next() else { return };
        if let Some(second) = runs.next() {
            let message = "a state can have only one `run`";
            let help = "run both expressions together: `run a, b;`";
            self.report(Diagnostic::new(Code::E0902, second.span(), message).help(help));
        }
        let Some(first) = run.children().next() else { return };
        let mut expression = expression::expression(&first, self.group);
        let source = take_kept(&mut expression).map(ValueSource::Slot);
        self.chart.states[state].run = Some(source.unwrap_or(ValueSource::Constant(Value::EMPTY)));
        for name in left_over(&expression) {
            let message = format!("the value of `{}` can start only the whole run", name.text);
            let found = Diagnostic::new(Code::E0904, name.span, message).label("is a variable of the activity");
            self.report(
                found.help(format!("write `run (...) with {};`, or move this part to a state of its own", name.text)),
            );
        }
        self.runs.push((state, expression));
    }

    /// Reads a value that is kept or sent, or that starts a run. `event` is the name of the value of the event.
    pub(super) fn value_of(&mut self, node: &Node, event: Option<&str>) -> Option<ValueSource> {
        let constant = node.child(SyntaxKind::Constant);
        if let Some(constant) = &constant {
            if let Some(text) = constant.token(Text) {
                return Some(ValueSource::Constant(text_value(&text.content())));
            }
            if constant.compact_text() == "()" {
                return Some(ValueSource::Constant(Value::EMPTY));
            }
        }
        let name = node.names().next().filter(|_| constant.is_none() && node.children().next().is_none());
        let Some(name) = name else {
            let message = format!("`{}` cannot be kept or sent as a value", super::formula::text(node));
            let help = "use a text, an opaque variable, or the value of the event";
            self.report(Diagnostic::new(Code::E0904, node.span(), message).help(help));
            return None;
        };
        if event == Some(name.text.as_str()) {
            return Some(ValueSource::Event);
        }
        if let Some(slot) = self.kept(&name.text) {
            return Some(ValueSource::Slot(slot));
        }
        let named = self.group.scope.consts.get(&name.text).and_then(|named| named.values.first());
        if let Some(ValueKind::Constant(constant)) = named.map(|value| &value.kind) {
            return Some(ValueSource::Constant(constant_value(constant)));
        }
        if self.variables.contains_key(&name.text) {
            let message =
                format!("`{}` is a number of this activity, so it cannot be kept or sent as a value", name.text);
            self.report(Diagnostic::new(Code::E0904, name.span, message));
            return None;
        }
        self.report_unknown(&name, "a value");
        None
    }

    /// Reads the kind of a state, and its initial state.
    fn kind_of(&mut self, state: usize) {
        let node = self.nodes[state].clone();
        if node.kind() == SyntaxKind::Asking {
            return;
        }
        let inner: Vec<usize> = (0..self.nodes.len())
            .filter(|&other| self.chart.states[other].parent == Some(state) && other != state)
            .collect();
        let head = if state == 0 { None } else { Head::of(&node) };
        let name = head.as_ref().map(|head| head.name.clone()).or_else(|| node.title());
        let Some(name) = name else { return };
        let has = |word: &str| head.as_ref().is_some_and(|head| head.has(word));
        self.check_place(state, &name);
        let kind = if has("history") {
            let depth = if has("deep") { History::Deep } else { History::Shallow };
            self.history(&node, &name, depth)
        } else if has("final") {
            Some(StateKind::Final)
        } else if has("suspended") {
            Some(StateKind::Suspended)
        } else if has("parallel") {
            self.misplaced(&inner, "initial", "the states inside a `parallel state` begin together");
            Some(StateKind::Parallel)
        } else if inner.is_empty() && state > 0 {
            Some(StateKind::Atomic)
        } else {
            self.begins(&inner, &name).map(|initial| StateKind::Compound { initial: vec![initial] })
        };
        match kind {
            Some(kind) => self.chart.states[state].kind = kind,
            None => self.is_sound = false,
        }
    }

    /// Returns the initial state of a state with inner states.
    fn begins(&mut self, inner: &[usize], name: &Name) -> Option<usize> {
        let is = |state: &&usize, word: &str| Head::of(&self.nodes[**state]).is_some_and(|head| head.has(word));
        let mut initial = inner.iter().filter(|state| is(state, "initial"));
        let (first, second) = (initial.next().copied(), initial.next().copied());
        if let (Some(first), Some(second)) = (first, second) {
            let place = |state: usize| Head::of(&self.nodes[state]).map(|head| head.name.span);
            let (first_place, second_place) = (place(first)?, place(second)?);
            let message = format!("`{}` can begin in only one state, but this is a second `initial` state", name.text);
            let diagnostic = Diagnostic::new(Code::E0902, second_place, message);
            self.report(diagnostic.reason(first_place, "the first `initial` state"));
        }
        if first.is_none() {
            let message = match inner.is_empty() {
                true => format!("`{}` has no states", name.text),
                false => format!("`{}` has no `initial` state", name.text),
            };
            let diagnostic = Diagnostic::new(Code::E0902, name.span, message);
            self.report(diagnostic.help("write `initial state NAME { ... }`"));
        }
        first
    }

    fn history(&mut self, node: &Node, name: &Name, depth: History) -> Option<StateKind> {
        let target = node.child(SyntaxKind::Target).and_then(|target| target.names().next());
        let Some(target) = target else {
            let message = format!("the history `{}` does not name its default state", name.text);
            self.report(Diagnostic::new(Code::E0902, name.span, message).help("write `history NAME -> STATE;`"));
            return None;
        };
        Some(StateKind::History { depth, default: vec![self.state_named(&target)?] })
    }

    /// Checks whether the parts of a state fit its kind and its place.
    fn check_place(&mut self, state: usize, name: &Name) {
        let Some(head) = Head::of(&self.nodes[state]).filter(|_| state > 0) else { return };
        let node = self.nodes[state].clone();
        let parent = self.chart.states[state].parent.map(|parent| self.nodes[parent].clone());
        let is_region = parent.is_some_and(|parent| {
            parent.kind() == SyntaxKind::State && Head::of(&parent).is_some_and(|head| head.has("parallel"))
        });
        let mut problem = None;
        for (word, has_run, has_inner) in
            [("final", false, false), ("suspended", true, false), ("history", false, false)]
        {
            if !head.has(word) {
                continue;
            }
            if is_region && word != "history" {
                problem = Some(format!("`{}` stands in a `parallel state` and cannot be {word}", name.text));
            } else if !has_inner && node.child(SyntaxKind::State).is_some() {
                problem = Some(format!("`{}` is {word} and cannot have states inside", name.text));
            } else if !has_run && node.child(SyntaxKind::StateRun).is_some() {
                problem = Some(format!("`{}` is {word} and cannot run anything", name.text));
            } else if word == "history" && node.child(SyntaxKind::Transition).is_some() {
                problem = Some(format!("`{}` is a history and cannot have transitions", name.text));
            }
        }
        if let Some(problem) = problem {
            self.report(Diagnostic::new(Code::E0902, name.span, problem));
        }
    }

    fn misplaced(&mut self, states: &[usize], word: &str, why: &str) {
        for &state in states {
            let Some(head) = Head::of(&self.nodes[state]) else { continue };
            if let Some(found) = head.words.iter().find(|other| other.text == word) {
                self.report(Diagnostic::new(Code::E0902, found.span, why).help(format!("leave `{word}` away")));
            }
        }
    }
}

/// Removes the variable that starts the first part of an expression and returns it. So the state gives its value to the whole run.
fn take_kept(expr: &mut Expr) -> Option<usize> {
    match &mut expr.kind {
        ExprKind::With(StartValue::Kept(number, _), part) => {
            let number = *number;
            let inner = Expr { span: part.span, kind: std::mem::replace(&mut part.kind, ExprKind::Broken) };
            *expr = inner;
            Some(number)
        }
        ExprKind::Sequence(parts) | ExprKind::Conditional(parts) | ExprKind::Otherwise(parts) => {
            parts.first_mut().and_then(take_kept)
        }
        ExprKind::Finally(part, _)
        | ExprKind::Catch(part, _)
        | ExprKind::Within(_, part)
        | ExprKind::Shield(_, part)
        | ExprKind::Using(_, part)
        | ExprKind::Tagged(_, part) => take_kept(part),
        ExprKind::With(..)
        | ExprKind::Named(..)
        | ExprKind::Run(..)
        | ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Disable(_)
        | ExprKind::Recurrent(..)
        | ExprKind::Retry(..)
        | ExprKind::Repeat(..)
        | ExprKind::Asynchronous(..)
        | ExprKind::Match(_)
        | ExprKind::Chart(_)
        | ExprKind::Skip
        | ExprKind::Never
        | ExprKind::Fail(_)
        | ExprKind::Wait(_)
        | ExprKind::Broken => None,
    }
}

/// Returns the variables that start other parts of an expression.
fn left_over(expr: &Expr) -> Vec<Name> {
    let own = if let ExprKind::With(StartValue::Kept(_, name), _) = &expr.kind { Some(name.clone()) } else { None };
    own.into_iter().chain(expr.parts().into_iter().flat_map(left_over)).collect()
}

/// Returns the bytes of a named constant, in the form that a program reads.
fn constant_value(constant: &Constant) -> Value {
    match constant {
        Constant::Text(text) => text_value(text),
        Constant::Number(number) => Value::new(&number.to_le_bytes()),
        Constant::Truth(truth) => Value::new(&[u8::from(*truth)]),
        Constant::Secret(_) => Value::EMPTY,
    }
}
