//! Checks outcomes: the tags with which an expression can end, whether every `match` has an arm for
//! each tag, and whether every `repeat` ends with at least one tag.

use super::service;
use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{Arm, Expr, ExprKind, Outcome, Process, Spec, StartValue, Target};
use crate::diagnostic::{Code, Diagnostic, Edit, Fix};
use crate::source::Span;
use crate::syntax::ast::Name;
use std::collections::BTreeMap;

/// The possible normal ends of an expression.
#[derive(Clone, Debug, Default)]
struct Ends {
    /// The tags, each with the place of its declaration.
    tags: BTreeMap<String, Span>,
    /// The place of the process, if the expression can be done without a tag.
    untagged: Option<Span>,
    /// Whether other ends are possible, because a part has no known interface.
    is_open: bool,
}

impl Ends {
    fn open() -> Self {
        Self { is_open: true, ..Self::default() }
    }

    fn untagged(span: Span) -> Self {
        Self { untagged: Some(span), ..Self::default() }
    }

    fn declared(outcomes: &[Outcome]) -> Self {
        let tags = outcomes.iter().map(|outcome| (outcome.name.text.clone(), outcome.name.span)).collect();
        Self { tags, ..Self::default() }
    }

    fn or(mut self, other: Self) -> Self {
        self.tags.extend(other.tags);
        Self { tags: self.tags, untagged: self.untagged.or(other.untagged), is_open: self.is_open || other.is_open }
    }

    fn any(all: impl Iterator<Item = Self>) -> Self {
        all.fold(Self::default(), Self::or)
    }
}

/// Checks every `match` against the outcomes that it is started with, and every `repeat` against the outcomes of its operand.
pub(super) fn check(spec: &Spec, diagnostics: &mut Diagnostics) {
    let names_outcomes = |process: &&Process| process.actions.as_ref().is_some_and(names_outcomes);
    let mut known = vec![None; spec.processes.len()];
    for process in spec.processes.iter().filter(|process| !process.damage.actions).filter(names_outcomes) {
        let Some(actions) = &process.actions else { continue };
        let mut walk = Walk { spec, process, known: &mut known, results: Vec::new(), chain: None, diagnostics };
        // The start value of the group comes from the group around it, so it is unknown here.
        walk.visit(actions, &Ends::open());
    }
}

fn names_outcomes(expr: &Expr) -> bool {
    matches!(expr.kind, ExprKind::Match(_) | ExprKind::Repeat(..)) || expr.parts().into_iter().any(names_outcomes)
}

/// Returns the possible normal ends of a group. At this point, no group contains itself.
fn of_process(spec: &Spec, process: usize, known: &mut Vec<Option<Ends>>) -> Ends {
    if let Some(ends) = &known[process] {
        return ends.clone();
    }
    let source = &spec.processes[process];
    let ends = match source.actions.as_ref().filter(|_| !source.damage.actions) {
        Some(actions) => ends(spec, source, actions, known),
        None => Ends::open(),
    };
    known[process] = Some(ends.clone());
    ends
}

