//! Reads event-action expressions and resolves their names to slots.

pub(super) mod catch;
mod replicate;
mod result;
mod scope;

use super::count::Expected;
use super::diagnostics::Diagnostics;
use super::lower::EXPRESSION_MAX;
use super::names::{Names, listed};
use super::resource_args;
use super::spec::{Binding, Damage, Expr, ExprKind, Scope, Set, StartValue};
use super::value::Reader;
use crate::diagnostic::{Code, Diagnostic, Edit, REASONS_MAX};
use crate::similar::{Near, is_look_alike, spell};
use crate::source::Span;
use crate::syntax::Operator;
use crate::syntax::SyntaxKind::{self, Colon, Constant, DoubleColon, Question, Recur, Text};
use crate::syntax::ast::{Name, Node, Token};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// The largest number of attempts of a `retry`. Each attempt is a copy of its operand.
const RETRY_MAX: usize = 100;
/// The largest number of suffixes of one operand, and of `;;` and `::` in one chain.
const REPEAT_MAX: usize = 8;

/// Makes an operator from its operands.
type Make = fn(Vec<Expr>) -> ExprKind;

/// The names that an expression may refer to, and their uses in the expressions read so far.
pub(super) struct Group<'a> {
    pub(super) names: Names<'a>,
    /// The parameters of the group, and the named constants.
    pub(super) scope: Scope<'a>,
    pub(super) kept: Kept,
    /// The index variables of the enclosing replications, with their values.
    pub(super) indices: Vec<Binding>,
    pub(super) sets: &'a [Set],
    pub(super) owned: BTreeMap<usize, Rc<OwnedSets<'a>>>,
    pub(super) resources: Resources<'a>,
    /// The current place in the innermost enclosing pool. It is the default index of names there.
    pub(super) pool: Option<usize>,
    pub(super) damage: Damage,
    /// The slots of the instances that are run, in the order of the text.
    pub(super) run: Vec<usize>,
    /// How many operators and operands have been expanded.
    pub(super) size: u64,
    /// Labels of processes that own no set.
    pub(super) useless: Vec<(Name, Name)>,
}

/// The names of values that are kept while processes run.
#[derive(Debug, Default)]
pub(super) struct Kept {
    /// The variables of an activity. Opaque variables have their numbers.
    pub(super) variables: BTreeMap<String, Option<usize>>,
    /// The results that have names at this place, the outermost first.
    results: Vec<result::Known>,
    /// The results of operands that were read before.
    ended: Vec<Name>,
}

impl Group<'_> {
    /// Returns whether one more operator or operand may be expanded, because nested replications grow fast. Reports the
    /// first that exceeds the limit.
    fn may_grow(&mut self, span: Span) -> bool {
        self.size += 1;
        if self.size == EXPRESSION_MAX {
            let message = format!("the event actions have more than {EXPRESSION_MAX} operators");
            let diagnostic = Diagnostic::new(Code::E0701, span, message).label("this is one too many");
            self.diagnostics().push(diagnostic.help("use smaller arrays and ranges, or split the group"));
        }
        !self.is_full()
    }

    /// Returns whether the limit for expanding is reached.
    fn is_full(&self) -> bool {
        self.size >= EXPRESSION_MAX
    }

    pub(super) fn diagnostics(&mut self) -> &mut Diagnostics {
        self.names.diagnostics
    }

    /// Returns a reader of times and counts. Names in them are constants, or parameters of the group that already have
    /// values.
    pub(super) fn reader(&mut self) -> Reader<'_> {
        let scope = Scope { params: &[], indices: &[], ..self.scope };
        Reader { scope, diagnostics: self.names.diagnostics }
    }

    /// Returns a reader of values, in which names may be parameters of the group.
    fn value_reader(&mut self) -> Reader<'_> {
        let scope = Scope { indices: &self.indices, ..self.scope };
        Reader { scope, diagnostics: self.names.diagnostics }
    }
}

