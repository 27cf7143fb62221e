//! The state of the translation of behavior trees.

use super::control;
use super::library::{Library, Tree};
use super::module::Modules;
use super::piece::{Ends, Piece};
use super::scope::{Body, Group, InstanceType, Scope, Use, WIRES_MAX, exports};
use crate::name::{pascal, plain};
use crate::remark::{Remark, RemarkKind};
use crate::xml::{ImportError, Node, elements, tag};
use std::collections::{BTreeMap, BTreeSet};

/// The deepest nesting of nodes, over all trees that contain each other.
const DEPTH_MAX: usize = 80;

/// The longest event actions of a group, in bytes.
pub(super) const ACTIONS_MAX: usize = 256 * 1024;

/// The meaning of a skipped node for the node around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Around {
    /// The next child follows, as after a success.
    Sequence,
    /// The next child follows, as after a failure.
    Fallback,
    /// The node around it is skipped as well.
    Other,
}

/// The translation of trees.
#[derive(Debug)]
pub(super) struct Context<'a> {
    pub(super) library: &'a Library<'a>,
    pub(super) modules: Modules,
    /// The groups that are complete, each behind the groups that it contains.
    pub(super) groups: Vec<Group>,
    /// The group of each tree that is complete.
    built: BTreeMap<&'a str, usize>,
    /// The trees that are translated now, each inside the previous one.
    open: Vec<&'a str>,
    main: &'a str,
    /// The group that is made now.
    pub(super) scope: Scope,
    depth: usize,
    /// How many indices of `each` are in use.
    pub(super) indices: usize,
}

impl<'a> Context<'a> {
    /// Returns a context in which no tree is translated.
    pub(super) fn new(library: &'a Library<'a>, main: &'a str) -> Self {
        let mut modules = Modules::default();
        // The group of the main tree has this name.
        modules.names.take("Host");
        let scope = Scope::default();
        let (groups, built, open) = (Vec::new(), BTreeMap::new(), Vec::new());
        Self { library, modules, groups, built, open, main, scope, depth: 0, indices: 0 }
    }

    /// The file of the tree that is translated now.
    fn file(&self) -> &'a str {
        let tree = self.open.last().and_then(|name| self.library.trees.get(name));
        tree.map_or("", |tree| tree.file)
    }

    /// Notes that a node means something else, or is missing.
    pub(super) fn remark(&mut self, node: Node<'_>, kind: RemarkKind, text: impl AsRef<str>) {
        let remark = Remark::new(self.file(), node, kind, text);
        self.scope.remarks.push(remark);
    }

    /// Returns an error about a node.
    pub(super) fn error(&self, node: Node<'_>, why: impl Into<String>) -> ImportError {
        ImportError::at(self.file(), node, why)
    }

    /// Whether the main tree is translated now.
    pub(super) fn is_main(&self) -> bool {
        self.open.last() == Some(&self.main)
    }
}

/// Translates a node, with all nodes inside it.
pub(super) fn node<'a>(context: &mut Context<'a>, node: Node<'a>, around: Around) -> Result<Piece, ImportError> {
    context.depth += 1;
    if context.depth > DEPTH_MAX {
        return Err(context.error(node, format!("nodes are nested more than {DEPTH_MAX} deep, over all trees")));
    }
    let piece = super::condition::with_conditions(context, node, around)?;
    context.depth -= 1;
    // Some nodes stand twice in a spec, so their nesting could double a text again and again.
    if piece.text().len() > ACTIONS_MAX {
        return Err(context.error(node, format!("its event actions are longer than {ACTIONS_MAX} bytes")));
    }
    Ok(piece)
}

/// Translates the children of a node.
pub(super) fn children<'a>(
    context: &mut Context<'a>,
    parent: Node<'a>,
    around: Around,
) -> Result<Vec<Piece>, ImportError> {
    elements(parent).map(|child| node(context, child, around)).collect()
}

/// Translates a tree, unless it is complete.
pub(super) fn build_tree<'a>(context: &mut Context<'a>, name: &'a str) -> Result<(), ImportError> {
    let Some(&Tree { file, element }) = context.library.trees.get(name) else { return Ok(()) };
    if context.built.contains_key(name) {
        return Ok(());
    }
    if context.open.contains(&name) {
        let circle: Vec<String> = context.open.iter().chain([&name]).map(|name| format!("`{name}`")).collect();
        let why = format!("a tree contains itself: {}; a spec has no recursion", circle.join(" contains "));
        return Err(ImportError::at(file, element, why));
    }
    context.open.push(name);
    let around = std::mem::take(&mut context.scope);
    let roots: Vec<Node<'a>> = elements(element).collect();
    let piece = match roots.as_slice() {
        [root] => node(context, *root, Around::Other)?,
        [] => return Err(ImportError::at(file, element, format!("the tree `{name}` is empty"))),
        [_, second, ..] => {
            let why = format!("the tree `{name}` has more than one root; put them into a <Sequence>");
            return Err(ImportError::at(file, *second, why));
        }
    };
    let is_main = context.is_main();
    unwritten(context, element, is_main);
    let scope = std::mem::replace(&mut context.scope, around);
    let exports = if is_main { Vec::new() } else { exports(&scope, |key| context.library.is_shared(key)) };
    let group_name = if is_main { "main".into() } else { context.modules.names.take(&pascal(name)) };
    let description = format!("The tree `{}`.", plain(name));
    finish(
        context,
        element,
        Group { name: group_name, description, scope, body: Body::Actions(piece), exports, is_part: false },
    )?;
    context.built.insert(name, context.groups.len() - 1);
    context.open.pop();
    Ok(())
}

