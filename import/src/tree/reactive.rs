//! Nodes that a tree ticks again while a later node runs. In a spec, a watching process runs beside the later one
//! instead.

use super::condition::check;
use super::context::{ACTIONS_MAX, Around, Context, node as child_node, part};
use super::control::{branches, if_then_else};
use super::decorator::succeeded;
use super::leaf::{id_of, leaf};
use super::library::{Sort, sort_of};
use super::module::Role;
use super::piece::Piece;
use super::scope::Body;
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// The change that a watcher waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    /// The condition does not hold any more: the watcher fails.
    Lapse,
    /// The condition holds: the watcher is done.
    Rise,
}

/// Whether a watcher of a node can be written.
fn is_watchable(context: &Context<'_>, node: Node<'_>, change: Change) -> bool {
    // A watcher knows nothing of the conditions and the scripts of its node.
    if super::condition::has_conditions(node) {
        return false;
    }
    let name = node.attribute("ID").filter(|_| sort_of(tag(node)).is_some()).unwrap_or(tag(node));
    let mut inner = elements(node).peekable();
    let has_child = inner.peek().is_some();
    let mut is_child = |change| inner.next().is_some_and(|child| is_watchable(context, child, change));
    match (name, change) {
        ("Inverter", Change::Lapse) => is_child(Change::Rise),
        ("Inverter", Change::Rise) => is_child(Change::Lapse),
        ("Sequence" | "ReactiveSequence", Change::Lapse) | ("Fallback" | "ReactiveFallback", Change::Rise) => {
            has_child && inner.all(|child| is_watchable(context, child, change))
        }
        ("AlwaysSuccess", Change::Lapse) | ("AlwaysFailure", Change::Rise) | ("ScriptCondition", _) => true,
        _ => !has_child && is_condition(context, node, name),
    }
}

/// The leaves of a node that can be watched, of which no file says whether they are conditions.
fn doubtful<'a>(context: &Context<'a>, node: Node<'a>) -> Vec<Node<'a>> {
    let is_known = |name: &str| ["ScriptCondition", "AlwaysSuccess", "AlwaysFailure"].contains(&name);
    let is_doubtful = |leaf: &Node<'_>| {
        let name = tag(*leaf);
        let is_leaf = leaf.is_element() && elements(*leaf).next().is_none();
        is_leaf && sort_of(name).is_none() && context.library.model(name).is_none() && !is_known(name)
    };
    node.descendants().filter(is_doubtful).collect()
}

/// Notes which leaves of a node are read as conditions although no file says so.
fn doubts<'a>(context: &mut Context<'a>, node: Node<'a>) {
    for leaf in doubtful(context, node) {
        let text = format!("no file says whether <{}> is a condition; it is read as a condition", tag(leaf));
        context.remark(leaf, RemarkKind::Differs, text);
    }
}

/// Whether a leaf is a condition. Files often do not say it: then a leaf that is ticked again is taken for one.
fn is_condition(context: &Context<'_>, node: Node<'_>, name: &str) -> bool {
    let not_conditions = ["Script", "SetBlackboard", "UnsetBlackboard", "Sleep", "AlwaysSuccess", "AlwaysFailure"];
    match (sort_of(tag(node)), context.library.model(name)) {
        (Some(Sort::Condition), _) => true,
        (Some(Sort::Action | Sort::Control | Sort::Decorator | Sort::SubTree), _) => false,
        (None, Some(model)) => model.sort == Sort::Condition,
        (None, None) => !not_conditions.contains(&name),
    }
}

/// A process that watches a node.
fn watcher<'a>(context: &mut Context<'a>, node: Node<'a>, change: Change) -> Result<Piece, ImportError> {
    let name = id_of(context, node)?;
    let first = elements(node).next();
    match (name, change, first) {
        ("Inverter", Change::Lapse, Some(child)) => {
            let why = succeeded(context, child)?;
            Ok(watcher(context, child, Change::Rise)?.then(Piece::fail(&why)))
        }
        ("Inverter", Change::Rise, Some(child)) => Ok(watcher(context, child, Change::Lapse)?.tolerated()),
        ("Sequence" | "ReactiveSequence" | "Fallback" | "ReactiveFallback", _, Some(_)) => {
            let watchers: Result<Vec<Piece>, ImportError> =
                elements(node).map(|child| watcher(context, child, change)).collect();
            Ok(Piece::joined("#", watchers?))
        }
        ("AlwaysSuccess" | "AlwaysFailure", _, _) => Ok(Piece::never()),
        ("ScriptCondition", _, _) => Ok(check(context, node, node.attribute("code").unwrap_or_default(), role(change))),
        _ => leaf(context, node, role(change)),
    }
}

