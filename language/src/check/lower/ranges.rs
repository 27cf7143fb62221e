//! Checks ranges again: values that are passed through groups are known here for the first time.

use super::data::{Data, data};
use super::tree::Builder;
use crate::check::quantity;
use crate::check::range;
use crate::check::spec::{Arg, Expr, ExprKind, Param, Process, Shape, StartValue, Value, ValueKind};
use crate::check::types::{declared, takers};
use crate::plan::Constant;
use crate::source::Span;

impl Builder<'_> {
    /// Compares the arguments of an instance with the ranges of `params`. `outer` has the values of the parameters of
    /// the group around it.
    pub(super) fn check_ranges(&mut self, params: &[Param], args: &[&Arg], outer: &[Data]) {
        let mut positional = params.iter();
        for arg in args {
            let param = match &arg.name {
                Some(name) => params.iter().find(|param| param.name.text == name.text),
                None => positional.next(),
            };
            if let Some(param) = param {
                self.check_given(param, &arg.value, outer);
            }
        }
    }

    /// Compares the start values in a group with their ranges. `outer` has the values of the group's parameters.
    pub(super) fn check_starts(&mut self, process: &Process, expr: &Expr, outer: &[Data]) {
        if let ExprKind::With(StartValue::Known(value), part) = &expr.kind {
            let takers = takers(self.spec, process, part);
            if let Some((_, param)) = declared(&takers).first() {
                self.check_given(param, value, outer);
            }
        }
        expr.parts().into_iter().for_each(|part| self.check_starts(process, part, outer));
    }

    /// Compares an argument with the range of its parameter. A literal value was compared earlier, but the value of a
    /// name was not.
    fn check_given(&mut self, param: &Param, given: &Value, outer: &[Data]) {
        match (&given.kind, param.kind.as_ref().map(|kind| self.spec.shape(kind))) {
            (ValueKind::Param(_), _) => {
                if let Some(value) = data(given, outer) {
                    self.check_value(param, &value, given.span);
                }
            }
            (ValueKind::Record(values), Some(Shape::Record(fields))) => {
                for (name, value) in values {
                    if let Some(field) = fields.iter().find(|field| field.name.text == name.text) {
                        self.check_given(field, value, outer);
                    }
                }
            }
            (ValueKind::List(values), Some(Shape::List(element, _))) => {
                let element = param.element(element);
                values.iter().for_each(|value| self.check_given(&element, value, outer));
            }
            (ValueKind::Constant(_) | ValueKind::Record(_) | ValueKind::List(_) | ValueKind::Broken, _) => {}
        }
    }

    fn check_value(&mut self, param: &Param, value: &Data, span: Span) {
        match (value, param.kind.as_ref().map(|kind| self.spec.shape(kind))) {
            (Data::Plain(constant, dimension), shape @ (Some(Shape::Plain(_)) | None)) => {
                let kind = ValueKind::Constant(constant.clone());
                let misfit = match (constant, shape) {
                    (Constant::Number(_), Some(Shape::Plain(name))) => {
                        quantity::misfit(param, name, &Value { span, kind, dimension: *dimension })
                    }
                    (_, _) => None,
                };
                if let Some(misfit) = misfit {
                    self.report_once(misfit);
                } else if let Some(range) = param.range.as_ref().filter(|range| !range.has(constant)) {
                    self.report_once(range::outside(param, range, constant, span));
                }
            }
            (Data::Record(values), Some(Shape::Record(fields))) => {
                for (name, value) in values {
                    if let Some(field) = fields.iter().find(|field| field.name.text == *name) {
                        self.check_value(field, value, span);
                    }
                }
            }
            (Data::Record(values), Some(Shape::List(element, _))) => {
                let element = param.element(element);
                values.iter().for_each(|(_, value)| self.check_value(&element, value, span));
            }
            (Data::Plain(..) | Data::Record(_), _) => {}
        }
    }
}