/// Adds a group that is complete.
pub(super) fn finish(context: &mut Context<'_>, node: Node<'_>, group: Group) -> Result<(), ImportError> {
    let wires = group.wires();
    if wires > WIRES_MAX {
        let why = format!("names of the blackboard would need {wires} connections; a group has at most {WIRES_MAX}");
        return Err(context.error(node, why));
    }
    context.groups.push(group);
    Ok(())
}

/// Notes the names of the blackboard that are read here and never written.
fn unwritten(context: &mut Context<'_>, tree: Node<'_>, is_main: bool) {
    let uses = &context.scope.uses;
    let keys = |writes: bool| -> BTreeSet<String> {
        uses.iter().filter(|used| used.writes == writes).map(|used| used.key.clone()).collect()
    };
    let (read, written) = (keys(false), keys(true));
    let is_here = |key: &&String| is_main || !context.library.is_shared(key);
    let missing: Vec<String> = read.difference(&written).filter(is_here).cloned().collect();
    for key in missing {
        let text = format!("no node here writes `{{{key}}}`: connect its readers with the source of the value");
        context.remark(tree, RemarkKind::Missing, text);
    }
}

/// Adds an instance of the group of a tree, and returns the uses of the blackboard that it has.
pub(super) fn instance_of<'a>(
    context: &mut Context<'a>,
    name: &'a str,
    wanted: &str,
    key_of: &dyn Fn(&str) -> Option<String>,
) -> Result<Piece, ImportError> {
    build_tree(context, name)?;
    let Some(&number) = context.built.get(name) else { return Ok(Piece::skip()) };
    Ok(instance_of_group(context, number, wanted, key_of))
}

/// Adds an instance of a group.
pub(super) fn instance_of_group(
    context: &mut Context<'_>,
    number: usize,
    wanted: &str,
    key_of: &dyn Fn(&str) -> Option<String>,
) -> Piece {
    let group = &context.groups[number];
    let (kind, exports) = (InstanceType::Group(group.name.clone()), group.exports.clone());
    let ends = match &group.body {
        Body::Actions(piece) => piece.ends(),
        Body::States(_) => Ends::ANY,
    };
    let instance = context.scope.instance(wanted, kind);
    for export in exports {
        if let Some(key) = key_of(&export.key) {
            let (port, writes) = (export.port, export.writes);
            context.scope.uses.push(Use { key, instance: instance.clone(), module: None, port, writes });
        }
    }
    Piece::process(instance, ends)
}

/// Translates a node that is used at several places of a spec. If the node is more than an action, it becomes a separate group.
pub(super) fn node_of_its_own<'a>(
    context: &mut Context<'a>,
    child: Node<'a>,
    around: Around,
) -> Result<Piece, ImportError> {
    if elements(child).next().is_none() {
        return node(context, child, around);
    }
    let name = pascal(child.attribute("name").unwrap_or(tag(child)));
    part(context, child, &name, |context| node(context, child, around).map(Body::Actions))
}

/// Translates a part of a tree that becomes a group or an activity of its own, and returns its instance.
pub(super) fn part<'a>(
    context: &mut Context<'a>,
    node: Node<'a>,
    name: &str,
    body: impl FnOnce(&mut Context<'a>) -> Result<Body, ImportError>,
) -> Result<Piece, ImportError> {
    let around = std::mem::take(&mut context.scope);
    let body = body(context)?;
    let scope = std::mem::replace(&mut context.scope, around);
    let exports = exports(&scope, |_| true);
    let group_name = context.modules.names.take(name);
    let (line, _) = crate::xml::place(node);
    let description = format!("The `{}` of line {line}.", tag(node));
    finish(context, node, Group { name: group_name, description, scope, body, exports, is_part: true })?;
    let number = context.groups.len() - 1;
    Ok(instance_of_group(context, number, &crate::name::snake(name), &|key| Some(key.to_owned())))
}

/// Translates the content of a node, without its conditions.
pub(super) fn content<'a>(context: &mut Context<'a>, node: Node<'a>, around: Around) -> Result<Piece, ImportError> {
    control::content(context, node, around)
}
