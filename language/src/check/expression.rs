//! Event-action expressions: tree to slots.

mod replicate;
mod scope;

use super::count::Expected;
use super::names::Names;
use super::spec::{Binding, Consts, Damage, Expr, ExprKind, Set};
use super::value::duration;
use crate::diagnostic::{Code, Diagnostic, Edit};
use crate::similar::{is_look_alike, nearest, spell};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Colon, Constant, DoubleColon, Question, Recur, Text};
use crate::syntax::ast::{Name, Node, Token};
use std::collections::BTreeSet;

/// The most tries of a `retry`: each is a copy of its operand.
const RETRY_MAX: usize = 100;
/// The most suffixes of one operand, and the most `;;` in one chain.
const REPEAT_MAX: usize = 8;

/// Makes an operator of its operands.
type Make = fn(Vec<Expr>) -> ExprKind;

/// What an expression may refer to, and what was found on the way.
pub(super) struct Group<'a> {
    pub(super) names: Names<'a>,
    pub(super) consts: &'a Consts,
    /// The index variables around, with their values.
    pub(super) indices: Vec<Binding>,
    pub(super) sets: &'a [Set],
    pub(super) resources: &'a [Name],
    /// Resources that are not declared, and were reported.
    pub(super) unknown: BTreeSet<String>,
    /// The place in the innermost pool around: the index of what stands there without one.
    pub(super) pool: Option<usize>,
    pub(super) damage: Damage,
    /// The slots that are run, in the order of the text.
    pub(super) run: Vec<usize>,
    /// The resources that are used.
    pub(super) taken: BTreeSet<usize>,
    /// Labels of processes that own no set.
    pub(super) useless: Vec<(Name, Name)>,
}