fn ends(spec: &Spec, process: &Process, expr: &Expr, known: &mut Vec<Option<Ends>>) -> Ends {
    let mut rest = |part: &Expr| ends(spec, process, part, known);
    match &expr.kind {
        ExprKind::Run(slot, _) => match process.instances[*slot].target {
            Target::Process(inner) => of_process(spec, inner, known),
            Target::Unknown => Ends::open(),
            Target::Module(module) if spec.modules[module].is_damaged => Ends::open(),
            Target::Module(module) => {
                let outcomes = &spec.modules[module].outcomes;
                let untagged = outcomes.is_empty().then_some(expr.span);
                Ends { untagged, ..Ends::declared(outcomes) }
            }
        },
        ExprKind::Skip | ExprKind::Wait(_) => Ends::untagged(expr.span),
        ExprKind::Never | ExprKind::Fail(_) | ExprKind::Recurrent(..) | ExprKind::Asynchronous(..) => Ends::default(),
        ExprKind::Chart(model) if !model.outcomes.is_empty() => Ends::declared(&model.outcomes),
        // Such an end can pass on the value of a run, with its tag.
        ExprKind::Chart(_) | ExprKind::Broken => Ends::open(),
        ExprKind::Sequence(parts) | ExprKind::Conditional(parts) => parts.last().map_or(Ends::open(), rest),
        ExprKind::Disable(parts) | ExprKind::Otherwise(parts) => Ends::any(parts.iter().map(rest)),
        ExprKind::AnyOf(1, parts) => Ends::any(parts.iter().map(rest)),
        // The value of one task is passed on. The values of several tasks are combined, without a tag.
        ExprKind::Concurrent(parts) => {
            let services = service::members(spec, process);
            let tasks = parts.iter().filter(|part| !service::is_service(part, &services)).map(rest);
            match &tasks.collect::<Vec<_>>()[..] {
                [] => Ends::default(),
                [only] => only.clone(),
                several if several.iter().any(|ends| ends.is_open) => Ends::open(),
                [..] => Ends::untagged(expr.span),
            }
        }
        ExprKind::FailFast(_) | ExprKind::AnyOf(..) | ExprKind::AtLeast(..) => Ends::untagged(expr.span),
        ExprKind::Finally(first, _) => rest(first),
        ExprKind::Tagged(tag, part) => {
            let inner = rest(part);
            let is_done = inner.is_open || inner.untagged.is_some() || !inner.tags.is_empty();
            let tags = is_done.then(|| (tag.text.clone(), tag.span));
            Ends { tags: tags.into_iter().collect(), ..Ends::default() }
        }
        ExprKind::Match(arms) => Ends::any(arms.iter().map(|arm| rest(&arm.body))),
        ExprKind::Catch(..) => Ends::any(expr.parts().into_iter().map(rest)),
        // Only these outcomes end it.
        ExprKind::Repeat(until, part) => {
            let declared = rest(part).tags;
            let place = |tag: &Name| declared.get(&tag.text).copied().unwrap_or(tag.span);
            Ends { tags: until.iter().map(|tag| (tag.text.clone(), place(tag))).collect(), ..Ends::default() }
        }
        ExprKind::Retry(_, _, part)
        | ExprKind::Within(_, part)
        | ExprKind::Shield(_, part)
        | ExprKind::Using(_, part)
        | ExprKind::With(_, part)
        | ExprKind::Named(_, part) => rest(part),
    }
}

struct Walk<'a> {
    spec: &'a Spec,
    process: &'a Process,
    known: &'a mut Vec<Option<Ends>>,
    /// The results that have names at this place, each with its possible outcomes.
    results: Vec<(String, Ends)>,
    /// The begin of the chain `P : ...` whose operand is visited.
    chain: Option<Span>,
    diagnostics: &'a mut Diagnostics,
}