/// The resources that `using` may take, and the resources that it takes.
pub(super) struct Resources<'a> {
    pub(super) all: &'a [Name],
    /// The index of each resource in `all`.
    pub(super) places: BTreeMap<&'a str, usize>,
    /// The names that are not declared, and are already reported.
    pub(super) unknown: BTreeSet<String>,
    /// The resources that are used.
    pub(super) taken: BTreeSet<usize>,
}

impl<'a> Resources<'a> {
    pub(super) fn new(all: &'a [Name]) -> Self {
        Self { all, places: resource_args::places(all), unknown: BTreeSet::new(), taken: BTreeSet::new() }
    }
}

/// The connection sets that one instance owns.
#[derive(Clone, Debug, Default)]
pub(super) struct OwnedSets<'a> {
    /// The sets without a label.
    bare: Vec<usize>,
    labelled: BTreeMap<&'a str, usize>,
    /// The first labelled sets in the text, at most as many as a diagnostic shows.
    first: Vec<usize>,
}

impl<'a> OwnedSets<'a> {
    /// Returns the sets of all instances that own any, by slot of the instance.
    pub(super) fn of_all(sets: &'a [Set]) -> BTreeMap<usize, Rc<Self>> {
        let mut all: BTreeMap<usize, Self> = BTreeMap::new();
        for (index, set) in sets.iter().enumerate() {
            let Some(owner) = set.owner else { continue };
            let owned = all.entry(owner).or_default();
            match &set.label {
                Some(label) => {
                    owned.labelled.entry(&label.text).or_insert(index);
                    if owned.first.len() < REASONS_MAX {
                        owned.first.push(index);
                    }
                }
                None => owned.bare.push(index),
            }
        }
        all.into_iter().map(|(owner, owned)| (owner, Rc::new(owned))).collect()
    }
}

/// Reads the event actions of a group. Returns nothing for an empty section.
pub(super) fn actions(node: &Node, group: &mut Group<'_>) -> Option<Expr> {
    let parts: Vec<Expr> = node.children().map(|part| expression(&part, group)).collect();
    if let Some(diagnostic) = useless_labels(group) {
        group.diagnostics().push(diagnostic);
    }
    let mut parts = parts.into_iter();
    let first = parts.next()?;
    let rest: Vec<Expr> = parts.collect();
    if rest.is_empty() {
        return Some(first);
    }
    // If there is more than one expression, an operator is missing, which is already reported.
    Some(Expr { span: node.span(), kind: ExprKind::Sequence(std::iter::once(first).chain(rest).collect()) })
}

/// Reads one event action. A part without an operator is damaged, which is already reported.
pub(super) fn expression(node: &Node, group: &mut Group<'_>) -> Expr {
    let span = node.span();
    let broken = Expr { span, kind: ExprKind::Broken };
    let Some(operator) = node.kind().operator().filter(|_| group.may_grow(span)) else { return broken };
    let kind = match operator {
        Operator::Run => return run(node, group),
        Operator::Paren => return parenthesised(node, group),
        Operator::Chain => return chain(node, group),
        Operator::Suffixed => return suffixed(node, group),
        Operator::Concurrent => return joined(node, group, ExprKind::Concurrent),
        Operator::FailFast => return joined(node, group, ExprKind::FailFast),
        Operator::Disable => return joined(node, group, ExprKind::Disable),
        Operator::Sequence => return joined(node, group, ExprKind::Sequence),
        Operator::Otherwise => return catch::otherwise(node, group),
        Operator::Finally => return joined(node, group, finally),
        Operator::AllOf => replicate::all_of(node, group),
        Operator::AnyOf => any_of(node, group),
        Operator::Retry => retry(node, group),
        Operator::Repeat => scope::repeat(node, group),
        Operator::Shield => scope::shield(node, group),
        Operator::Using => scope::using(node, group),
        Operator::Match => scope::matching(node, group),
        Operator::Named => result::named(node, group),
        Operator::Fail => node.token(Text).map(|reason| ExprKind::Fail(reason.content())),
        Operator::Wait => {
            let limit = node.child(Constant).and_then(|node| group.reader().duration(&node));
            limit.map(ExprKind::Wait)
        }
    };
    kind.map_or(broken, |kind| Expr { span, kind })
}