fn role(change: Change) -> Role {
    match change {
        Change::Lapse => Role::While,
        Change::Rise => Role::Until,
    }
}

/// The watcher of a condition that a tree ticks again while a later node runs; none for a node that is not a sure condition.
pub(super) fn watcher_of_sure<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Option<Piece>, ImportError> {
    let is_sure = is_watchable(context, node, Change::Lapse) && doubtful(context, node).is_empty();
    if is_sure { watcher(context, node, Change::Lapse).map(Some) } else { Ok(None) }
}

/// The watcher of a node that is ticked again while a later one runs, or a remark if it cannot be watched.
fn watcher_or_remark<'a>(
    context: &mut Context<'a>,
    node: Node<'a>,
    change: Change,
) -> Result<Option<Piece>, ImportError> {
    if is_watchable(context, node, change) {
        doubts(context, node);
        return watcher(context, node, change).map(Some);
    }
    let end = match change {
        Change::Lapse => "fails",
        Change::Rise => "succeeds",
    };
    let text = format!(
        "<{}> runs once here; in the tree, it starts again at each tick of a later node, and halts that node if it runs or {end}",
        tag(node)
    );
    context.remark(node, RemarkKind::Differs, text);
    Ok(None)
}

/// `ReactiveSequence`: each child runs as long as all conditions before it hold.
pub(super) fn sequence<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    reactive(context, node, Change::Lapse)
}

/// `ReactiveFallback`: each child runs until a condition before it holds.
pub(super) fn fallback<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    reactive(context, node, Change::Rise)
}

/// The tree ticks all children again from the first one, and halts the child that runs if an earlier one decides.
fn reactive<'a>(context: &mut Context<'a>, node: Node<'a>, change: Change) -> Result<Piece, ImportError> {
    let (around, operator) = match change {
        Change::Lapse => (Around::Sequence, ";"),
        Change::Rise => (Around::Fallback, "else"),
    };
    let nodes: Vec<Node<'a>> = elements(node).collect();
    let Some(last) = nodes.len().checked_sub(1) else {
        return Ok(if change == Change::Lapse { Piece::skip() } else { super::control::fallback(Vec::new()) });
    };
    let children: Result<Vec<Piece>, ImportError> =
        nodes.iter().map(|child| child_node(context, *child, around)).collect();
    let (mut pieces, mut watchers, mut length) = (Vec::new(), Vec::new(), 0);
    for (index, (&child, piece)) in nodes.iter().zip(children?).enumerate() {
        // A condition ends at once, so it needs no watchers.
        let is_over = index < last && is_watchable(context, child, change) && doubtful(context, child).is_empty();
        let piece = if is_over { piece } else { piece.until(watchers.clone()) };
        // Each watcher stands behind each later child, so a long row has a very long text.
        length += piece.text().len();
        if length > ACTIONS_MAX {
            return Err(context.error(node, format!("its event actions are longer than {ACTIONS_MAX} bytes")));
        }
        pieces.push(piece);
        if index < last {
            watchers.extend(watcher_or_remark(context, child, change)?);
        }
    }
    Ok(Piece::joined(operator, pieces))
}

/// `WhileDoElse`: an activity that changes between its branches with its condition.
pub(super) fn while_do_else<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let (condition, yes, no) = branches(context, node)?;
    if !is_watchable(context, condition, Change::Lapse) || !is_watchable(context, condition, Change::Rise) {
        let text = "the branch is chosen once; in the tree the condition is ticked again while a branch runs";
        context.remark(node, RemarkKind::Differs, text);
        return if_then_else(context, node);
    }
    doubts(context, condition);
    part(context, node, "WhileDoElse", |context| {
        let check = child_node(context, condition, Around::Other)?;
        let yes = child_node(context, yes, Around::Other)?;
        let lapse = watcher(context, condition, Change::Lapse)?.tolerated().tagged("changed");
        let first = yes.tagged("over").until(vec![lapse]);
        let second = match no {
            None => "on always -> abort(\"the condition does not hold\");".to_owned(),
            Some(no) => {
                let no = child_node(context, no, Around::Other)?;
                let rise = watcher(context, condition, Change::Rise)?.tagged("changed");
                branch(&no.tagged("over").until(vec![rise]), "holds")
            }
        };
        let (check, first) = (check.text(), branch(&first, "lacks"));
        Ok(Body::States(format!(
            "initial state look {{ run ({check}); on done -> holds; on aborted -> lacks; }}\n\
             state holds {{ {first} }}\nstate lacks {{ {second} }}"
        )))
    })
}

/// The content of the state of one branch.
fn branch(run: &Piece, other: &str) -> String {
    let run = run.text();
    format!("run ({run}); on done(changed) -> {other}; on done -> done; on aborted -> abort(\"a branch has failed\");")
}
