//! Nodes that a tree ticks again while a later node runs. In a spec, a watching process runs beside the later one
//! instead.

use super::condition::check;
use super::context::{Around, Context, node as child_node, part};
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
    let name = node.attribute("ID").filter(|_| sort_of(tag(node)).is_some()).unwrap_or(tag(node));
    let is_child = |change| elements(node).next().is_some_and(|child| is_watchable(context, child, change));
    match (name, change) {
        ("Inverter", Change::Lapse) => is_child(Change::Rise),
        ("Inverter", Change::Rise) => is_child(Change::Lapse),
        ("Sequence" | "ReactiveSequence", Change::Lapse) | ("Fallback" | "ReactiveFallback", Change::Rise) => {
            elements(node).all(|child| is_watchable(context, child, change))
        }
        ("AlwaysSuccess", Change::Lapse) | ("AlwaysFailure", Change::Rise) | ("ScriptCondition", _) => true,
        _ => elements(node).next().is_none() && is_condition(context, node, name),
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

/// The watchers of all nodes before the last one, and remarks on those that cannot be watched.
fn watchers<'a>(context: &mut Context<'a>, nodes: &[Node<'a>], change: Change) -> Result<Vec<Piece>, ImportError> {
    let mut watchers = Vec::new();
    for &node in nodes {
        if !is_watchable(context, node, change) {
            let text =
                format!("<{}> runs once here; in the tree it is ticked again while a later node runs", tag(node));
            context.remark(node, RemarkKind::Differs, text);
            continue;
        }
        if sort_of(tag(node)).is_none()
            && context.library.model(tag(node)).is_none()
            && elements(node).next().is_none()
            && tag(node) != "ScriptCondition"
            && tag(node) != "AlwaysSuccess"
            && tag(node) != "AlwaysFailure"
        {
            let text = format!("no file says whether <{}> is a condition; it is read as a condition", tag(node));
            context.remark(node, RemarkKind::Differs, text);
        }
        watchers.push(watcher(context, node, change)?);
    }
    Ok(watchers)
}

/// `ReactiveSequence`: the last child runs as long as all before it hold.
pub(super) fn sequence<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    reactive(context, node, Change::Lapse)
}

/// `ReactiveFallback`: the last child runs until one before it holds.
pub(super) fn fallback<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    reactive(context, node, Change::Rise)
}

fn reactive<'a>(context: &mut Context<'a>, node: Node<'a>, change: Change) -> Result<Piece, ImportError> {
    let (around, operator) = match change {
        Change::Lapse => (Around::Sequence, ";"),
        Change::Rise => (Around::Fallback, "else"),
    };
    let nodes: Vec<Node<'a>> = elements(node).collect();
    let Some((last, before)) = nodes.split_last() else {
        return Ok(if change == Change::Lapse { Piece::skip() } else { super::control::fallback(Vec::new()) });
    };
    let mut pieces = Vec::new();
    for &node in before {
        pieces.push(child_node(context, node, around)?);
    }
    let last = child_node(context, *last, around)?;
    let watchers = watchers(context, before, change)?;
    pieces.push(last.until(watchers));
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
