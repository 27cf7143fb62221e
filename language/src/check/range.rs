//! The allowed values of a parameter: `in 1..200`, `in "open" | "close"`.

use super::spec::{Param, Shape, Spec, Value, ValueKind};
use super::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, DotDot};
use crate::syntax::ast::Node;
use crate::unit;
use std::fmt;

/// The allowed values of a parameter.
#[derive(Clone, Debug)]
pub(crate) struct Range {
    pub(crate) values: Values,
    pub(crate) span: Span,
}

#[derive(Clone, Debug)]
pub(crate) enum Values {
    /// The values from the first to the second, both included. Without an end, that side has no limit.
    Between(Option<Value>, Option<Value>),
    OneOf(Vec<Value>),
}

impl Range {
    /// Reads the text after `in`.
    pub(super) fn read(node: &Node, reader: &mut Reader<'_>) -> Option<Self> {
        let values: Vec<Value> = node.children_of(SyntaxKind::Constant).map(|node| reader.value(&node)).collect();
        if values.iter().any(|value| matches!(value.kind, ValueKind::Broken)) {
            return None;
        }
        let span = node.span();
        let Some(dots) = node.token(DotDot) else {
            return (!values.is_empty()).then_some(Self { values: Values::OneOf(values), span });
        };
        let (low, high): (Vec<Value>, Vec<Value>) =
            values.into_iter().partition(|value| value.span.start < dots.span().start);
        let (low, high) = (low.into_iter().next(), high.into_iter().next());
        if let (Some(low), Some(high)) = (low.as_ref().and_then(number), high.as_ref().and_then(number))
            && low > high
        {
            let message = format!("no value is from {low} to {high}");
            reader.diagnostics.push(Diagnostic::new(Code::E0009, span, message).help("the smaller number comes first"));
            return None;
        }
        Some(Self { values: Values::Between(low, high), span })
    }

    /// Returns the values in the text of the range.
    pub(super) fn written(&self) -> impl Iterator<Item = &Value> {
        let (ends, all) = match &self.values {
            Values::Between(low, high) => ([low.as_ref(), high.as_ref()], &[][..]),
            Values::OneOf(all) => ([None, None], all.as_slice()),
        };
        ends.into_iter().flatten().chain(all)
    }

    /// Returns whether a value is allowed.
    pub(crate) fn has(&self, value: &Constant) -> bool {
        match &self.values {
            Values::Between(low, high) => {
                let Constant::Number(value) = value else { return false };
                let end = |end: &Option<Value>| end.as_ref().and_then(number);
                end(low).is_none_or(|low| low <= *value) && end(high).is_none_or(|high| *value <= high)
            }
            Values::OneOf(all) => all.iter().any(|one| matches!(&one.kind, ValueKind::Constant(one) if one == value)),
        }
    }

    /// Returns the allowed values as text, such as `a value from 1 N to 200 N`. `unit` is the unit of the numbers, if
    /// they have one.
    pub(crate) fn expected(&self, unit: Option<&str>) -> String {
        let with_unit = |value: &Value| in_unit(value, unit);
        match &self.values {
            Values::Between(Some(low), Some(high)) => {
                format!("a value from {} to {}", with_unit(low), with_unit(high))
            }
            Values::Between(Some(low), None) => format!("a value of {} or more", with_unit(low)),
            Values::Between(None, Some(high)) => format!("a value of {} or less", with_unit(high)),
            Values::Between(None, None) => "a number".to_owned(),
            Values::OneOf(all) => {
                let all: Vec<String> = all.iter().map(with_unit).collect();
                if all.len() == 1 { all.join("") } else { format!("one of {}", all.join(", ")) }
            }
        }
    }
}

fn in_unit(value: &Value, unit: Option<&str>) -> String {
    unit.map_or_else(|| value.to_string(), |unit| format!("{value} {unit}"))
}

/// Writes `1..200` or `"open" | "close"`, in SI units.
impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.values {
            Values::Between(low, high) => {
                let end = |end: &Option<Value>| end.as_ref().map(Value::to_string).unwrap_or_default();
                write!(f, "{}..{}", end(low), end(high))
            }
            Values::OneOf(all) => {
                let all: Vec<String> = all.iter().map(Value::to_string).collect();
                f.write_str(&all.join(" | "))
            }
        }
    }
}

fn number(value: &Value) -> Option<f64> {
    match value.kind {
        ValueKind::Constant(Constant::Number(number)) => Some(number),
        ValueKind::Constant(Constant::Text(_) | Constant::Truth(_) | Constant::Secret(_))
        | ValueKind::Param(_)
        | ValueKind::Record(_)
        | ValueKind::List(_)
        | ValueKind::Broken => None,
    }
}

/// Returns the diagnostic for a value that is not allowed for a parameter.
pub(crate) fn outside(param: &Param, range: &Range, value: &Constant, span: Span) -> Diagnostic {
    let value = Value { span, kind: ValueKind::Constant(value.clone()), dimension: None };
    let unit = param.kind.as_ref().and_then(|kind| unit::symbol(&kind.text));
    let (value, expected) = (in_unit(&value, unit.as_deref()), range.expected(unit.as_deref()));
    let message = format!("`{}` is {value}: expected {expected}", param.name.text);
    Diagnostic::new(Code::E0217, span, message).reason(range.span, "declared here")
}

/// Returns whether values of this parameter are compared with the range as a whole. For a list, the elements are
/// compared instead.
pub(crate) fn is_plain(spec: &Spec, param: &Param) -> bool {
    param.kind.as_ref().is_none_or(|kind| matches!(spec.shape(kind), Shape::Plain(_)))
}