impl Walk<'_> {
    /// Checks an expression. `start` has the outcomes that the expression may be started with.
    fn visit(&mut self, expr: &Expr, start: &Ends) {
        let nothing = Ends::untagged(expr.span.at_start());
        match &expr.kind {
            ExprKind::Match(arms) => {
                self.check_match(expr, arms, start);
                arms.iter().for_each(|arm| self.visit(&arm.body, &Ends::open()));
            }
            ExprKind::Conditional(parts) => self.visit_chain(&parts.iter().collect::<Vec<_>>(), start),
            ExprKind::Recurrent(first, second) => {
                let before = self.diagnostics.count();
                self.visit(first, &start.clone().or(nothing));
                if let (ExprKind::Match(_), Some(chain), Some(found)) =
                    (&first.kind, self.chain, self.diagnostics.first_since(before))
                {
                    in_parentheses(found, chain, first.span);
                }
                let value = self.ends(first);
                self.visit(second, &value);
            }
            ExprKind::Asynchronous(source, pool) => {
                self.visit(source, &start.clone().or(nothing));
                let value = self.ends(source);
                // The places differ only in their instances, so one of them is enough.
                pool.iter().take(1).for_each(|part| self.visit(part, &value));
            }
            ExprKind::Sequence(parts) | ExprKind::Otherwise(parts) => {
                for (index, part) in parts.iter().enumerate() {
                    self.visit(part, if index == 0 { start } else { &nothing });
                }
            }
            ExprKind::Finally(first, second) => {
                self.visit(first, start);
                self.visit(second, &nothing);
            }
            ExprKind::Catch(first, arms) => {
                self.visit(first, start);
                arms.iter().for_each(|arm| self.visit(&arm.body, &nothing));
            }
            ExprKind::Named(name, part) => {
                self.results.push((name.text.clone(), start.clone()));
                self.visit(part, &nothing);
                self.results.pop();
            }
            ExprKind::With(StartValue::Result(name), part) => {
                let result = self.results.iter().rev().find(|(known, _)| *known == name.text);
                let result = result.map_or_else(Ends::open, |(_, ends)| ends.clone());
                self.visit(part, &result);
            }
            ExprKind::Chart(model) => model.runs.iter().for_each(|(_, run)| self.visit(run, &Ends::open())),
            ExprKind::Retry(times, _, part) if *times > 0 => self.visit(part, &start.clone().or(nothing)),
            ExprKind::Repeat(until, part) => {
                self.check_repeat(until, part);
                self.visit(part, &start.clone().or(nothing));
            }
            ExprKind::Run(..)
            | ExprKind::Skip
            | ExprKind::Never
            | ExprKind::Fail(_)
            | ExprKind::Wait(_)
            | ExprKind::Broken
            | ExprKind::Concurrent(_)
            | ExprKind::FailFast(_)
            | ExprKind::AnyOf(..)
            | ExprKind::AtLeast(..)
            | ExprKind::Disable(_)
            | ExprKind::Retry(..)
            | ExprKind::Within(..)
            | ExprKind::Shield(..)
            | ExprKind::Tagged(..)
            | ExprKind::With(..)
            | ExprKind::Using(..) => expr.parts().into_iter().for_each(|part| self.visit(part, start)),
        }
    }

    fn visit_chain(&mut self, parts: &[&Expr], start: &Ends) {
        let mut start = start.clone();
        for (index, part) in parts.iter().enumerate() {
            self.chain = parts.first().filter(|_| index > 0).map(|first| first.span.at_start());
            self.visit(part, &start);
            self.chain = None;
            start = self.ends(part);
        }
    }

    fn ends(&mut self, expr: &Expr) -> Ends {
        ends(self.spec, self.process, expr, self.known)
    }

    fn check_repeat(&mut self, until: &[Name], part: &Expr) {
        let inner = self.ends(part);
        if inner.is_open {
            return;
        }
        let unknown: Vec<&Name> = until.iter().filter(|tag| !inner.tags.contains_key(&tag.text)).collect();
        for tag in &unknown {
            let message = format!("the repeated operand has no outcome `{}`", tag.text);
            let found = Diagnostic::new(Code::E0427, tag.span, message).label("never ends it");
            let found = found.reason(part.span, "is repeated");
            let near = self.diagnostics.near(&tag.text, inner.tags.keys().map(String::as_str));
            self.diagnostics.push(match near {
                Some(near) => found.reason(inner.tags[near.name], "declared here").rename(tag.span, &near),
                None if ["done", "success", "succeeded"].contains(&tag.text.as_str()) => found.help(
                    "`retry(3) process` tries again after a failure; `repeat` tries again after any other outcome",
                ),
                None if inner.tags.is_empty() => found.help(
                    "declare its outcomes in the interface, `done(found | missing);`, or name its end: `process as found`",
                ),
                None => found.help(format!("the outcomes are {}", listed(inner.tags.keys().map(String::as_str)))),
            });
        }
        let is_left = |tag: &String| until.iter().all(|name| name.text != *tag);
        if unknown.is_empty() && inner.untagged.is_none() && !inner.tags.keys().any(is_left) {
            let message = "this `repeat` never repeats: every outcome of its operand ends it";
            let found = Diagnostic::new(Code::W0428, part.span, message).label("runs once");
            self.diagnostics.push(found.help("remove an outcome after which the operand shall run again"));
        }
    }

    fn check_match(&mut self, expr: &Expr, arms: &[Arm], start: &Ends) {
        if start.is_open {
            return;
        }
        if start.tags.is_empty() {
            let message =
                "no outcome can match: the previous part has no outcomes, or its value does not reach this `match`";
            let diagnostic = Diagnostic::new(Code::E0423, expr.span, message);
            let help = "write `process : match { ... }`, and `done(found | missing);` in the interface of the process";
            self.diagnostics.push(diagnostic.help(help));
            return;
        }
        for tag in arms.iter().filter_map(|arm| arm.tag.as_ref()).filter(|tag| !start.tags.contains_key(&tag.text)) {
            let message = format!("no outcome is called `{}`", tag.text);
            let diagnostic = Diagnostic::new(Code::E0421, tag.span, message).label("never taken");
            let near = self.diagnostics.near(&tag.text, start.tags.keys().map(String::as_str));
            self.diagnostics.push(match near {
                Some(near) => diagnostic.reason(start.tags[near.name], "declared here").rename(tag.span, &near),
                None => diagnostic.help(format!("the outcomes are {}", listed(start.tags.keys().map(String::as_str)))),
            });
        }
        let has_arm = |tag: &String| arms.iter().any(|arm| arm.tag.as_ref().is_some_and(|name| name.text == *tag));
        let open: Vec<&String> = start.tags.keys().filter(|tag| !has_arm(tag)).collect();
        let rest = arms.iter().find(|arm| arm.tag.is_none());
        if let Some(rest) = rest.filter(|_| open.is_empty() && start.untagged.is_none()) {
            let message = "this `else` is never taken: every outcome already has an arm";
            self.diagnostics.push(Diagnostic::new(Code::W0422, rest.body.span, message).label("never taken"));
        }
        // A misspelt arm already explains a missing arm.
        let is_misspelt =
            arms.iter().any(|arm| arm.tag.as_ref().is_some_and(|tag| !start.tags.contains_key(&tag.text)));
        if rest.is_none() && !is_misspelt && (!open.is_empty() || start.untagged.is_some()) {
            self.diagnostics.push(unhandled(expr, arms, &open, start));
        }
    }
}

