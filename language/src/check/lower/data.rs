//! Values of arguments with every name replaced, in the form for programs. A record becomes one argument for each field, such as
//! `grasp.force=20`, so a program need not know records. The field names of a list are its indices.

use crate::check::spec::{Param, Shape, Spec, Value, ValueKind};
use crate::plan::{Argument, Constant};
use crate::unit::Dimension;

/// A value without names of parameters.
#[derive(Clone, Debug)]
pub(super) enum Data {
    /// A constant, with its dimension if it has a unit.
    Plain(Constant, Option<Dimension>),
    Record(Vec<(String, Self)>),
}

/// Returns the value of an argument in a group with these parameter values.
pub(super) fn data(value: &Value, outer: &[Data]) -> Option<Data> {
    match &value.kind {
        ValueKind::Constant(constant) => Some(Data::Plain(constant.clone(), value.dimension)),
        ValueKind::Param(index) => outer.get(*index).cloned(),
        ValueKind::Record(fields) => {
            let fields = fields.iter().map(|(name, value)| Some((name.text.clone(), data(value, outer)?)));
            fields.collect::<Option<_>>().map(Data::Record)
        }
        ValueKind::List(values) => {
            let values =
                (0..).zip(values).map(|(index, value): (usize, _)| Some((index.to_string(), data(value, outer)?)));
            values.collect::<Option<_>>().map(Data::Record)
        }
        ValueKind::Broken => None,
    }
}

/// Returns the value of a parameter: the given value, otherwise the default. Missing fields get their defaults. The fields have the order
/// of the type.
pub(super) fn filled(spec: &Spec, param: &Param, given: Option<Data>) -> Option<Data> {
    let given = given.or_else(|| param.default.as_ref().and_then(|value| data(value, &[])));
    let shape = param.kind.as_ref().map(|kind| spec.shape(kind));
    if let (Some(Shape::List(element, _)), Some(Data::Record(values))) = (shape, &given) {
        let element = param.element(element);
        let values =
            values.iter().cloned().filter_map(|(index, value)| Some((index, filled(spec, &element, Some(value))?)));
        return Some(Data::Record(values.collect()));
    }
    let (Some(Shape::Record(fields)), None | Some(Data::Record(_))) = (shape, &given) else { return given };
    let mut given = match given {
        Some(Data::Record(given)) => given,
        Some(Data::Plain(..)) | None => Vec::new(),
    };
    let fields = fields.iter().filter_map(|field| {
        let own = given.iter().position(|(name, _)| *name == field.name.text).map(|own| given.swap_remove(own).1);
        Some((field.name.text.clone(), filled(spec, field, own)?))
    });
    Some(Data::Record(fields.collect()))
}

/// Adds the arguments that carry a value.
pub(super) fn flatten(name: Option<String>, data: Data, arguments: &mut Vec<Argument>) {
    match data {
        Data::Plain(value, _) => arguments.push(Argument { name, value }),
        Data::Record(fields) => {
            for (field, data) in fields {
                let name = name.as_ref().map_or_else(|| field.clone(), |name| format!("{name}.{field}"));
                flatten(Some(name), data, arguments);
            }
        }
    }
}
