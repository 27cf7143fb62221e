//! Nodes of Nav2 for behavior trees.

use super::attribute::unread;
use super::condition::has_conditions;
use super::context::{Around, Context, children, node as child_node, node_of_its_own};
use super::control::fallback;
use super::decorator::{RETRIES_MAX, number, only_child};
use super::leaf::{id_of, key_of};
use super::piece::Piece;
use super::reactive::watcher_of_sure;
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// Translates a node of Nav2; none if it is not one.
pub(super) fn content<'a>(context: &mut Context<'a>, node: Node<'a>, name: &str) -> Result<Option<Piece>, ImportError> {
    let differs = |context: &mut Context<'a>, text: &str| context.remark(node, RemarkKind::Differs, text);
    Ok(Some(match name {
        "RecoveryNode" => recovery(context, node)?,
        "PipelineSequence" => pipeline(context, node)?,
        "RoundRobin" => {
            differs(
                context,
                "this node begins with its first child each time; in the tree, it begins with the child after the previous one",
            );
            fallback(children(context, node, Around::Fallback)?)
        }
        "PersistentSequence" | "NonblockingSequence" => {
            differs(context, "its children run one after the other, and begin with the first child each time");
            Piece::joined(";", children(context, node, Around::Sequence)?)
        }
        "RateController" => {
            differs(context, "its child runs once here; in the tree, the child is ticked again at this rate");
            let child = only_child(context, node)?;
            child_node(context, child, Around::Other)?
        }
        "DistanceController"
        | "SpeedController"
        | "GoalUpdatedController"
        | "GoalUpdater"
        | "SingleTrigger"
        | "PathLongerOnApproach"
            if elements(node).count() == 1 =>
        {
            context.remark(
                node,
                RemarkKind::Missing,
                format!("`{name}` has no counterpart: only its child is imported"),
            );
            let child = only_child(context, node)?;
            child_node(context, child, Around::Other)?
        }
        _ => return Ok(None),
    }))
}

/// `RecoveryNode`: the first child, and after each failure the second one and the first one again.
fn recovery<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let nodes: Vec<Node<'a>> = elements(node).collect();
    let [task, help] = nodes.as_slice() else {
        return Err(context.error(node, format!("<RecoveryNode> has {} children; it needs two", nodes.len())));
    };
    let retries = number(context, node, "number_of_retries")?.unwrap_or(1);
    if retries < 0 {
        let why = format!("`{retries}` is not a number of retries; <RecoveryNode> needs one from 0");
        return Err(context.error(node, why));
    }
    if retries == 0 {
        return child_node(context, *task, Around::Other);
    }
    let task = node_of_its_own(context, *task, Around::Other)?;
    let help = child_node(context, *help, Around::Other)?;
    let again = help.then(task.clone());
    if retries == 1 {
        return Ok(task.or_else(again));
    }
    let text = "after a failure of the recovery itself, this node tries again; in the tree, it fails at once";
    context.remark(node, RemarkKind::Differs, text);
    let tries = (retries - 1).min(RETRIES_MAX);
    if tries < retries - 1 {
        let text = format!(
            "in the tree, this node recovers {retries} times; a spec can do this at most {} times",
            RETRIES_MAX + 1
        );
        context.remark(node, RemarkKind::Differs, text);
    }
    Ok(task.or_else(again.prefixed(&format!("retry({tries})"))))
}

/// `PipelineSequence`: earlier children are ticked again while a later one runs.
///
/// A child under a `RateController` is written as a loop beside all later children, and a condition is watched beside them.
fn pipeline<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let nodes: Vec<Node<'a>> = elements(node).collect();
    let mut steps = Vec::new();
    for (index, &child) in nodes.iter().enumerate() {
        let is_last = index + 1 == nodes.len();
        let is_repeated = !is_last && id_of(context, child)? == "RateController" && !has_conditions(child);
        steps.push(match period(child).filter(|_| is_repeated) {
            Some(period) => {
                unread(context, child)?;
                let inner = only_child(context, child)?;
                let piece = node_of_its_own(context, inner, Around::Sequence)?;
                let beside = Piece::joined(";;", vec![Piece::wait(period), piece.clone()]);
                (piece, Some(beside))
            }
            None => {
                let piece = child_node(context, child, Around::Sequence)?;
                let beside = if is_last { None } else { watcher_of_sure(context, child)? };
                if !is_last && beside.is_none() {
                    let text = format!(
                        "<{}> runs once here; in the tree, it starts again at each tick of a later node, and its failure halts that node",
                        tag(child)
                    );
                    context.remark(child, RemarkKind::Differs, text);
                }
                (piece, beside)
            }
        });
    }
    // From the last child to the first one.
    let mut row: Vec<Piece> = Vec::new();
    for (piece, beside) in steps.into_iter().rev() {
        if let Some(beside) = beside {
            row.reverse();
            row = vec![Piece::joined(";", row).until(vec![beside])];
        }
        row.push(piece);
    }
    row.reverse();
    Ok(Piece::joined(";", row))
}

/// The time between two runs of the child of a `RateController`, in milliseconds.
fn period(node: Node<'_>) -> Option<u64> {
    let value = node.attribute("hz").filter(|value| key_of("hz", value).is_none())?;
    let rate: f64 = value.trim().parse().ok()?;
    let period = std::time::Duration::try_from_secs_f64(1.0 / rate).ok()?;
    u64::try_from(period.as_millis()).ok().filter(|period| (10..1_000_000_000).contains(period))
}