/// Explains that `m : match { ... } ;; c` is `m : (match { ... } ;; c)`. So the second round has no value to match. The user probably means
/// another reading.
fn in_parentheses(found: &mut Diagnostic, chain: Span, matching: Span) {
    let insert = |span: Span, text: &str| Edit { span, text: text.to_owned() };
    found.help = vec![
        "`:` and `;;` are read from the right: `m : (match { ... } ;; c)` starts the `match` again after `c`, with nothing to match".to_owned(),
    ];
    let edits = vec![insert(chain, "("), insert(matching.at_end(), ")")];
    found.choices = vec![Fix { title: "put parentheses around what is repeated".to_owned(), edits }];
}

fn unhandled(expr: &Expr, arms: &[Arm], open: &[&String], start: &Ends) -> Diagnostic {
    let message = match open.len() {
        0 => "an outcome without a tag has no arm".to_owned(),
        1 => format!("outcome {} has no arm", listed(open.iter().map(|tag| tag.as_str()))),
        _ => format!("outcomes {} have no arm", listed(open.iter().map(|tag| tag.as_str()))),
    };
    let mut diagnostic = Diagnostic::new(Code::E0420, expr.span, message);
    for tag in open {
        diagnostic = diagnostic.reason(start.tags[*tag], "declared here");
    }
    if let (Some(span), true) = (start.untagged, open.is_empty()) {
        diagnostic = diagnostic.reason(span, "this one has no tag");
    }
    let Some(last) = arms.last() else { return diagnostic };
    let missing = open.iter().map(|tag| format!(", {tag} => fail(\"{tag}\")")).collect::<String>();
    let text = if open.is_empty() { ", else => fail(\"no outcome\")".to_owned() } else { missing };
    let edits = vec![Edit { span: last.body.span.at_end(), text }];
    diagnostic.choices.push(Fix { title: "add arms that fail".to_owned(), edits });
    diagnostic
}
