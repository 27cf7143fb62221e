//! The components of a container, as a spec has them.

use super::entity::Entity;
use super::node::{is_graph_name, is_package};
use super::program::{Component, Container, Parameter, Program, Record};
use super::scope::inside;
use super::settings::Settings;
use super::value::Value;
use super::walk::Importer;
use crate::name::{quoted, snake};
use crate::remark::RemarkKind;

/// The most components of one container in a spec.
const COMPONENTS_MAX: usize = 100;
/// The only argument of a component that a spec has.
const INTRA_PROCESS: &str = "use_intra_process_comms";

/// Adds the components in an action to the program of a container.
pub(super) fn of_container(importer: &mut Importer<'_>, entity: &Entity, program: &mut Program) {
    for part in entity.parts("composable_node") {
        if !importer.is_on(part) {
            continue;
        }
        if program.container.is_none() {
            importer.missing(part, "the component is left out: its container has a lifecycle, or no name");
        }
        let Some(container) = &mut program.container else { continue };
        // The fields of a parameter with the name of a component are parameters of the component.
        program.parameters.iter().for_each(|parameter| drop(container.names.take(&parameter.name)));
        component(importer, part, container);
    }
}

/// Adds the components of `load_composable_node` to the container with this name.
pub(super) fn into_target(importer: &mut Importer<'_>, entity: &Entity, target: &str) {
    let whole = inside(importer.scopes.namespace(), target);
    let is_target = |program: &Program| program.container.as_ref().is_some_and(|container| container.node == whole);
    let Some(index) = importer.programs.iter().position(is_target) else {
        importer
            .missing(entity, &format!("the components are left out: no container `{whole}` is started before them"));
        return;
    };
    let mut program = importer.programs[index].clone();
    of_container(importer, entity, &mut program);
    importer.programs[index] = program;
}

/// Adds a component, unless it has a part without which it means nothing.
fn component(importer: &mut Importer<'_>, entity: &Entity, container: &mut Container) {
    let (Ok(package), Ok(class)) = (importer.needed(entity, "pkg"), importer.needed(entity, "plugin")) else { return };
    let is_class = |c: char| c.is_ascii_alphanumeric() || "_-.:/<>".contains(c);
    if !is_package(&package) || class.is_empty() || !class.chars().all(is_class) {
        importer.missing(entity, &format!("`{class}` of `{package}` is not a component that a spec can have"));
        return;
    }
    let text = |importer: &mut Importer<'_>, name: &str| importer.text(entity, name).ok().flatten().unwrap_or_default();
    let (given, namespace) = (text(importer, "name"), text(importer, "namespace"));
    let last = class.rsplit(':').next().unwrap_or(&class);
    let wanted = if given.is_empty() { snake(last) } else { snake(&given) };
    if given.is_empty() {
        let why = format!("in launch, the node of `{class}` has a name of its own; here it is `{wanted}`");
        importer.remark(entity, RemarkKind::Differs, &why);
    }
    let namespace = inside(importer.scopes.namespace(), &namespace);
    let last = if given.is_empty() { &wanted } else { &given };
    let node = format!("{}/{last}", namespace.trim_end_matches('/'));
    let is_taken = node == container.node || container.components.iter().any(|other| other.node == node);
    if !is_graph_name(&node) || is_taken || container.components.len() >= COMPONENTS_MAX {
        let why = format!(
            "component `{class}` is left out: a container has at most {COMPONENTS_MAX}, each with a name of its own: `{node}`"
        );
        importer.missing(entity, &why);
        return;
    }
    let name = container.names.take(&wanted);
    let mut settings = Settings::default();
    settings.read(importer, entity);
    let items = items(importer, entity, &settings, (container.own_node(&name) != node).then_some(&*node));
    let record = record(importer, entity, &name, settings.parameters);
    let body = if items.is_empty() { ";".to_owned() } else { format!("{{\n{}\n}}", items.join("\n")) };
    let text = format!("{name} {}{body}", quoted(&format!("{package} {class}")));
    container.components.push(Component { node, text, record });
}

/// Returns the items of a component. `node` is its name, unless it follows from the container.
fn items(importer: &mut Importer<'_>, entity: &Entity, settings: &Settings, node: Option<&str>) -> Vec<String> {
    let mut items: Vec<String> = node.iter().map(|node| format!("node {};", quoted(node))).collect();
    items.extend(settings.remaps.iter().map(|[from, to]| format!("remap {} -> {};", quoted(from), quoted(to))));
    items.extend(settings.files.iter().map(|file| format!("params {};", quoted(file))));
    for rule in settings.words.iter().filter(|word| !word.starts_with('-')) {
        importer.missing(entity, &format!("`{rule}` is left out: write it into a file of parameters of the component"));
    }
    importer.unread(entity, &["pkg", "plugin", "name", "namespace"]);
    for part in &entity.children {
        match part.kind.as_str() {
            "param" | "remap" => {}
            "extra_arg" if importer.is_on(part) => {
                let name = importer.text(part, "name").ok().flatten().unwrap_or_default();
                let value = importer.text(part, "value").ok().flatten().unwrap_or_default();
                match (name.as_str(), Value::plain(value).truth()) {
                    (INTRA_PROCESS, Some(true)) => items.push("intra_process;".to_owned()),
                    (INTRA_PROCESS, Some(false)) => {}
                    (_, Some(_) | None) => {
                        importer.missing(part, &format!("the argument `{name}` has no counterpart"));
                    }
                }
            }
            "extra_arg" => {}
            other => {
                importer.missing(part, &format!("`{other}` in `composable_node` has no counterpart"));
            }
        }
    }
    items
}

/// Returns the parameters of a component as a parameter of the module, if there are any. A type has no field for an integer, so with an
/// integer the record has no type.
fn record(importer: &mut Importer<'_>, entity: &Entity, name: &str, all: Vec<Parameter>) -> Option<Record> {
    let has_integer = all.iter().any(|parameter| parameter.value.is_integer());
    let (dropped, kept): (Vec<_>, Vec<_>) =
        all.into_iter().partition(|parameter| has_integer && parameter.value.is_whole_float());
    for parameter in dropped {
        let why = "beside integers, a spec cannot have a whole number that is not an integer";
        importer.missing(entity, &format!("parameter `{}` is left out: {why}; write it into a file", parameter.name));
    }
    if kept.is_empty() {
        return None;
    }
    let fields = |form: &dyn Fn(&Parameter) -> Option<String>| {
        let fields: Vec<String> = kept.iter().filter_map(form).collect();
        format!("{{ {} }}", fields.join(", "))
    };
    let value = |parameter: &Parameter| format!("{} = {}", parameter.name, parameter.value.bare());
    let linked = |parameter: &Parameter| parameter.given.as_ref().map(|given| format!("{} = {given}", parameter.name));
    let declared = if has_integer {
        format!("{name} = {}", fields(&|parameter| Some(value(parameter))))
    } else {
        format!("{name}: {}", fields(&|parameter| Some(parameter.value.declared(&parameter.name))))
    };
    let given = kept.iter().any(|parameter| parameter.given.is_some()).then(|| {
        let form = |parameter: &Parameter| linked(parameter).or_else(|| has_integer.then(|| value(parameter)));
        format!("{name} = {}", fields(&form))
    });
    Some(Record { declared, given })
}
