//! Actions, conditions and subtrees.

use super::context::{Context, instance_of};
use super::library::{Direction, Sort, is_port, shares_all};
use super::module::{ModuleKey, Role};
use super::piece::{Ends, Piece};
use super::scope::{InstanceType, Use};
use crate::name::snake;
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, tag};

/// The name on the blackboard that a value such as `{goal}` means.
pub(super) fn key_of<'v>(attribute: &'v str, value: &'v str) -> Option<&'v str> {
    let key = value.trim().strip_prefix('{')?.strip_suffix('}')?.trim();
    Some(if key == "=" { attribute } else { key })
}

/// The name of a node in its library: `<Action ID="Move"/>` and `<Move/>` are the same.
pub(super) fn id_of<'a>(context: &Context<'a>, node: Node<'a>) -> Result<&'a str, ImportError> {
    match super::library::sort_of(tag(node)) {
        None => Ok(tag(node)),
        Some(Sort::Action | Sort::Condition | Sort::Control | Sort::Decorator | Sort::SubTree) => {
            node.attribute("ID").ok_or_else(|| context.error(node, format!("<{}> has no ID", tag(node))))
        }
    }
}

/// Translates an action or a condition into an instance of a module.
pub(super) fn leaf<'a>(context: &mut Context<'a>, node: Node<'a>, role: Role) -> Result<Piece, ImportError> {
    let id = id_of(context, node)?;
    let key = ModuleKey { id: id.into(), role };
    let is_condition = tag(node) == "Condition" || context.library.model(id).is_some_and(|m| m.sort == Sort::Condition);
    let description = match role {
        Role::Once if is_condition => format!("The condition `{id}`: done if it holds, failed if it does not."),
        Role::Once => format!("The action `{id}`: done if it succeeds, failed if it does not."),
        Role::While => format!("Runs while `{id}` holds, and fails at the change."),
        Role::Until => format!("Waits until `{id}` holds."),
    };
    context.modules.declare(&key, id, &description);
    let wanted = node.attribute("name").unwrap_or(id);
    let wanted = match role {
        Role::Once => snake(wanted),
        Role::While => format!("while_{}", snake(wanted)),
        Role::Until => format!("until_{}", snake(wanted)),
    };
    let ports: Vec<(String, String)> = node
        .attributes()
        .filter(|attribute| is_port(attribute.name()))
        .map(|attribute| (attribute.name().to_owned(), attribute.value().to_owned()))
        .collect();
    let model = context.library.model(id);
    let direction = |port: &str| match (id, port) {
        ("SetBlackboard", "output_key") => Some(Direction::Writes),
        ("SetBlackboard", "value") => Some(Direction::Reads),
        _ => model.and_then(|model| model.ports.get(port).copied()),
    };
    let uses = ports
        .iter()
        .map(|(port, value)| {
            let is_key = id == "SetBlackboard" && port == "output_key" && key_of(port, value).is_none();
            let value = if is_key { format!("{{{value}}}") } else { value.clone() };
            PortUse { port: port.clone(), value, direction: direction(port) }
        })
        .collect();
    Ok(program(context, node, &key, &wanted, uses))
}

/// A port of a node in a tree.
pub(super) struct PortUse {
    pub(super) port: String,
    /// A text, or a name on the blackboard in braces.
    pub(super) value: String,
    /// Whether the port is read or written; none if no file says it.
    pub(super) direction: Option<Direction>,
}

/// Adds an instance of a module that is declared.
pub(super) fn program(
    context: &mut Context<'_>,
    node: Node<'_>,
    module: &ModuleKey,
    wanted: &str,
    ports: Vec<PortUse>,
) -> Piece {
    let (mut arguments, mut uses, mut unknown) = (Vec::new(), Vec::new(), Vec::new());
    for PortUse { port, value, direction } in ports {
        let Some(key) = key_of(&port, &value) else {
            arguments.push((context.modules.parameter(module, &port, &value), value));
            continue;
        };
        if direction.is_none() {
            unknown.push(format!("`{port}`"));
        }
        let direction = direction.unwrap_or(Direction::Reads);
        let key = match key.strip_prefix('@') {
            Some(key) if context.is_main() => key,
            Some(_) | None => key,
        };
        let port = context.modules.port(module, &port, direction);
        for writes in [false, true] {
            let has = match direction {
                Direction::Reads => !writes,
                Direction::Writes => writes,
                Direction::Both => true,
            };
            if has {
                uses.push((key.to_owned(), port.clone(), writes));
            }
        }
    }
    if !unknown.is_empty() && module.role == Role::Once {
        let text = format!(
            "no file says whether `{}` reads or writes {}: they are inputs here; `--with` takes a file with a <TreeNodesModel>",
            module.id,
            unknown.join(", ")
        );
        context.remark(node, RemarkKind::Missing, text);
    }
    let kind = InstanceType::Program { module: module.clone(), arguments };
    let instance = context.scope.instance(wanted, kind);
    for (key, port, writes) in uses {
        let (instance, module) = (instance.clone(), Some(module.clone()));
        context.scope.uses.push(Use { key, instance, module, port, writes });
    }
    let ends = if module.role == Role::While { Ends { done: false, failed: true } } else { Ends::ANY };
    Piece::process(instance, ends)
}

/// Translates a subtree into an instance of the group of its tree.
pub(super) fn subtree<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let id = id_of(context, node)?;
    let Some((&name, _)) = context.library.trees.get_key_value(id) else {
        let why = format!("no tree has the ID `{id}`; give the file that has it with `--with`");
        return Err(context.error(node, why));
    };
    for attribute in node.attributes().filter(|attribute| is_port(attribute.name())) {
        if key_of(attribute.name(), attribute.value()).is_none() {
            let (port, value) = (attribute.name(), attribute.value());
            let text =
                format!("the subtree `{id}` gets `{value}` as `{port}`: give it to the processes that read `{port}`");
            context.remark(node, RemarkKind::Missing, text);
        }
    }
    let is_main = context.is_main();
    let key = |inner: &str| match inner.strip_prefix('@') {
        Some(root) if is_main => Some(root.to_owned()),
        Some(_) => Some(inner.to_owned()),
        None => match node.attribute(inner) {
            Some(value) => key_of(inner, value).map(str::to_owned),
            None => Some(inner.to_owned()).filter(|key| shares_all(node) && !key.starts_with('_')),
        },
    };
    instance_of(context, name, &snake(node.attribute("name").unwrap_or(id)), &key)
}
