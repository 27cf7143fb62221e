//! Checks `P else Q` and `P else match { timeout => Q, "no way" => R }`.

use super::{Group, expression, report_side_by_side};
use crate::automaton::Failure;
use crate::check::diagnostics::Diagnostics;
use crate::check::names::twice;
use crate::check::spec::{CatchArm, Expr, ExprKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Text};
use crate::syntax::ast::{Node, catches};

/// Reads `a else b else match { ... } else c` as `((a else b) else match { ... }) else c`.
pub(super) fn otherwise(node: &Node, group: &mut Group<'_>) -> Expr {
    report_side_by_side(node, group);
    let mut tried: Vec<Expr> = Vec::new();
    for part in node.children() {
        let matching = bare(&part);
        if catches(&matching) {
            let arms = arms(&matching, group);
            let before = one(std::mem::take(&mut tried), node.span());
            let span = Span { end: part.span().end, ..before.span };
            let kind = if arms.is_empty() { ExprKind::Broken } else { ExprKind::Catch(Box::new(before), arms) };
            tried.push(Expr { span, kind });
        } else {
            tried.push(expression(&part, group));
        }
    }
    one(tried, node.span())
}

/// Returns the operand inside any parentheses.
fn bare(part: &Node) -> Node {
    let inner = part.children().next().filter(|_| part.kind() == SyntaxKind::Paren);
    inner.map_or_else(|| part.clone(), |inner| bare(&inner))
}

fn one(mut parts: Vec<Expr>, around: Span) -> Expr {
    match parts.len() {
        0 => Expr { span: around, kind: ExprKind::Broken },
        1 => parts.remove(0),
        _ => {
            let end = parts.last().map_or(around.end, |last| last.span.end);
            Expr { span: Span { end, ..parts[0].span }, kind: ExprKind::Otherwise(parts) }
        }
    }
}

fn arms(node: &Node, group: &mut Group<'_>) -> Vec<CatchArm> {
    let mut arms: Vec<CatchArm> = Vec::new();
    for part in node.children_of(SyntaxKind::Arm) {
        let mut names = part.names();
        let value = if part.token(Text).is_some() { names.next() } else { names.nth(1) };
        if let Some(value) = value {
            let found = Diagnostic::new(Code::E0001, value.span, format!("expected `=>`, found `{}`", value.text));
            group.diagnostics().push(found.help("a failure has no value, so no name can stand for it"));
            continue;
        }
        let Some(body) = part.children().next().map(|body| expression(&body, group)) else { continue };
        let Some(span) = part.tokens().next().map(|first| first.span()) else { continue };
        let failure = match part.names().next().filter(|_| part.token(Text).is_none()) {
            Some(name) if name.text == "else" => None,
            _ => match failure(&part, group.diagnostics()) {
                Some(Ok(failure)) => Some(failure),
                Some(Err(found)) => {
                    group.diagnostics().push(found);
                    continue;
                }
                None => continue,
            },
        };
        if let Some(known) = arms.iter().find(|known| known.failure == failure) {
            let (word, first) = (failure.map_or_else(|| "else".to_owned(), |it| it.to_string()), known.span);
            group.diagnostics().push(twice("arm", &word, span, first));
            continue;
        }
        if let Some(last) = arms.last().filter(|last| last.failure.is_none()) {
            let message = "this arm is never taken: the `else` before it takes every failure";
            let found = Diagnostic::new(Code::W0422, span, message).label("never taken");
            let found = found.reason(last.span, "taken instead").help("put `else` last");
            group.diagnostics().push(found);
            continue;
        }
        arms.push(CatchArm { failure, span, body });
    }
    arms
}

/// Reads the cause or the text of a failure: `timeout`, `"no way"`. A wrong word gives a diagnostic. A missing word gives none.
pub(in crate::check) fn failure(node: &Node, diagnostics: &mut Diagnostics) -> Option<Result<Failure, Diagnostic>> {
    if let Some(text) = node.token(Text) {
        return Some(Ok(Failure::of_text(&text.content())));
    }
    let name = node.names().next()?;
    if let Some(failure) = Failure::of_word(&name.text) {
        return Some(Ok(failure));
    }
    let message = format!("`{}` is not a cause of a failure", name.text);
    let found = Diagnostic::new(Code::E0429, name.span, message);
    let near = diagnostics.near(&name.text, Failure::WORDS.iter().map(|(word, _)| *word));
    let words: Vec<String> = Failure::WORDS.iter().map(|(word, _)| format!("`{word}`")).collect();
    Some(Err(match near {
        Some(near) => found.rename(name.span, &near),
        None => found.help(format!("write {}, or the text of a `fail`: `\"no way\"`", words.join(", "))),
    }))
}
