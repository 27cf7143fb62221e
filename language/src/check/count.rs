//! Reads whole numbers: sizes of arrays, numbers of attempts of a `retry`, places of a pool.
//!
//! Such a number is a literal, or the name of a constant or of a parameter of the group. When a parameter is read here, it already has the
//! value of the argument, so a wrong value is reported at the argument.

use super::spec::{Const, Consts, Value, ValueKind};
use super::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::source::Span;
use crate::syntax::SyntaxKind::{Ident, Number};
use crate::syntax::ast::{Node, Token};
use std::ops::RangeInclusive;

/// The kinds of text in the position of a whole number.
pub(super) enum CountValue<'a> {
    Number(usize),
    /// The text is not a whole number. If it is the name of a constant or parameter, this is the declaration.
    Other(Option<&'a Const>),
    /// The text names a declaration that could not be read, which is already reported.
    Broken,
}

/// Reads a number, or the name of a number.
pub(super) fn whole<'a>(token: &Token, consts: &'a Consts) -> CountValue<'a> {
    let (number, named) = if token.kind() == Number {
        (token.text().parse().ok(), None)
    } else {
        match consts.get(token.text()) {
            Some(named) if named.is_broken() => return CountValue::Broken,
            Some(named) => (of_const(named), Some(named)),
            None => (None, None),
        }
    };
    number.map_or(CountValue::Other(named), CountValue::Number)
}

fn of_const(named: &Const) -> Option<usize> {
    let value = named.values.first().filter(|value| !named.is_list && value.dimension.is_none())?;
    match &value.kind {
        ValueKind::Constant(Constant::Number(number)) => number.to_string().parse().ok(),
        ValueKind::Constant(Constant::Text(_) | Constant::Truth(_) | Constant::Secret(_))
        | ValueKind::Record(_)
        | ValueKind::List(_)
        | ValueKind::Param(_)
        | ValueKind::Broken => None,
    }
}

/// The allowed range of a whole number, and the words for the range.
pub(super) struct Expected {
    pub(super) bounds: RangeInclusive<usize>,
    /// The text after "expected": `how many times to try again, at most 100`.
    pub(super) what: String,
    pub(super) help: Option<&'static str>,
}

impl Expected {
    pub(super) fn new(bounds: RangeInclusive<usize>, what: impl Into<String>) -> Self {
        Self { bounds, what: what.into(), help: None }
    }

    /// Reads the number in a node. Reports a value that is not an allowed number.
    pub(super) fn read(&self, node: &Node, reader: &mut Reader<'_>) -> Option<usize> {
        let consts = reader.scope.consts;
        // If the node has neither a number nor a name, the text is damaged.
        let token = node.tokens().find(|token| [Number, Ident].contains(&token.kind()))?;
        let named = match whole(&token, consts) {
            CountValue::Number(number) if self.bounds.contains(&number) => return Some(number),
            CountValue::Number(_) => consts.get(token.text()),
            CountValue::Other(named) => named,
            CountValue::Broken => return None,
        };
        let mut diagnostic = wrong(node.span(), named, format!("expected {}", self.what));
        diagnostic.help.extend(self.help.map(str::to_owned));
        reader.diagnostics.push(diagnostic);
        None
    }
}

/// Makes a diagnostic for a wrong value. Its place is the argument, if the value comes from a parameter of the group, otherwise the use.
pub(super) fn wrong(used: Span, named: Option<&Const>, message: impl Into<String>) -> Diagnostic {
    let Some(named) = named else { return Diagnostic::new(Code::E0009, used, message) };
    match named.values.first() {
        Some(Value { span, .. }) if named.is_param => {
            Diagnostic::new(Code::E0009, *span, message).reason(used, format!("`{}` is used here", named.name.text))
        }
        Some(_) | None => Diagnostic::new(Code::E0009, used, message).reason(named.name.span, "declared here"),
    }
}