fn parenthesised(node: &Node, group: &mut Group<'_>) -> Expr {
    let mut parts = parts(node, group);
    let is_single = parts.len() == 1;
    match parts.pop() {
        Some(inner) if is_single => inner,
        Some(_) | None => Expr { span: node.span(), kind: ExprKind::Broken },
    }
}

/// Reads `operand op operand op ...`.
fn joined(node: &Node, group: &mut Group<'_>, make: Make) -> Expr {
    let span = node.span();
    report_side_by_side(node, group);
    let mut parts = parts(node, group);
    match parts.len() {
        0 => Expr { span, kind: ExprKind::Broken },
        // There may be an extra `,` or `;` at the end.
        1 => parts.remove(0),
        _ => Expr { span, kind: make(parts) },
    }
}

fn report_side_by_side(node: &Node, group: &mut Group<'_>) {
    // In damaged text, it is unknown which parts belong together.
    if !group.damage.actions {
        group.diagnostics().extend(side_by_side(node));
    }
}

/// Joins parts from the left: `a finally b finally c` is `(a finally b) finally c`.
fn finally(parts: Vec<Expr>) -> ExprKind {
    let join = |first: Expr, second: Expr| {
        let span = Span { end: second.span.end, ..first.span };
        Expr { span, kind: ExprKind::Finally(Box::new(first), Box::new(second)) }
    };
    parts.into_iter().reduce(join).map_or(ExprKind::Broken, |all| all.kind)
}

/// Reports `a ; b # c`, `a # b , c`, `a # b else c` and `a ; b finally c`. The precedence defines them, but many people
/// read them wrongly.
fn side_by_side(node: &Node) -> Option<Diagnostic> {
    let looser = [
        (SyntaxKind::Disable, SyntaxKind::Sequence),
        (SyntaxKind::Disable, SyntaxKind::Otherwise),
        (SyntaxKind::Sequence, SyntaxKind::Finally),
    ];
    let is_outer = |(outer, _): &(SyntaxKind, SyntaxKind)| *outer == node.kind();
    let bare = if looser.iter().any(&is_outer) { None } else { Some(SyntaxKind::Disable) };
    let inner = looser.iter().filter(|pair| is_outer(pair)).map(|(_, inner)| *inner);
    let bare: Vec<SyntaxKind> = inner.chain(bare).collect();
    let is_bare = |child: &Node| bare.contains(&child.kind());
    let child = node.children().find(is_bare)?;
    let (outer, inner) = (node.kind().describe(), child.kind().describe());
    let span = child.span();
    let message = format!("{inner} is next to {outer} without parentheses");
    let diagnostic = Diagnostic::new(Code::W0404, span, message).label("these belong together");
    let insert = |span: Span, text: &str| Edit { span, text: text.to_owned() };
    let edits = vec![insert(span.at_start(), "("), insert(span.at_end(), ")")];
    Some(diagnostic.fix("put parentheses around it", edits))
}

fn parts(node: &Node, group: &mut Group<'_>) -> Vec<Expr> {
    let no_operands = [Constant, SyntaxKind::Count, SyntaxKind::Resources, SyntaxKind::Until];
    let operands = node.children().filter(|child| !no_operands.contains(&child.kind()));
    operands.map(|part| expression(&part, group)).collect()
}

