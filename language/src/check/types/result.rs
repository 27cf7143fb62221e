//! Compares the types of results that have names with the start values of the programs that get them.

use super::start::{Taker, declared, nothing, takers};
use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Arm, Expr, ExprKind, Kind, Module, Outcome, Param, Process, Spec, StartValue, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::Name;
use std::collections::BTreeMap;

/// The values with which an expression may be done, or may be started.
#[derive(Clone, Debug, Default)]
struct Left<'a> {
    /// The outcomes, each with its tag and the type of its value, by the places of their declarations.
    outcomes: BTreeMap<Span, &'a Outcome>,
    /// Whether an arm of a `match` has removed the tag.
    is_bare: bool,
    /// Whether any other value is possible, because an interface does not declare the values.
    is_open: bool,
    /// Whether there may be no value.
    is_nothing: bool,
}

impl Left<'_> {
    fn open() -> Self {
        Self { is_open: true, ..Self::default() }
    }

    fn nothing() -> Self {
        Self { is_nothing: true, ..Self::default() }
    }

    fn or(mut self, other: Self) -> Self {
        self.outcomes.extend(other.outcomes);
        self.is_open |= other.is_open;
        self.is_nothing |= other.is_nothing;
        self
    }
}

/// Compares each use of a result with its type. At this point, no group contains itself.
pub(in crate::check) fn check(spec: &Spec, diagnostics: &mut Diagnostics) {
    let mut ends = vec![None; spec.processes.len()];
    for process in spec.processes.iter().filter(|process| !process.damage.actions) {
        if let Some(actions) = process.actions.as_ref().filter(|actions| names_results(actions)) {
            ResultCheck { spec, process, results: Vec::new(), ends: &mut ends, diagnostics }
                .visit(actions, &Left::open());
        }
    }
}

/// Returns the type of the value of an outcome with which an expression may be done. Returns none if the type is not
/// known, or if there are several types.
pub(super) fn outcome_kind<'a>(spec: &'a Spec, process: &'a Process, expr: &'a Expr, tag: &str) -> Option<&'a Kind> {
    let left = left(spec, process, expr, &mut vec![None; spec.processes.len()]);
    let mut kinds =
        left.outcomes.values().filter(|outcome| outcome.name.text == tag).map(|outcome| outcome.kind.as_ref());
    let first = kinds.next().flatten().filter(|_| !left.is_open)?;
    kinds.all(|other| other.is_some_and(|other| spec.is_same(first, other))).then_some(first)
}

fn names_results(expr: &Expr) -> bool {
    matches!(expr.kind, ExprKind::Named(..)) || expr.parts().into_iter().any(names_results)
}

/// Returns the values with which a group may be done. At this point, no group contains itself.
fn of_process<'a>(spec: &'a Spec, process: usize, known: &mut Vec<Option<Left<'a>>>) -> Left<'a> {
    if let Some(left) = &known[process] {
        return left.clone();
    }
    let source = &spec.processes[process];
    let left = match source.actions.as_ref().filter(|_| !source.damage.actions) {
        Some(actions) => left(spec, source, actions, known),
        None => Left::open(),
    };
    known[process] = Some(left.clone());
    left
}

