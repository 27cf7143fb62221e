//! The parameters that interfaces declare, as plain data.

use super::range::Values;
use super::spec::{Param, Shape, Spec, Value, ValueKind};
use super::{declare, types, unit};
use crate::plan::{Accepts, Constant, Parameter};
use crate::source::{Origin, Source};
use crate::syntax::{Parse, ast, parse};
use std::collections::BTreeMap;

/// Returns the parameters of each module that the texts declare, as its program gets them. A module is left out if that
/// cannot be said, as of one with a list of any length.
pub(crate) fn parameters(interfaces: &[Source]) -> BTreeMap<String, Option<Vec<Parameter>>> {
    let (mut spec, mut diagnostics) = (Spec::default(), Vec::new());
    for (origin, source) in (0..).map(Origin::Interface).zip(interfaces) {
        let Parse { root, mut damage, .. } = parse(source, origin);
        damage.sort_unstable();
        let root = ast::Node::new(root, origin);
        declare::constants(&mut spec, &root, &damage, &mut diagnostics);
        let templates = declare::Templates::default();
        declare::declare(&mut spec, &root, (origin, false), (&damage, &templates), &mut diagnostics);
    }
    // Types that contain themselves are taken out.
    types::check(&mut spec, &mut diagnostics);
    let of_module = |params: &[Param]| {
        let mut all = Vec::new();
        params.iter().try_for_each(|param| add(&spec, param, param.name.text.clone(), &mut all))?;
        Some(all)
    };
    let modules = spec.modules.iter();
    modules
        .map(|module| (module.name.text.clone(), module.params.as_deref().map_or_else(|| Some(Vec::new()), of_module)))
        .collect()
}

fn add(spec: &Spec, param: &Param, name: String, all: &mut Vec<Parameter>) -> Option<()> {
    match param.kind.as_ref().map(|kind| spec.shape(kind)) {
        Some(Shape::Record(fields)) => {
            fields.iter().try_for_each(|field| add(spec, field, format!("{name}.{}", field.name.text), all))
        }
        Some(Shape::List(element, count)) => {
            let element = param.element(element);
            (0..count?).try_for_each(|index| add(spec, &element, format!("{name}.{index}"), all))
        }
        Some(Shape::Plain(kind)) => {
            all.push(Parameter { name, accepts: accepts(param, Some(kind)) });
            Some(())
        }
        None => {
            all.push(Parameter { name, accepts: accepts(param, None) });
            Some(())
        }
    }
}

fn accepts(param: &Param, kind: Option<&str>) -> Accepts {
    match param.range.as_ref().map(|range| &range.values) {
        Some(Values::Between(low, high)) => {
            let end = |end: &Option<Value>| match end.as_ref().and_then(constant) {
                Some(Constant::Number(number)) => Some(number),
                Some(Constant::Text(_) | Constant::Truth(_)) | None => None,
            };
            return Accepts::Between { low: end(low), high: end(high) };
        }
        Some(Values::OneOf(all)) => return Accepts::OneOf(all.iter().filter_map(constant).collect()),
        None => {}
    }
    match kind {
        Some("Text") => Accepts::Text,
        Some("Number") => Accepts::Number,
        Some("Truth") => Accepts::Truth,
        Some(kind) if unit::of_type(kind).is_some() => Accepts::Number,
        Some(_) | None => Accepts::Any,
    }
}

fn constant(value: &Value) -> Option<Constant> {
    match &value.kind {
        ValueKind::Constant(constant) => Some(constant.clone()),
        ValueKind::Param(_) | ValueKind::Record(_) | ValueKind::List(_) | ValueKind::Broken => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_what_programs_get() {
        let text = "type Grip = { force: Force in 1 N..200 N = 20 N, mode: Text in \"soft\" | \"hard\" };
            module Arm(host: Host, grip: Grip, corner: Number[2] in ..5, loud: Truth, name) { done; }
            module Any(host: Host, way: Number[]) { done; }
            module None { done; }";
        let found = parameters(&[Source::new("a", text)]);
        let shown = |name: &str| {
            let all = found[name].as_ref()?;
            Some(all.iter().map(|one| format!("{}: {}", one.name, one.accepts)).collect::<Vec<_>>().join(", "))
        };
        let arm = "grip.force: Number in 1..200, grip.mode: soft | hard, corner.0: Number in ..5, corner.1: Number in ..5, \
                   loud: Truth, name: any";
        assert_eq!(shown("Arm").as_deref(), Some(arm));
        assert_eq!((shown("Any"), shown("None").as_deref()), (None, Some("")));
        let grip = &found["Arm"].as_ref().unwrap()[0].accepts;
        assert_eq!(grip.check("200"), Ok(()));
        for wrong in ["200.1", "0", "nan", "hard"] {
            assert_eq!(grip.check(wrong), Err("a number from 1 to 200".to_owned()), "{wrong}");
        }
    }
}
