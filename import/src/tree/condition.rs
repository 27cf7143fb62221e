//! Conditions and scripts of nodes: `_skipIf`, `_while`, `_onSuccess` and similar ones.

use super::context::{Around, Context, content};
use super::leaf::{PortUse, id_of, program};
use super::library::Direction;
use super::module::{ModuleKey, Role};
use super::piece::Piece;
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements};
use std::collections::BTreeMap;

/// Translates a node with its conditions before and its scripts behind.
pub(super) fn with_conditions<'a>(
    context: &mut Context<'a>,
    node: Node<'a>,
    around: Around,
) -> Result<Piece, ImportError> {
    let mut piece = content(context, node, around)?;
    skipped_children(context, node, around)?;
    if let Some(code) = node.attribute("_while") {
        let skipped = skipped(context, node, around, "_while");
        let (check, lapse) = (check(context, node, code, Role::Once), check(context, node, code, Role::While));
        let lapse = match around {
            Around::Fallback => lapse,
            Around::Sequence | Around::Other => lapse.tolerated(),
        };
        piece = check.choice(piece.until(vec![lapse]), skipped);
    }
    if let Some(code) = node.attribute("_skipIf") {
        let skipped = skipped(context, node, around, "_skipIf");
        let check = check(context, node, code, Role::Once);
        piece = match around {
            Around::Sequence => check.or_else(piece),
            Around::Fallback | Around::Other => check.choice(skipped, piece),
        };
    }
    if let Some(code) = node.attribute("_successIf") {
        piece = check(context, node, code, Role::Once).or_else(piece);
    }
    if let Some(code) = node.attribute("_failureIf") {
        piece = check(context, node, code, Role::Once).choice(Piece::fail(code), piece);
    }
    with_scripts(context, node, piece)
}

fn with_scripts<'a>(context: &mut Context<'a>, node: Node<'a>, piece: Piece) -> Result<Piece, ImportError> {
    let mut piece = piece;
    if let Some(code) = node.attribute("_onSuccess") {
        piece = piece.then(script(context, node, code));
    }
    if let Some(code) = node.attribute("_onFailure") {
        let script = script(context, node, code);
        piece = piece.or_else(script.then(Piece::fail("the node before its script failed")));
    }
    if let Some(code) = node.attribute("_post") {
        context.remark(node, RemarkKind::Differs, "`_post` also runs when the node is stopped");
        piece = piece.finally(script(context, node, code));
    }
    if let Some(code) = node.attribute("_onHalted") {
        let text = format!("`_onHalted` has no counterpart; its script is: {code}");
        context.remark(node, RemarkKind::Missing, text);
    }
    super::attribute::unread(context, node)?;
    Ok(piece)
}

/// Whether a node has conditions before it, or scripts behind it.
pub(super) fn has_conditions(node: Node<'_>) -> bool {
    let names = ["_while", "_skipIf", "_successIf", "_failureIf", "_onSuccess", "_onFailure", "_post", "_onHalted"];
    names.iter().any(|name| node.attribute(*name).is_some())
}

/// The piece for a skipped node.
fn skipped(context: &mut Context<'_>, node: Node<'_>, around: Around, attribute: &str) -> Piece {
    match around {
        Around::Sequence => Piece::skip(),
        Around::Fallback => Piece::fail("skipped"),
        Around::Other => {
            let text =
                format!("a node that `{attribute}` skips counts as a success; in the tree, its parent is also skipped");
            context.remark(node, RemarkKind::Differs, text);
            Piece::skip()
        }
    }
}

/// The children that are skipped if their node is skipped: all children, except the last child of a `TryCatch`, which only cleans up.
fn row<'a>(node: Node<'a>, id: &str) -> Vec<Node<'a>> {
    let mut children: Vec<Node<'_>> = elements(node).collect();
    if id == "TryCatch" {
        children.pop();
    }
    children
}

/// Whether a node can be skipped as a whole. A subtree has a remark of its own if its root can be skipped.
fn is_skippable(context: &Context<'_>, node: Node<'_>) -> Result<bool, ImportError> {
    if ["_skipIf", "_while"].iter().any(|name| node.attribute(*name).is_some()) {
        return Ok(true);
    }
    if elements(node).next().is_none() {
        return Ok(false);
    }
    match id_of(context, node)? {
        // With its default thresholds it succeeds if all children are skipped.
        "Parallel" | "ParallelAll" => Ok(false),
        "Precondition" if node.attribute("else") == Some("SKIPPED") => Ok(true),
        id => {
            let children = row(node, id).into_iter();
            children.map(|child| is_skippable(context, child)).try_fold(true, |all, one| Ok(all && one?))
        }
    }
}