/// Returns the values with which an expression may be done. `known` has the values of groups.
fn left<'a>(spec: &'a Spec, process: &'a Process, expr: &'a Expr, known: &mut Vec<Option<Left<'a>>>) -> Left<'a> {
    let mut rest = |part: &'a Expr| left(spec, process, part, known);
    match &expr.kind {
        ExprKind::Run(slot, _) => match process.instances[*slot].target {
            Target::Module(module) if spec.modules[module].is_damaged => Left::open(),
            Target::Module(module) => declared_by(&spec.modules[module].outcomes),
            Target::Process(inner) => of_process(spec, inner, known),
            Target::Unknown => Left::open(),
        },
        ExprKind::Chart(model) => declared_by(&model.outcomes),
        ExprKind::Sequence(parts) | ExprKind::Conditional(parts) => parts.last().map_or_else(Left::open, rest),
        ExprKind::Finally(first, _) => rest(first),
        ExprKind::Disable(_)
        | ExprKind::Otherwise(_)
        | ExprKind::Match(_)
        | ExprKind::Catch(..)
        | ExprKind::Retry(..)
        | ExprKind::Within(..)
        | ExprKind::Shield(..)
        | ExprKind::Using(..)
        | ExprKind::With(..)
        | ExprKind::Named(..) => expr.parts().into_iter().map(rest).fold(Left::default(), Left::or),
        ExprKind::Repeat(until, part) => {
            let inner = rest(part);
            let is_end = |outcome: &Outcome| until.iter().any(|name| name.text == outcome.name.text);
            Left { outcomes: inner.outcomes.into_iter().filter(|(_, outcome)| is_end(outcome)).collect(), ..inner }
        }
        ExprKind::Never | ExprKind::Fail(_) | ExprKind::Recurrent(..) | ExprKind::Asynchronous(..) => Left::default(),
        ExprKind::Skip | ExprKind::Wait(_) => Left::nothing(),
        // Several values together, or a value with another tag.
        ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Tagged(..)
        | ExprKind::Broken => Left::open(),
    }
}

/// Without declared outcomes, a process may leave any value.
fn declared_by(outcomes: &[Outcome]) -> Left<'_> {
    let all = outcomes.iter().map(|outcome| (outcome.name.span, outcome));
    Left { outcomes: all.collect(), is_open: outcomes.is_empty(), ..Left::default() }
}

struct ResultCheck<'a, 'd> {
    spec: &'a Spec,
    process: &'a Process,
    /// The results that have names at this place, the outermost first.
    results: Vec<(&'a Name, Left<'a>)>,
    /// The values with which each visited group may be done.
    ends: &'d mut Vec<Option<Left<'a>>>,
    diagnostics: &'d mut Diagnostics,
}

