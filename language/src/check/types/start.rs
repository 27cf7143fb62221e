//! Checks start values of expressions: `goto with { x = 2 m }`.

use super::kinds::TypeChecker;
use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{Expr, ExprKind, Kind, Module, Param, Process, Shape, Spec, StartValue, Target, Value};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::Name;
use crate::unit;
use std::collections::BTreeSet;

/// Compares each start value with the interfaces of the programs that get it. At this point, no group contains itself.
pub(in crate::check) fn check(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    let mut uses = std::mem::take(&mut spec.field_uses);
    for process in spec.processes.iter().filter(|process| !process.damage.actions) {
        if let Some(actions) = &process.actions {
            StartCheck { spec, process, uses: &mut uses, diagnostics }.visit(actions);
        }
    }
    spec.field_uses = uses;
}

/// A program that may get a start value.
pub(in crate::check) enum Taker<'a> {
    /// A program with a known interface.
    Module(&'a Module),
    /// A program with an unknown interface, which may take any value.
    Unknown,
}

/// Returns the programs that get the start value of an expression.
pub(in crate::check) fn takers<'a>(spec: &'a Spec, process: &'a Process, expr: &'a Expr) -> Vec<Taker<'a>> {
    let mut all = Takers { spec, found: Vec::new(), seen: BTreeSet::new() };
    all.collect(process, expr);
    all.found
}

/// The programs that get a start value, so far.
struct Takers<'a> {
    spec: &'a Spec,
    found: Vec<Taker<'a>>,
    /// The visited instances, each by the place of its declaration. Otherwise, a group that uses a result twice would
    /// double the visits of all groups in it.
    seen: BTreeSet<Span>,
}

impl<'a> Takers<'a> {
    fn collect(&mut self, process: &'a Process, expr: &'a Expr) {
        if let ExprKind::Named(name, part) = &expr.kind {
            let mut uses = Vec::new();
            uses_of(name, part, &mut uses);
            return uses.into_iter().for_each(|part| self.collect(process, part));
        }
        let ExprKind::Run(slot, _) = &expr.kind else {
            return expr.first_parts().into_iter().for_each(|part| self.collect(process, part));
        };
        let instance = &process.instances[*slot];
        match instance.target {
            Target::Module(module) => self.found.push(Taker::Module(&self.spec.modules[module])),
            Target::Process(inner) => {
                let inner = &self.spec.processes[inner];
                if let (Some(actions), true) = (&inner.actions, self.seen.insert(instance.name.span)) {
                    self.collect(inner, actions);
                }
            }
            Target::Unknown => self.found.push(Taker::Unknown),
        }
    }
}

/// Collects in `uses` the expressions in `expr` that start with the result of this name.
fn uses_of<'a>(name: &Name, expr: &'a Expr, uses: &mut Vec<&'a Expr>) {
    if let ExprKind::With(StartValue::Result(used), part) = &expr.kind
        && used.text == name.text
    {
        uses.push(part);
    }
    expr.parts().into_iter().for_each(|part| uses_of(name, part, uses));
}

/// Returns the start values that these programs declare, each with its module.
pub(in crate::check) fn declared<'a>(takers: &[Taker<'a>]) -> Vec<(&'a Module, &'a Param)> {
    let declared = takers.iter().filter_map(|taker| match taker {
        Taker::Module(module) => module.start.as_ref().map(|start| (*module, start)),
        Taker::Unknown => None,
    });
    declared.collect()
}

struct StartCheck<'a> {
    spec: &'a Spec,
    process: &'a Process,
    /// The field that each name in a record refers to.
    uses: &'a mut Vec<(Span, Span)>,
    diagnostics: &'a mut Diagnostics,
}

