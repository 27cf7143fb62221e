//! Returns the parameters and messages that interfaces declare, as plain data.

use super::declare::{ItemCollector, Templates, Tree};
use super::diagnostics::Diagnostics;
use super::range::Values;
use super::spec::{CallRole, Direction, Kind, Module, Param, Port, Shape, Spec, Value, ValueKind};
use super::types;
use crate::message::{AskedModule, FieldType, Layout, Message, RecordType};
use crate::plan::{Accepts, Constant, Parameter};
use crate::source::{Origin, Source};
use crate::syntax::{Parse, ast, parse};
use crate::unit;
use ros::logic::library;
use std::collections::BTreeMap;

/// Returns the parameters of each module that the texts declare, in the form for its program. A module has none if this
/// form is impossible, for example because of a list of any length.
pub(crate) fn parameters(interfaces: &[Source]) -> BTreeMap<String, Option<Vec<Parameter>>> {
    let spec = read(interfaces);
    let of_module = |params: &[Param]| parameters_of(&spec, params);
    let modules = spec.modules.iter();
    modules
        .map(|module| (module.name.text.clone(), module.params.as_deref().map_or_else(|| Some(Vec::new()), of_module)))
        .collect()
}

/// Returns parameters in the form for a program. Returns none if this form is impossible.
pub(super) fn parameters_of(spec: &Spec, params: &[Param]) -> Option<Vec<Parameter>> {
    let mut all = Vec::new();
    params.iter().try_for_each(|param| add(spec, param, param.name.text.clone(), &mut all))?;
    Some(all)
}

/// Returns the message of each output of each module, if the texts declare it.
pub(crate) fn messages(interfaces: &[Source]) -> BTreeMap<String, BTreeMap<String, Message>> {
    let spec = read(interfaces);
    let modules = spec.modules.iter().map(|module| {
        let outputs = module.ports.iter().filter(|port| port.direction == Direction::Out && port.call.is_none());
        let message = |kind: &Kind| Some(Message { name: kind.name()?.to_owned(), layout: layout(&spec, kind)? });
        let messages = outputs.filter_map(|port| Some((port.name.text.clone(), message(port.kind.as_ref()?)?)));
        (module.name.text.clone(), messages.collect())
    });
    modules.collect()
}

/// Returns the type of each port of each module as the texts write it: by module, then by port.
pub(crate) fn port_types(interfaces: &[Source]) -> BTreeMap<String, BTreeMap<String, String>> {
    let of_module = |module: Module| {
        let typed = |port: Port| Some((port.name.text, port.kind?.text));
        (module.name.text, module.ports.into_iter().filter_map(typed).collect())
    };
    read(interfaces).modules.into_iter().map(of_module).collect()
}

/// Returns the procedures and states of each module, with their signatures.
pub(crate) fn exports(interfaces: &[Source]) -> BTreeMap<String, BTreeMap<String, String>> {
    let of_module = |module: Module| (module.name.text, module.ports.into_iter().filter_map(signature).collect());
    read(interfaces).modules.into_iter().map(of_module).collect()
}

/// Returns the record types that the texts declare, in their order. Each name occurs once.
pub(crate) fn record_types(sources: &[Source]) -> Vec<RecordType> {
    let spec = read(sources);
    let mut types: Vec<RecordType> = Vec::new();
    for named in &spec.types {
        let (name, Some(fields)) = (&named.name.text, &named.kind.fields) else { continue };
        if types.iter().all(|other| other.name != *name) {
            types.push(RecordType { name: name.clone(), doc: named.doc.clone(), fields: field_types(&spec, fields) });
        }
    }
    types
}

fn field_types(spec: &Spec, fields: &[Param]) -> Vec<(String, FieldType)> {
    let field = |field: &Param| Some((field.name.text.clone(), field_type(spec, field.kind.as_ref()?)));
    fields.iter().filter_map(field).collect()
}

fn field_type(spec: &Spec, kind: &Kind) -> FieldType {
    if let Some(fields) = &kind.fields {
        return FieldType::Record(field_types(spec, fields));
    }
    match spec.shape(kind) {
        Shape::Record(_) => FieldType::Named(kind.text.clone()),
        Shape::List(element, count) => {
            let element = Kind { text: element.to_owned(), span: kind.span, fields: None };
            FieldType::List { of: Box::new(field_type(spec, &element)), count }
        }
        Shape::Plain(plain) => FieldType::Plain(plain.to_owned()),
    }
}

/// Returns the modules that have Python programs and leave the interface to the program.
pub(crate) fn asked(sources: &[Source]) -> Vec<AskedModule> {
    let modules = read(sources).modules.into_iter().filter(|module| module.is_asked);
    let asked =
        |Module { name, exec, environment, .. }| Some(AskedModule { name: name.text, exec: exec?, environment });
    modules.filter_map(asked).collect()
}

fn signature(port: Port) -> Option<(String, String)> {
    let (name, call) = (port.name.text, port.call?);
    let answer = port.kind.map(|kind| kind.text).unwrap_or_default();
    let text = match call.role {
        CallRole::Procedure => {
            let argument = call.argument.map(|kind| kind.text).unwrap_or_default();
            let answer = if answer.is_empty() { answer } else { format!(" -> {answer}") };
            format!("proc {name}({argument}){answer}")
        }
        CallRole::State => format!("state {name}: {answer}"),
        CallRole::Caller => return None,
    };
    Some((name, text))
}

