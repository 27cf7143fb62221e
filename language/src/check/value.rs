//! Constants, quantities and durations.

use super::spec::{Param, Value, ValueKind};
use super::unit::{self, Dimension};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::similar::nearest;
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Ident, Minus, Number, Text};
use crate::syntax::ast::{Name, Node};
use std::time::Duration;

/// The longest time that a spec can name: a hundred years.
const SECONDS_MAX: f64 = 100.0 * 366.0 * 86_400.0;

/// Reads a constant node; a name may be one of `params`, else it stands for itself.
pub(super) fn value(node: &Node, params: &[Param], diagnostics: &mut Vec<Diagnostic>) -> Value {
    let span = node.span();
    let kind = if let Some(text) = node.token(Text) {
        ValueKind::Constant(Constant::Text(text.content()))
    } else if node.token(Number).is_some() {
        let number = quantity(node, diagnostics).map(|(number, _)| ValueKind::Constant(Constant::Number(number)));
        number.unwrap_or(ValueKind::Broken)
    } else {
        node.names().next().map_or(ValueKind::Broken, |name| symbol(&name, params, diagnostics))
    };
    Value { span, kind }
}

/// What a name means as a value: a truth, a parameter, or itself.
pub(super) fn symbol(name: &Name, params: &[Param], diagnostics: &mut Vec<Diagnostic>) -> ValueKind {
    if let "true" | "false" = name.text.as_str() {
        return ValueKind::Constant(Constant::Truth(name.text == "true"));
    }
    if let Some(index) = params.iter().position(|param| param.name.text == name.text) {
        return ValueKind::Param(index);
    }
    if let Some(near) = nearest(&name.text, params.iter().map(|param| param.name.text.as_str())) {
        let message = format!("`{}` is no parameter: it stands for itself", name.text);
        let diagnostic = Diagnostic::new(Code::W0106, name.span, message).label(format!("did you mean `{near}`?"));
        diagnostics.push(diagnostic.help(format!("write `\"{}\"` if it is meant as text", name.text)));
    }
    ValueKind::Constant(Constant::Text(name.text.clone()))
}

/// Reads a number with an optional unit; returns it in SI.
pub(super) fn quantity(node: &Node, diagnostics: &mut Vec<Diagnostic>) -> Option<(f64, Option<Dimension>)> {
    let number = node.token(Number)?;
    let Some(mut value) = number.number() else {
        diagnostics.push(Diagnostic::new(Code::E0009, number.span(), "the number is too large"));
        return None;
    };
    if node.token(Minus).is_some() {
        value = -value;
    }
    let units: Vec<Name> = node.tokens().filter(|token| token.kind() == Ident).map(|token| token.name()).collect();
    let Some(first) = units.first() else { return Some((value, None)) };
    let per = units.get(1);
    let Some((factor, dimension)) = unit::unit(&first.text, per.map(|name| name.text.as_str())) else {
        diagnostics.push(unknown_unit(first, per));
        return None;
    };
    Some((value * factor, Some(dimension)))
}

fn unknown_unit(first: &Name, per: Option<&Name>) -> Diagnostic {
    let is_known = |name: &&Name| unit::unit(&name.text, None).is_some();
    let wrong = per.filter(|per| is_known(&first) && !is_known(per)).unwrap_or(first);
    let diagnostic = Diagnostic::new(Code::E0008, wrong.span, format!("unknown unit `{}`", wrong.text));
    match nearest(&wrong.text, unit::symbols()) {
        Some(near) => diagnostic.label(format!("did you mean `{near}`?")),
        None => {
            diagnostic.help("units are those of `s`, `m`, `rad`, `Hz`, `N`, `kg`, `A`, `V`, `B` and their multiples")
        }
    }
}

/// Reads a time; reports anything else.
pub(super) fn duration(node: &Node, diagnostics: &mut Vec<Diagnostic>) -> Option<Duration> {
    let span: Span = node.span();
    if node.kind() != SyntaxKind::Constant || node.token(Number).is_none() {
        diagnostics.push(Diagnostic::new(Code::E0009, span, "expected a time, such as `5 s`"));
        return None;
    }
    let (seconds, dimension) = quantity(node, diagnostics)?;
    if dimension != Some(Dimension::TIME) || !(0.0..=SECONDS_MAX).contains(&seconds) {
        let written = node.compact_text();
        let diagnostic = Diagnostic::new(Code::E0009, span, format!("`{written}` is not a time"));
        diagnostics.push(diagnostic.help("a time has a unit, and is not negative: `5 s`, `20 ms`"));
        return None;
    }
    Duration::try_from_secs_f64(seconds).ok()
}