impl StartCheck<'_> {
    fn visit(&mut self, expr: &Expr) {
        if let ExprKind::With(StartValue::Known(value), part) = &expr.kind {
            self.value(value, part);
        }
        if let ExprKind::Conditional(parts) = &expr.kind {
            for pair in parts.windows(2) {
                self.diagnostics.extend(given(&pair[1]).map(|value| twice(&pair[0], value)));
            }
        }
        expr.parts().into_iter().for_each(|part| self.visit(part));
    }

    fn value(&mut self, value: &Value, part: &Expr) {
        let takers = takers(self.spec, self.process, part);
        let is_open = |taker: &Taker<'_>| match taker {
            Taker::Module(module) => module.is_damaged,
            Taker::Unknown => true,
        };
        let declared = declared(&takers);
        let Some((_, start)) = declared.first() else {
            if !takers.iter().any(is_open) && !matches!(part.kind, ExprKind::Broken) {
                self.diagnostics.push(nothing(&takers, value.span, part));
            }
            return;
        };
        let kind = |start: &Param| start.kind.as_ref().map(|kind| (kind.to_string(), kind.clone()));
        let first = kind(start);
        let is_other = |(_, start): &&(&Module, &Param)| match (&first, kind(start)) {
            (Some((_, one)), Some((_, other))) => !self.spec.is_same(one, &other),
            (one, other) => one.is_some() != other.is_some(),
        };
        if let Some((_, other)) = declared.iter().find(is_other) {
            let message = "one start value is given to programs that take values of different types";
            let found = Diagnostic::new(Code::E0425, value.span, message);
            let found =
                found.reason(start.name.span, "this program takes one").reason(other.name.span, "this one another");
            self.diagnostics.push(found.help("give each program its own value: `a with 1 m, b with 2 N`"));
            return;
        }
        if let Some(unwritten) = first.as_ref().and_then(|(_, kind)| unwritten(self.spec, kind)) {
            self.diagnostics.push(no_spelling(start, &unwritten, value.span));
            return;
        }
        TypeChecker { spec: self.spec, outer: &self.process.params, uses: self.uses, diagnostics: self.diagnostics }
            .value(start, value);
    }
}

/// Returns the place of the value that an expression gives to the first part that it starts.
fn given(expr: &Expr) -> Option<Span> {
    if let ExprKind::With(start, _) = &expr.kind {
        return Some(match start {
            StartValue::Known(value) => value.span,
            StartValue::Kept(_, name) | StartValue::Result(name) => name.span,
        });
    }
    match expr.first_parts().as_slice() {
        [only] => given(only),
        [] | [_, _, ..] => None,
    }
}

fn twice(before: &Expr, value: Span) -> Diagnostic {
    let message = "two start values: `:` gives one value, and `with` gives another value";
    let found = Diagnostic::new(Code::E0426, value, message).label("this one is used");
    found
        .reason(before.span, "the value of this one is lost")
        .help("write `;` instead of `:` if the previous part leaves no value")
}

/// Makes the diagnostic for a start value if no program that the expression starts takes one.
pub(super) fn nothing(takers: &[Taker<'_>], value: Span, part: &Expr) -> Diagnostic {
    let mut names: Vec<&str> = takers
        .iter()
        .filter_map(|taker| match taker {
            Taker::Module(module) => Some(module.name.text.as_str()),
            Taker::Unknown => None,
        })
        .collect();
    names.sort_unstable();
    names.dedup();
    let message = match names.as_slice() {
        [] => "no process in this part takes a start value".to_owned(),
        [one] => format!("{one} takes no start value"),
        _ => format!("none of {} takes a start value", listed(names.iter().copied())),
    };
    let found = Diagnostic::new(Code::E0425, value, message).reason(part.span, "is started with this value");
    match names.first() {
        Some(name) => {
            found.help(format!("declare it in the interface: `module {name}(host) {{ init goal: Length; }}`"))
        }
        None => found.help("give the value to a process: `process with 1 m`"),
    }
}

/// Returns the first part of a type whose values a spec cannot write, because no text declares these values.
fn unwritten(spec: &Spec, kind: &Kind) -> Option<String> {
    match spec.shape(kind) {
        Shape::Record(fields) => fields.iter().find_map(|field| unwritten(spec, field.kind.as_ref()?)),
        Shape::List(element, _) => unwritten(spec, &Kind { text: element.to_owned(), span: kind.span, fields: None }),
        Shape::Plain(name) => (!is_written(name)).then(|| name.to_owned()),
    }
}

/// Returns whether a spec can write the values of this type.
fn is_written(name: &str) -> bool {
    ["Number", "Text", "Truth", "Host"].contains(&name) || unit::of_type(name).is_some()
}

fn no_spelling(start: &Param, name: &str, value: Span) -> Diagnostic {
    let message = format!("a spec cannot contain a value of type {name}");
    let found = Diagnostic::new(Code::E0425, value, message).reason(start.name.span, "declared here");
    match unit::is_type(name) {
        true => found,
        false => found.help(format!("declare the fields of the type: `type {name} = {{ x: Length, y: Length }};`")),
    }
}