/// Notes that a node is skipped in the tree, and ends here, if all its children are skipped.
fn skipped_children(context: &mut Context<'_>, node: Node<'_>, around: Around) -> Result<(), ImportError> {
    let id = id_of(context, node)?;
    let children = row(node, id);
    // Each child of these nodes has a remark, or ends the node as in the tree.
    let is_noted = inside(id, children.len(), around) == Around::Other;
    if children.is_empty() || is_noted || is_same(id, children.len(), around) {
        return Ok(());
    }
    for child in children {
        if !is_skippable(context, child)? {
            return Ok(());
        }
    }
    let text = format!("if all children of this <{id}> are skipped, it ends here; in the tree it is skipped too");
    context.remark(node, RemarkKind::Differs, text);
    Ok(())
}

/// Whether a node whose children are all skipped ends as a skipped node does here.
fn is_same(id: &str, children: usize, around: Around) -> bool {
    id == "Inverter" || inside(id, children, around) == around
}

/// The meaning of a skipped child of a node: if the child is the only one, the node is skipped with it.
pub(super) fn inside(id: &str, children: usize, around: Around) -> Around {
    match (id, children, around) {
        ("Sequence" | "AsyncSequence" | "Fallback" | "AsyncFallback" | "Timeout" | "Delay", 1, _) => around,
        ("Inverter", 1, Around::Sequence) => Around::Fallback,
        ("Inverter", 1, Around::Fallback) => Around::Sequence,
        ("Fallback" | "AsyncFallback" | "ReactiveFallback" | "RoundRobin", _, _) => Around::Fallback,
        (
            "Sequence"
            | "AsyncSequence"
            | "SequenceWithMemory"
            | "SequenceStar"
            | "ReactiveSequence"
            | "PipelineSequence"
            | "PersistentSequence"
            | "NonblockingSequence"
            | "TryCatch",
            _,
            _,
        ) => Around::Sequence,
        _ => Around::Other,
    }
}

/// An instance of a module that evaluates a script.
pub(super) fn check(context: &mut Context<'_>, node: Node<'_>, code: &str, role: Role) -> Piece {
    let description = match role {
        Role::Once => format!("Done if `{code}` holds, failed if it does not."),
        Role::While => format!("Runs while `{code}` holds, and fails at the change."),
        Role::Until => format!("Waits until `{code}` holds."),
    };
    scripted(context, node, &ModuleKey { id: code.into(), role }, "Check", &description)
}

/// An instance of a module that runs a script.
pub(super) fn script(context: &mut Context<'_>, node: Node<'_>, code: &str) -> Piece {
    let key = ModuleKey { id: format!("script {code}"), role: Role::Once };
    scripted(context, node, &key, "Script", &format!("Runs the script `{code}`."))
}

fn scripted(context: &mut Context<'_>, node: Node<'_>, key: &ModuleKey, wanted: &str, description: &str) -> Piece {
    context.modules.declare(key, wanted, description);
    let code = key.id.strip_prefix("script ").unwrap_or(&key.id);
    if key.role == Role::Once {
        let name = context.modules.name(key).to_owned();
        let text = format!("`{name}` is a program that you have to write, for the script: {code}");
        context.remark(node, RemarkKind::Missing, text);
    }
    let ports = names_of(code)
        .into_iter()
        .map(|(name, direction)| PortUse {
            port: name.clone(),
            value: format!("{{{name}}}"),
            direction: Some(direction),
        })
        .collect();
    let wanted = crate::name::snake(context.modules.name(key));
    program(context, node, key, &wanted, ports)
}

/// The names of the blackboard that a script reads and writes.
fn names_of(code: &str) -> BTreeMap<String, Direction> {
    let mut names: BTreeMap<String, Direction> = BTreeMap::new();
    let mut rest = code;
    while let Some(first) = rest.chars().next() {
        if first == '\'' {
            let end = rest[1..].find('\'').map_or(rest.len(), |end| end + 2);
            rest = &rest[end..];
        } else if first.is_alphanumeric() || first == '_' || first == '@' {
            let length = rest.find(|c: char| !(c.is_alphanumeric() || "_@.".contains(c))).unwrap_or(rest.len());
            let (name, after) = rest.split_at(length.max(first.len_utf8()));
            rest = after;
            if first.is_ascii_digit() || name == "true" || name == "false" || name.contains('.') {
                continue;
            }
            let after = after.trim_start();
            let is_assigned = after.starts_with(":=") || after.starts_with('=') && !after.starts_with("==");
            let is_changed = ["+=", "-=", "*=", "/="].iter().any(|sign| after.starts_with(sign));
            let direction = if is_changed {
                Direction::Both
            } else if is_assigned {
                Direction::Writes
            } else {
                Direction::Reads
            };
            let known = names.entry(name.to_owned()).or_insert(direction);
            if *known != direction {
                *known = Direction::Both;
            }
        } else {
            rest = &rest[first.len_utf8()..];
        }
    }
    names
}