/// Reads `a : b ;; c : d` as `a : (b ;; (c : d))`. `::` is read in the same way, and its second operand is repeated for
/// each place of the pool.
fn chain(node: &Node, group: &mut Group<'_>) -> Expr {
    let operators = node.tokens().map(|token| token.kind());
    let operators: Vec<SyntaxKind> = operators.filter(|kind| [Colon, Recur, DoubleColon].contains(kind)).collect();
    let span = node.span();
    let loops = operators.iter().filter(|&&operator| operator != Colon).count();
    let parts: Vec<Node> = node.children().filter(|part| part.kind() != SyntaxKind::Count).collect();
    if loops > REPEAT_MAX {
        group.diagnostics().push(Diagnostic::new(
            Code::E0004,
            span,
            format!("more than {REPEAT_MAX} `;;` and `::` in a chain"),
        ));
    }
    if loops > REPEAT_MAX || parts.len() != operators.len() + 1 {
        return Expr { span, kind: ExprKind::Broken };
    }
    let counts: Vec<Node> = node.children_of(SyntaxKind::Count).collect();
    rest_of_chain(&parts, &operators, &counts, group)
}

/// Reads the rest of a chain of operators. `counts` are the counts of the remaining `::` operators.
fn rest_of_chain(parts: &[Node], operators: &[SyntaxKind], counts: &[Node], group: &mut Group<'_>) -> Expr {
    let joined = operators.iter().take_while(|&&operator| operator == Colon).count();
    let operands: Vec<Expr> = parts[..=joined].iter().map(|part| expression(part, group)).collect();
    let [first, .., last] = [&parts[0], &parts[parts.len() - 1]];
    let span = Span { start: first.span().start, ..last.span() };
    let Some((operator, others)) = operators.get(joined).zip(operators.get(joined + 1..)) else {
        return join(operands, span);
    };
    let mut operands = operands;
    let Some(operand) = operands.pop() else { return Expr { span, kind: ExprKind::Broken } };
    let (start, parts) = (operand.span.start, &parts[joined + 1..]);
    let rest = |counts: &[Node], group: &mut Group<'_>| rest_of_chain(parts, others, counts, group);
    let kind = if *operator == Recur {
        ExprKind::Recurrent(Box::new(operand), Box::new(rest(counts, group)))
    } else {
        let (count, counts) = counts.split_first().map_or((None, counts), |(count, counts)| (Some(count), counts));
        let pool = count.and_then(|count| replicate::pool(count, span, group, &mut |group| rest(counts, group)));
        pool.map_or(ExprKind::Broken, |pool| ExprKind::Asynchronous(Box::new(operand), pool))
    };
    operands.push(Expr { span: Span { start, ..span }, kind });
    join(operands, span)
}

fn join(mut operands: Vec<Expr>, span: Span) -> Expr {
    if operands.len() == 1 { operands.remove(0) } else { Expr { span, kind: ExprKind::Conditional(operands) } }
}

/// Reads `p? within 5 s as late`, from the inside to the outside.
fn suffixed(node: &Node, group: &mut Group<'_>) -> Expr {
    let span = node.span();
    let mut limits = node.children_of(Constant);
    let mut values = node.children_of(SyntaxKind::StartValue);
    let operand = node.children().find(|child| child.kind() != Constant);
    let Some(mut inner) = operand.map(|part| expression(&part, group)) else {
        return Expr { span, kind: ExprKind::Broken };
    };
    let mut depth = 0;
    let is_suffix = |token: &Token| {
        token.kind() == Question
            || token.kind() == SyntaxKind::Ident && ["within", "as", "with"].contains(&token.text())
    };
    let tokens: Vec<Token> = node.tokens().collect();
    let mut index = 0;
    while let Some(suffix) = tokens.get(index).filter(|token| is_suffix(token)) {
        index += 1;
        depth += 1;
        if depth > REPEAT_MAX {
            group.diagnostics().push(Diagnostic::new(
                Code::E0004,
                span,
                format!("more than {REPEAT_MAX} suffixes of one operand"),
            ));
            return Expr { span, kind: ExprKind::Broken };
        }
        let kind = if suffix.kind() == Question {
            let skip = Expr { span: suffix.span(), kind: ExprKind::Skip };
            ExprKind::Otherwise(vec![inner, skip])
        } else if suffix.text() == "with" {
            let value = values.next().and_then(|node| start_value(&node, group));
            value.map_or(ExprKind::Broken, |value| ExprKind::With(value, Box::new(inner)))
        } else if suffix.text() == "as" {
            let tag = tokens.get(index).filter(|token| token.kind() == SyntaxKind::Ident);
            index += 1;
            tag.map_or(ExprKind::Broken, |tag| ExprKind::Tagged(tag.name(), Box::new(inner)))
        } else {
            match limits.next().and_then(|node| group.reader().duration(&node)) {
                Some(limit) => ExprKind::Within(limit, Box::new(inner)),
                None => ExprKind::Broken,
            }
        };
        inner = Expr { span, kind };
    }
    inner
}