/// Returns the layout of the values of a type; none if no text declares its values.
pub(super) fn layout(spec: &Spec, kind: &Kind) -> Option<Layout> {
    match spec.shape(kind) {
        Shape::Record(fields) => {
            let field = |field: &Param| Some((field.name.text.clone(), layout(spec, field.kind.as_ref()?)?));
            Some(Layout::Record(fields.iter().map(field).collect::<Option<_>>()?))
        }
        Shape::List(element, count) => {
            let element = Kind { text: element.to_owned(), span: kind.span, fields: None };
            Some(Layout::List { of: Box::new(layout(spec, &element)?), count })
        }
        Shape::Plain("Truth") => Some(Layout::Truth),
        Shape::Plain("Text") => Some(Layout::Text),
        Shape::Plain(plain) if plain == "Number" || unit::of_type(plain).is_some() => {
            Some(Layout::Number { of: plain.to_owned() })
        }
        Shape::Plain(plain) if library::by_spec(plain).is_some() => Some(Layout::Ros { of: plain.to_owned() }),
        Shape::Plain(_) => None,
    }
}

/// Reads texts of modules and types. Their mistakes do not matter here.
fn read(interfaces: &[Source]) -> Spec {
    let (mut spec, mut diagnostics) = (Spec::default(), Diagnostics::default());
    for (origin, source) in (0..).map(Origin::Interface).zip(interfaces) {
        let Parse { root, mut damage, .. } = parse(source, origin);
        damage.sort_unstable();
        let python = source.python();
        let tree = Tree { root: ast::Node::new(root, origin), origin, is_part: false, python, damage };
        let mut collector = ItemCollector { spec: &mut spec, diagnostics: &mut diagnostics };
        collector.constants(&tree);
        collector.items(&tree, &Templates::default());
    }
    // This removes types that contain themselves.
    types::check(&mut spec, &mut diagnostics);
    spec
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
                Some(Constant::Text(_) | Constant::Truth(_) | Constant::Secret(_)) | None => None,
            };
            let (low, high) = (end(low), end(high));
            return match kind.filter(|kind| unit::of_type(kind).is_some()) {
                Some(of) => Accepts::Quantity { of: of.to_owned(), low, high },
                None => Accepts::Between { low, high },
            };
        }
        Some(Values::OneOf(all)) => return Accepts::OneOf(all.iter().filter_map(constant).collect()),
        None => {}
    }
    match kind {
        Some("Text") => Accepts::Text,
        Some("Number") => Accepts::Number,
        Some("Truth") => Accepts::Truth,
        Some(unit::SECRET) => Accepts::Secret,
        Some(kind) if unit::of_type(kind).is_some() => Accepts::Quantity { of: kind.to_owned(), low: None, high: None },
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
    fn messages_are_what_outputs_send() {
        let text = "type Wrench = { force: Force[3], at: Point, who: Text, soft: Truth, near: Length[] };
            type Point = { x: Length };
            type Way = Point;
            type Round = { next: Round };
            type Seen = { scan: ros.sensor.LaserScan, near: Truth };
            module Hand(host) { out Scan: ros.sensor.LaserScan; out Seen: Seen; out Odd: ros.sensor.Nothing; out Out: Wrench; out Way: Way; out Raw: Camera; out Loop: Round; out Plain: Number; in In: Point;
                done; }";
        let found = &messages(&[Source::new("a", text)])["Hand"];
        let number = |of: &str| Layout::Number { of: of.to_owned() };
        let list = |of, count| Layout::List { of: Box::new(of), count };
        let fields = |all: &[(&str, Layout)]| {
            Layout::Record(all.iter().map(|(name, of)| ((*name).into(), of.clone())).collect())
        };
        let point = fields(&[("x", number("Length"))]);
        let wrench = fields(&[
            ("force", list(number("Force"), Some(3))),
            ("at", point.clone()),
            ("who", Layout::Text),
            ("soft", Layout::Truth),
            ("near", list(number("Length"), None)),
        ]);
        let message = |name: &str, layout| Message { name: name.to_owned(), layout };
        assert_eq!(found["Out"], message("Wrench", wrench));
        assert_eq!(found["Way"], message("Way", point));
        assert_eq!(found["Plain"], message("Number", number("Number")));
        let scan = Layout::Ros { of: "ros.sensor.LaserScan".to_owned() };
        assert_eq!(found["Scan"], message("ros.sensor.LaserScan", scan.clone()));
        assert_eq!(found["Seen"], message("Seen", fields(&[("scan", scan), ("near", Layout::Truth)])));
        let known = ["Out", "Plain", "Scan", "Seen", "Way"];
        assert_eq!(found.keys().collect::<Vec<_>>(), known, "nothing is known of the others");
    }

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
        let arm = "grip.force: Force in 1 N..200 N, grip.mode: soft | hard, corner.0: Number in ..5, corner.1: Number in ..5, \
                   loud: Truth, name: any";
        assert_eq!(shown("Arm").as_deref(), Some(arm));
        assert_eq!((shown("Any"), shown("None").as_deref()), (None, Some("")));
        let grip = &found["Arm"].as_ref().unwrap()[0].accepts;
        assert_eq!(grip.check("200"), Ok(()));
        for wrong in ["200.1", "0", "nan", "hard"] {
            assert_eq!(grip.check(wrong), Err("a Force from 1 to 200 N".to_owned()), "{wrong}");
        }
    }
}
