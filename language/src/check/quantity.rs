//! Checks whether a value is a quantity that a parameter can have.

use super::spec::{Param, Value, ValueKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::unit;

/// Returns a diagnostic if a value is not a quantity of the type `kind`. Returns none if it is, or if `kind` is not a
/// type of quantities.
pub(super) fn misfit(param: &Param, kind: &str, value: &Value) -> Option<Diagnostic> {
    let (dimension, example) = unit::of_type(kind)?;
    let number = match &value.kind {
        ValueKind::Constant(Constant::Number(number)) => Some(*number),
        ValueKind::Constant(Constant::Text(_) | Constant::Truth(_) | Constant::Secret(_))
        | ValueKind::Param(_)
        | ValueKind::Record(_)
        | ValueKind::List(_)
        | ValueKind::Broken => None,
    };
    if number.is_some() && value.dimension == Some(dimension) {
        return None;
    }
    let message = format!("`{}` is of type {kind}: expected a quantity such as `{example}`", param.name.text);
    let diagnostic = Diagnostic::new(Code::E0213, value.span, message).reason(param.name.span, "declared here");
    Some(match (number, value.dimension) {
        (Some(_), Some(other)) => {
            let label = unit::type_of(other).unwrap_or("another quantity");
            diagnostic.label(label).help(format!("write it in {}", unit::spellings(kind)))
        }
        (Some(number), None) => {
            let symbol = unit::symbol(kind).unwrap_or_default();
            diagnostic.label("no unit").help(format!("in SI units it is `{number} {symbol}`"))
        }
        (None, _) => diagnostic,
    })
}