/// Reads `with shelf` or `with { x = 2 m }`.
fn start_value(node: &Node, group: &mut Group<'_>) -> Option<StartValue> {
    let constant = node.child(Constant)?;
    let name = constant.names().next().filter(|_| constant.children().next().is_none());
    if let Some(name) = name.as_ref().filter(|name| result::is_known(name, group)) {
        return Some(StartValue::Result(name.clone()));
    }
    if name.as_ref().is_some_and(|name| result::report_ended(name, group)) {
        return None;
    }
    let variable = name.and_then(|name| Some((*group.kept.variables.get(&name.text)?, name)));
    match variable {
        Some((Some(number), name)) => Some(StartValue::Kept(number, name)),
        Some((None, name)) => {
            let message =
                format!("`{}` is a number of this activity, so a program cannot start with its value", name.text);
            group.diagnostics().push(Diagnostic::new(Code::E0904, name.span, message));
            None
        }
        None => Some(StartValue::Known(group.value_reader().value(&constant))),
    }
}

fn retry(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let mut parts = parts(node, group);
    let expected = Expected::new(0..=RETRY_MAX, format!("the number of further tries, at most {RETRY_MAX}"));
    let times = expected.read(&node.child(SyntaxKind::Count)?, &mut group.reader())?;
    let pause = match node.child(Constant) {
        Some(pause) => Some(group.reader().duration(&pause)?),
        None => None,
    };
    Some(ExprKind::Retry(small(times), pause, Box::new(parts.pop()?)))
}

fn any_of(node: &Node, group: &mut Group<'_>) -> Option<ExprKind> {
    let parens = node.child(SyntaxKind::Paren)?;
    let candidates = parens.child(SyntaxKind::Concurrent);
    let mut candidates = parts(candidates.as_ref().unwrap_or(&parens), group);
    // In `any 2 of (all i in 0..3 (a[i]))`, the copies are the candidates.
    let is_all =
        parens.child(SyntaxKind::AllOf).is_some_and(|all| all.names().next().is_some_and(|it| it.text == "all"));
    if let [Expr { kind: ExprKind::Concurrent(copies), .. }] = candidates.as_mut_slice()
        && is_all
    {
        candidates = std::mem::take(copies);
    }
    let expected = Expected::new(1..=candidates.len(), format!("a count from 1 to {}", candidates.len()));
    let needed = expected.read(&node.child(SyntaxKind::Count)?, &mut group.reader())?;
    let is_at_least = node.tokens().next().is_some_and(|word| word.text() == "at");
    Some(if is_at_least { ExprKind::AtLeast } else { ExprKind::AnyOf }(small(needed), candidates))
}