/// Reads the event actions of a group; returns nothing for an empty section.
pub(super) fn actions(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<Expr> {
    let parts: Vec<Expr> = node.children().map(|part| expression(&part, group, diagnostics)).collect();
    if let Some(diagnostic) = useless_labels(group) {
        diagnostics.push(diagnostic);
    }
    let mut parts = parts.into_iter();
    let first = parts.next()?;
    let rest: Vec<Expr> = parts.collect();
    if rest.is_empty() {
        return Some(first);
    }
    // More than one expression means that an operator is missing, which is reported already.
    Some(Expr { span: node.span(), kind: ExprKind::Sequence(std::iter::once(first).chain(rest).collect()) })
}

fn expression(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Expr {
    let span = node.span();
    let kind = node.kind();
    if kind == SyntaxKind::Run {
        return run(node, group, diagnostics);
    }
    if kind == SyntaxKind::Paren {
        let mut parts = parts(node, group, diagnostics);
        let is_single = parts.len() == 1;
        return match parts.pop() {
            Some(inner) if is_single => inner,
            Some(_) | None => Expr { span, kind: ExprKind::Broken },
        };
    }
    let operators: [(SyntaxKind, Make); 6] = [
        (SyntaxKind::Concurrent, ExprKind::Concurrent),
        (SyntaxKind::FailFast, ExprKind::FailFast),
        (SyntaxKind::Disable, ExprKind::Disable),
        (SyntaxKind::Sequence, ExprKind::Sequence),
        (SyntaxKind::Otherwise, ExprKind::Otherwise),
        (SyntaxKind::Finally, finally),
    ];
    let Some((_, make)) = operators.iter().find(|(operator, _)| *operator == kind) else {
        return special(node, group, diagnostics);
    };
    diagnostics.extend(side_by_side(node));
    let mut parts = parts(node, group, diagnostics);
    match parts.len() {
        0 => Expr { span, kind: ExprKind::Broken },
        // An accepted `,` or `;` at the end.
        1 => parts.remove(0),
        _ => Expr { span, kind: make(parts) },
    }
}

/// `a finally b finally c` is `(a finally b) finally c`.
fn finally(parts: Vec<Expr>) -> ExprKind {
    let join = |first: Expr, second: Expr| {
        let span = Span { end: second.span.end, ..first.span };
        Expr { span, kind: ExprKind::Finally(Box::new(first), Box::new(second)) }
    };
    parts.into_iter().reduce(join).map_or(ExprKind::Broken, |all| all.kind)
}

/// `a ; b # c`, `a # b , c` and `a ; b finally c`: right by the precedence, but read wrongly by many.
fn side_by_side(node: &Node) -> Option<Diagnostic> {
    let looser = [(SyntaxKind::Disable, SyntaxKind::Sequence), (SyntaxKind::Sequence, SyntaxKind::Finally)];
    let bare = looser.iter().find(|(outer, _)| *outer == node.kind()).map_or(SyntaxKind::Disable, |(_, inner)| *inner);
    let is_bare = |child: &Node| child.kind() == bare;
    let child = node.children().find(is_bare)?;
    let (outer, inner) = (node.kind().describe(), child.kind().describe());
    let span = child.span();
    let message = format!("{inner} stands beside {outer} without parentheses");
    let diagnostic = Diagnostic::new(Code::W0404, span, message).label("these belong together");
    let insert = |span: Span, text: &str| Edit { span, text: text.to_owned() };
    let edits = vec![insert(span.at_start(), "("), insert(span.at_end(), ")")];
    Some(diagnostic.fix("put parentheses around it", edits))
}

fn parts(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Vec<Expr> {
    let no_operands = [Constant, SyntaxKind::Count, SyntaxKind::Resources];
    let operands = node.children().filter(|child| !no_operands.contains(&child.kind()));
    operands.map(|part| expression(&part, group, diagnostics)).collect()
}

fn special(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Expr {
    let span = node.span();
    let kind = if node.kind() == SyntaxKind::Chain {
        return chain(node, group, diagnostics);
    } else if node.kind() == SyntaxKind::Suffixed {
        return suffixed(node, group, diagnostics);
    } else if node.kind() == SyntaxKind::AllOf {
        replicate::all_of(node, group, diagnostics)
    } else if node.kind() == SyntaxKind::Retry {
        retry(node, group, diagnostics)
    } else if node.kind() == SyntaxKind::Shield {
        scope::shield(node, group, diagnostics)
    } else if node.kind() == SyntaxKind::Using {
        scope::using(node, group, diagnostics)
    } else if node.kind() == SyntaxKind::Match {
        scope::matching(node, group, diagnostics)
    } else if node.kind() == SyntaxKind::AnyOf {
        any_of(node, group, diagnostics)
    } else if node.kind() == SyntaxKind::Fail {
        node.token(Text).map(|reason| ExprKind::Fail(reason.content()))
    } else if node.kind() == SyntaxKind::Wait {
        let limit = node.child(Constant).and_then(|node| duration(&node, group.consts, diagnostics));
        limit.map(ExprKind::Wait)
    } else {
        None
    };
    Expr { span, kind: kind.unwrap_or(ExprKind::Broken) }
}

/// `a : b ;; c : d` is `a : (b ;; (c : d))`, and so for `::`, whose second operand is written out for each place.
fn chain(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Expr {
    let operators = node.tokens().map(|token| token.kind());
    let operators: Vec<SyntaxKind> = operators.filter(|kind| [Colon, Recur, DoubleColon].contains(kind)).collect();
    let span = node.span();
    let loops = operators.iter().filter(|&&operator| operator != Colon).count();
    let parts: Vec<Node> = node.children().filter(|part| part.kind() != SyntaxKind::Count).collect();
    if loops > REPEAT_MAX {
        diagnostics.push(Diagnostic::new(
            Code::E0004,
            span,
            format!("more than {REPEAT_MAX} `;;` and `::` in a chain"),
        ));
    }
    if loops > REPEAT_MAX || parts.len() != operators.len() + 1 {
        return Expr { span, kind: ExprKind::Broken };
    }
    let counts: Vec<Node> = node.children_of(SyntaxKind::Count).collect();
    rest_of_chain(&parts, &operators, &counts, (group, diagnostics))
}

/// What comes from one operand on; `counts` are those of the `::` that are left.
fn rest_of_chain(
    parts: &[Node],
    operators: &[SyntaxKind],
    counts: &[Node],
    (group, diagnostics): (&mut Group<'_>, &mut Vec<Diagnostic>),
) -> Expr {
    let joined = operators.iter().take_while(|&&operator| operator == Colon).count();
    let operands: Vec<Expr> = parts[..=joined].iter().map(|part| expression(part, group, diagnostics)).collect();
    let [first, .., last] = [&parts[0], &parts[parts.len() - 1]];
    let span = Span { start: first.span().start, ..last.span() };
    let Some((operator, others)) = operators.get(joined).zip(operators.get(joined + 1..)) else {
        return join(operands, span);
    };
    let mut operands = operands;
    let Some(operand) = operands.pop() else { return Expr { span, kind: ExprKind::Broken } };
    let (start, parts) = (operand.span.start, &parts[joined + 1..]);
    let rest = |counts: &[Node], group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>| {
        rest_of_chain(parts, others, counts, (group, diagnostics))
    };
    let kind = if *operator == Recur {
        ExprKind::Recurrent(Box::new(operand), Box::new(rest(counts, group, diagnostics)))
    } else {
        let (count, counts) = counts.split_first().map_or((None, counts), |(count, counts)| (Some(count), counts));
        let pool = count.and_then(|count| {
            replicate::pool(count, span, (group, diagnostics), &mut |group, found| rest(counts, group, found))
        });
        pool.map_or(ExprKind::Broken, |pool| ExprKind::Asynchronous(Box::new(operand), pool))
    };
    operands.push(Expr { span: Span { start, ..span }, kind });
    join(operands, span)
}

fn join(mut operands: Vec<Expr>, span: Span) -> Expr {
    if operands.len() == 1 { operands.remove(0) } else { Expr { span, kind: ExprKind::Conditional(operands) } }
}

/// `p? within 5 s as late`, from the inside to the outside.
fn suffixed(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Expr {
    let span = node.span();
    let mut limits = node.children_of(Constant);
    let operand = node.children().find(|child| child.kind() != Constant);
    let Some(mut inner) = operand.map(|part| expression(&part, group, diagnostics)) else {
        return Expr { span, kind: ExprKind::Broken };
    };
    let mut depth = 0;
    let is_suffix = |token: &Token| {
        token.kind() == Question || token.kind() == SyntaxKind::Ident && ["within", "as"].contains(&token.text())
    };
    let tokens: Vec<Token> = node.tokens().collect();
    let mut index = 0;
    while let Some(suffix) = tokens.get(index).filter(|token| is_suffix(token)) {
        index += 1;
        depth += 1;
        if depth > REPEAT_MAX {
            diagnostics.push(Diagnostic::new(
                Code::E0004,
                span,
                format!("more than {REPEAT_MAX} suffixes of one operand"),
            ));
            return Expr { span, kind: ExprKind::Broken };
        }
        let kind = if suffix.kind() == Question {
            let skip = Expr { span: suffix.span(), kind: ExprKind::Skip };
            ExprKind::Otherwise(vec![inner, skip])
        } else if suffix.text() == "as" {
            let tag = tokens.get(index).filter(|token| token.kind() == SyntaxKind::Ident);
            index += 1;
            tag.map_or(ExprKind::Broken, |tag| ExprKind::Tagged(tag.name(), Box::new(inner)))
        } else {
            match limits.next().and_then(|node| duration(&node, group.consts, diagnostics)) {
                Some(limit) => ExprKind::Within(limit, Box::new(inner)),
                None => ExprKind::Broken,
            }
        };
        inner = Expr { span, kind };
    }
    inner
}

fn retry(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<ExprKind> {
    let mut parts = parts(node, group, diagnostics);
    let expected = Expected::new(0..=RETRY_MAX, format!("how many times to try again, at most {RETRY_MAX}"));
    let times = expected.read(&node.child(SyntaxKind::Count)?, group.consts, diagnostics)?;
    let pause = match node.child(Constant) {
        Some(pause) => Some(duration(&pause, group.consts, diagnostics)?),
        None => None,
    };
    Some(ExprKind::Retry(small(times), pause, Box::new(parts.pop()?)))
}

fn any_of(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Option<ExprKind> {
    let parens = node.child(SyntaxKind::Paren)?;
    let candidates = parens.child(SyntaxKind::Concurrent);
    let mut candidates = parts(candidates.as_ref().unwrap_or(&parens), group, diagnostics);
    // `any 2 of (all i in 0..3 (a[i]))`: the copies are the candidates.
    let is_all =
        parens.child(SyntaxKind::AllOf).is_some_and(|all| all.names().next().is_some_and(|it| it.text == "all"));
    if let [Expr { kind: ExprKind::Concurrent(copies), .. }] = candidates.as_mut_slice()
        && is_all
    {
        candidates = std::mem::take(copies);
    }
    let expected = Expected::new(1..=candidates.len(), format!("a count from 1 to {}", candidates.len()));
    let needed = expected.read(&node.child(SyntaxKind::Count)?, group.consts, diagnostics)?;
    Some(ExprKind::AnyOf(small(needed), candidates))
}

fn small(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// `name[label]`; `skip` and `never` are words unless an instance is called so.
fn run(node: &Node, group: &mut Group<'_>, diagnostics: &mut Vec<Diagnostic>) -> Expr {
    let span = node.span();
    let Some(name) = node.names().next() else { return Expr { span, kind: ExprKind::Broken } };
    let Some((name, labels)) = replicate::run_of(node, name, group, diagnostics) else {
        group.damage.names = true;
        return Expr { span, kind: ExprKind::Broken };
    };
    if let ("skip" | "never", None) = (name.text.as_str(), group.names.find(&name.text)) {
        let kind = if name.text == "skip" { ExprKind::Skip } else { ExprKind::Never };
        return Expr { span, kind };
    }
    let Some(slot) = group.names.lenient(&name, diagnostics) else {
        group.damage.names = true;
        return Expr { span, kind: ExprKind::Broken };
    };
    group.run.push(slot);
    let sets = activated(&name, slot, &labels, group, diagnostics);
    Expr { span, kind: ExprKind::Run(slot, sets) }
}

/// The sets that are open while the process runs: those that are named, and the owner's set without a label.
fn activated(
    name: &Name,
    slot: usize,
    labels: &[Name],
    group: &mut Group<'_>,
    diagnostics: &mut Vec<Diagnostic>,
) -> Vec<usize> {
    let owned: Vec<usize> = (0..group.sets.len()).filter(|&set| group.sets[set].owner == Some(slot)).collect();
    let label_of = |set: &usize| group.sets[*set].label.as_ref();
    let mut activated: Vec<usize> = owned.iter().copied().filter(|set| label_of(set).is_none()).collect();
    let labelled: Vec<usize> = owned.iter().copied().filter(|set| label_of(set).is_some()).collect();
    for label in labels {
        let is_called = |set: &&usize| label_of(set).is_some_and(|other| other.text == label.text);
        match labelled.iter().find(is_called) {
            Some(&set) if activated.contains(&set) => {}
            Some(&set) => activated.push(set),
            None if labelled.is_empty() => group.useless.push((name.clone(), label.clone())),
            None if group.damage.connections || group.damage.actions => {}
            None => {
                let known = labelled.iter().filter_map(label_of).collect::<Vec<_>>();
                diagnostics.push(unknown_label(name, label, &known));
            }
        }
    }
    if labels.is_empty() && !labelled.is_empty() && !group.damage.actions {
        let message = format!("`{}` runs with none of its connection sets", name.text);
        let mut diagnostic = Diagnostic::new(Code::W0304, name.span, message);
        for label in labelled.iter().filter_map(label_of) {
            diagnostic =
                diagnostic.reason(label.span, format!("write `{}[{}]` to open this one", name.text, label.text));
        }
        diagnostics.push(diagnostic);
    }
    activated
}

fn unknown_label(name: &Name, label: &Name, known: &[&Name]) -> Diagnostic {
    let message = format!("`{}` has no connection set `{}`", name.text, label.text);
    let diagnostic = Diagnostic::new(Code::E0301, label.span, message);
    let texts = || known.iter().map(|other| other.text.as_str());
    let near = nearest(&label.text, texts()).and_then(|near| known.iter().find(|other| other.text == near));
    match near {
        Some(near) if is_look_alike(&near.text, &label.text) => diagnostic
            .label(spell(&label.text))
            .reason(near.span, format!("this one is spelled {}", spell(&near.text)))
            .replace(label.span, &near.text),
        Some(near) => diagnostic.reason(near.span, "declared here").replace(label.span, &near.text),
        None => {
            let known: Vec<String> = texts().map(|text| format!("`{text}`")).collect();
            diagnostic.help(format!("its connection sets are {}", known.join(", ")))
        }
    }
}

/// One report for all labels of the group that activate nothing.
fn useless_labels(group: &Group<'_>) -> Option<Diagnostic> {
    if group.damage.connections || group.damage.actions {
        return None;
    }
    let (_, first) = group.useless.first()?;
    let listed: Vec<String> =
        group.useless.iter().map(|(name, label)| format!("`{}[{}]`", name.text, label.text)).collect();
    let message = match listed.len() {
        1 => format!("the label of {} activates nothing", listed[0]),
        _ => format!("the labels of {} activate nothing", listed.join(", ")),
    };
    let mut diagnostic = Diagnostic::new(Code::W0302, first.span, message).label("its process owns no connection set");
    for (_, label) in &group.useless[1..] {
        diagnostic = diagnostic.reason(label.span, "nor does this one");
    }
    let (owner, label) = &group.useless[0];
    Some(diagnostic.help(format!("declare it with `internal_connections({}, {}) {{ ... }}`", owner.text, label.text)))
}