impl<'a> ResultCheck<'a, '_> {
    /// Checks an expression that may be started with the values of `start`.
    fn visit(&mut self, expr: &'a Expr, start: &Left<'a>) {
        let (open, nothing) = (Left::open(), Left::nothing());
        match &expr.kind {
            ExprKind::Named(name, part) => {
                self.results.push((name, start.clone()));
                self.visit(part, &nothing);
                self.results.pop();
            }
            ExprKind::With(given, part) => {
                let StartValue::Result(name) = given else { return self.visit(part, &open) };
                let result = self.results.iter().rev().find(|(known, _)| known.text == name.text);
                let result = result.map_or(open, |(_, left)| left.clone());
                self.compare(name, &result, part);
                self.visit(part, &result);
            }
            ExprKind::Match(arms) => self.visit_arms(arms, start),
            ExprKind::Conditional(parts) => {
                let mut start = start.clone();
                for part in parts {
                    self.visit(part, &start);
                    start = self.left(part);
                }
            }
            ExprKind::Recurrent(first, second) => {
                self.visit(first, &start.clone().or(nothing));
                let start = self.left(first);
                self.visit(second, &start);
            }
            ExprKind::Asynchronous(source, pool) => {
                self.visit(source, &start.clone().or(nothing));
                // The places differ only in their instances, so one of them is enough.
                let start = self.left(source);
                pool.iter().take(1).for_each(|part| self.visit(part, &start));
            }
            ExprKind::Sequence(_) | ExprKind::Otherwise(_) | ExprKind::Catch(..) | ExprKind::Finally(..) => {
                for (index, part) in expr.parts().into_iter().enumerate() {
                    self.visit(part, if index == 0 { start } else { &nothing });
                }
            }
            ExprKind::Retry(times, _, part) if *times > 0 => self.visit(part, &start.clone().or(nothing)),
            ExprKind::Repeat(_, part) => self.visit(part, &start.clone().or(nothing)),
            ExprKind::Chart(_) => expr.parts().into_iter().for_each(|run| self.visit(run, &open)),
            ExprKind::Retry(..)
            | ExprKind::Within(..)
            | ExprKind::Shield(..)
            | ExprKind::Using(..)
            | ExprKind::Tagged(..)
            | ExprKind::Concurrent(_)
            | ExprKind::FailFast(_)
            | ExprKind::AnyOf(..)
            | ExprKind::AtLeast(..)
            | ExprKind::Disable(_)
            | ExprKind::Run(..)
            | ExprKind::Skip
            | ExprKind::Never
            | ExprKind::Fail(_)
            | ExprKind::Wait(_)
            | ExprKind::Broken => expr.parts().into_iter().for_each(|part| self.visit(part, start)),
        }
    }

    fn left(&mut self, expr: &'a Expr) -> Left<'a> {
        left(self.spec, self.process, expr, self.ends)
    }

    fn visit_arms(&mut self, arms: &'a [Arm], start: &Left<'a>) {
        let is_named = |outcome: &Outcome| {
            arms.iter().any(|arm| arm.tag.as_ref().is_some_and(|tag| tag.text == outcome.name.text))
        };
        for arm in arms {
            let is_own = |outcome: &Outcome| match &arm.tag {
                Some(tag) => tag.text == outcome.name.text,
                None => !is_named(outcome),
            };
            let mut outcomes = start.outcomes.clone();
            outcomes.retain(|_, outcome| is_own(outcome));
            let is_bare = arm.tag.is_some();
            let is_open = start.is_open || outcomes.is_empty();
            let is_nothing = start.is_nothing && !is_bare;
            self.visit(&arm.body, &Left { outcomes, is_bare, is_open, is_nothing });
        }
    }

    /// Compares the type of a result with the start values of the programs that start with it.
    fn compare(&mut self, name: &Name, left: &Left<'a>, part: &'a Expr) {
        let takers = takers(self.spec, self.process, part);
        let is_open = |taker: &Taker<'_>| match taker {
            Taker::Module(module) => module.is_damaged,
            Taker::Unknown => true,
        };
        let starts = declared(&takers);
        if starts.is_empty() && !takers.iter().any(is_open) && !chooses(part) {
            self.diagnostics.push(nothing(&takers, name.span, part));
        }
        let typed = starts.iter().find_map(|(module, start)| Some((module, start, start.kind.as_ref()?)));
        if let (Some((module, start, kind)), true) = (typed, left.is_nothing) {
            let message = format!("`{}` may have no value, and `{}` starts with a {kind}", name.text, module.name.text);
            let found =
                Diagnostic::new(Code::E0213, name.span, message).reason(start.name.span, "this program takes it");
            let help = format!("write `{} =>` directly after a `:`, outside of each `retry` and `repeat`", name.text);
            return self.diagnostics.push(found.help(help));
        }
        let mut pairs = starts.iter().flat_map(|start| left.outcomes.values().map(move |outcome| (start, outcome)));
        let found = pairs.find_map(|((module, start), outcome)| self.misfit(name, left, outcome, module, start));
        self.diagnostics.extend(found);
    }

    /// Returns the reason for which an outcome cannot be the start value of a program.
    fn misfit(
        &self,
        name: &Name,
        left: &Left<'_>,
        outcome: &Outcome,
        module: &Module,
        start: &Param,
    ) -> Option<Diagnostic> {
        let wanted = start.kind.as_ref()?;
        let (tag, program) = (&outcome.name.text, &module.name.text);
        let found = |message: String| {
            let found = Diagnostic::new(Code::E0213, name.span, message);
            found.reason(outcome.name.span, "declared here").reason(start.name.span, "this program takes it")
        };
        let Some(kind) = &outcome.kind else {
            let help = format!("give the outcome a value: `done({tag}: {wanted});`");
            return Some(found(format!("`{}` has no value after the outcome `{tag}`", name.text)).help(help));
        };
        if !left.is_bare {
            let message =
                format!("`{}` is an outcome with its name, and `{program}` starts with a {wanted}", name.text);
            let help = format!("let an arm take the name off: `match {{ {tag} {0} => process with {0} }}`", name.text);
            return Some(found(message).help(help));
        }
        let message = || format!("`{}` is a {kind}, and `{program}` starts with a {wanted}", name.text);
        (!self.spec.is_same(kind, wanted)).then(|| found(message()))
    }
}

/// Returns whether an expression begins with a `match`, which chooses by the start value, or was not understood.
fn chooses(expr: &Expr) -> bool {
    matches!(expr.kind, ExprKind::Match(_) | ExprKind::Broken) || expr.first_parts().into_iter().any(chooses)
}