fn small(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// Reads `name[label]`. `skip` and `never` are words of the language, unless an instance has this name.
fn run(node: &Node, group: &mut Group<'_>) -> Expr {
    let span = node.span();
    let Some(name) = node.names().next() else { return Expr { span, kind: ExprKind::Broken } };
    let Some((name, labels)) = replicate::run_of(node, name, group) else {
        group.damage.names = true;
        return Expr { span, kind: ExprKind::Broken };
    };
    if let ("skip" | "never", None) = (name.text.as_str(), group.names.find(&name.text)) {
        let kind = if name.text == "skip" { ExprKind::Skip } else { ExprKind::Never };
        return Expr { span, kind };
    }
    let Some(slot) = group.names.lenient(&name) else {
        group.damage.names = true;
        return Expr { span, kind: ExprKind::Broken };
    };
    group.run.push(slot);
    let sets = activated(&name, slot, &labels, group);
    Expr { span, kind: ExprKind::Run(slot, sets) }
}

/// Returns the sets that are open while the process runs: the sets with these labels, and the owner's sets without a
/// label.
fn activated(name: &Name, slot: usize, labels: &[Name], group: &mut Group<'_>) -> Vec<usize> {
    let sets = group.sets;
    let Some(owned) = group.owned.get(&slot).cloned() else {
        group.useless.extend(labels.iter().map(|label| (name.clone(), label.clone())));
        return Vec::new();
    };
    let label_of = |set: &usize| sets[*set].label.as_ref();
    let mut activated = owned.bare.clone();
    let mut is_open: BTreeSet<usize> = activated.iter().copied().collect();
    for label in labels {
        match owned.labelled.get(label.text.as_str()) {
            Some(&set) if is_open.insert(set) => activated.push(set),
            Some(_) => {}
            None if owned.labelled.is_empty() => group.useless.push((name.clone(), label.clone())),
            None if group.damage.connections || group.damage.actions => {}
            None => report_unknown_label(name, label, &owned, group),
        }
    }
    if labels.is_empty() && !owned.labelled.is_empty() && !group.damage.actions {
        let message = format!("`{}` runs without any of its connection sets", name.text);
        let mut diagnostic = Diagnostic::new(Code::W0304, name.span, message);
        for label in owned.first.iter().filter_map(label_of) {
            diagnostic = diagnostic
                .reason(label.span, format!("write `{}[{}]` to open this connection set", name.text, label.text));
        }
        group.diagnostics().push(diagnostic);
    }
    activated
}

fn report_unknown_label(name: &Name, label: &Name, owned: &OwnedSets<'_>, group: &mut Group<'_>) {
    let message = format!("`{}` has no connection set `{}`", name.text, label.text);
    let diagnostic = Diagnostic::new(Code::E0301, label.span, message);
    let sets = group.sets;
    let near = group.diagnostics().near(&label.text, owned.labelled.keys().copied());
    let set = |near: &Near<'_>| sets[*owned.labelled.get(near.name)?].label.as_ref();
    let diagnostic = match near.as_ref().and_then(|near| Some((near, set(near)?))) {
        Some((near, set)) if is_look_alike(&set.text, &label.text) => diagnostic
            .label(spell(&label.text))
            .reason(set.span, format!("this one is spelled {}", spell(&set.text)))
            .rename(label.span, near),
        Some((near, set)) => diagnostic.reason(set.span, "declared here").rename(label.span, near),
        None => diagnostic.help(format!("its connection sets are {}", listed(owned.labelled.keys().copied()))),
    };
    group.diagnostics().push(diagnostic);
}

/// Makes one diagnostic for all labels of the group that open no set.
pub(super) fn useless_labels(group: &Group<'_>) -> Option<Diagnostic> {
    if group.damage.connections || group.damage.actions {
        return None;
    }
    let (_, first) = group.useless.first()?;
    let all: Vec<String> = group.useless.iter().map(|(name, label)| format!("{}[{}]", name.text, label.text)).collect();
    let message = match all.len() {
        1 => format!("the label of `{}` activates nothing", all[0]),
        _ => format!("the labels of {} activate nothing", listed(all.iter().map(String::as_str))),
    };
    let mut diagnostic = Diagnostic::new(Code::W0302, first.span, message).label("its process owns no connection set");
    for (_, label) in &group.useless[1..] {
        diagnostic = diagnostic.reason(label.span, "nor does this one");
    }
    let (owner, label) = &group.useless[0];
    Some(diagnostic.help(format!("declare it with `internal_connections({}, {}) {{ ... }}`", owner.text, label.text)))
}
