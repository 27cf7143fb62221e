//! Nodes with one child.

use super::condition::{check, inside};
use super::context::{Around, Context, node as child_node};
use super::leaf::key_of;
use super::module::Role;
use super::piece::Piece;
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// The most further tries of a `retry`.
pub(super) const RETRIES_MAX: i64 = 100;
/// The most rounds of a repetition that is written out.
const ROUNDS_MAX: i64 = 1_000;

/// Returns a number that a node has as an attribute; none if it is not there or stands on the blackboard.
pub(super) fn number(context: &mut Context<'_>, node: Node<'_>, attribute: &str) -> Result<Option<i64>, ImportError> {
    let Some(value) = node.attribute(attribute) else { return Ok(None) };
    if key_of(attribute, value).is_some() {
        let text =
            format!("`{attribute}` is `{value}` of the blackboard: a spec needs a number, so the default stands here");
        context.remark(node, RemarkKind::Missing, text);
        return Ok(None);
    }
    let wrong =
        |_not| context.error(node, format!("`{value}` is not a number; `{attribute}` of <{}> needs one", tag(node)));
    value.trim().parse().map(Some).map_err(wrong)
}

/// Returns a time that a node has as an attribute; none if it is not there or stands on the blackboard.
pub(super) fn milliseconds(
    context: &mut Context<'_>,
    node: Node<'_>,
    attribute: &str,
) -> Result<Option<u64>, ImportError> {
    let Some(number) = number(context, node, attribute)? else { return Ok(None) };
    let time = u64::try_from(number).map_err(|_negative| {
        let why = format!("`{number}` is not a time; `{attribute}` of <{}> needs milliseconds from 0", tag(node));
        context.error(node, why)
    })?;
    Ok(Some(time))
}

/// The child of a node that has one.
pub(super) fn only_child<'a>(context: &Context<'a>, node: Node<'a>) -> Result<Node<'a>, ImportError> {
    let mut all = elements(node);
    match (all.next(), all.next()) {
        (Some(child), None) => Ok(child),
        (None, _) => Err(context.error(node, format!("<{}> has no child", tag(node)))),
        (Some(_), Some(second)) => {
            Err(context.error(second, format!("a second child of <{}>, which has one", tag(node))))
        }
    }
}

/// Translates a node with one child; none if it is not one of these nodes.
pub(super) fn content<'a>(
    context: &mut Context<'a>,
    node: Node<'a>,
    name: &str,
    around: Around,
) -> Result<Option<Piece>, ImportError> {
    let known = [
        "Inverter",
        "ForceSuccess",
        "ForceFailure",
        "RetryUntilSuccessful",
        "RetryUntilSuccesful",
        "Repeat",
        "KeepRunningUntilFailure",
        "Timeout",
        "Delay",
        "RunOnce",
        "Precondition",
        "LoopInt",
        "LoopBool",
        "LoopDouble",
        "LoopString",
        "SkipUnlessUpdated",
        "WaitValueUpdate",
    ];
    if !known.contains(&name) {
        return Ok(None);
    }
    let child = only_child(context, node)?;
    let piece = child_node(context, child, inside(name, 1, around))?;
    Ok(Some(match name {
        "Inverter" => piece.inverted(&succeeded(context, child)?),
        "ForceSuccess" => piece.tolerated(),
        "ForceFailure" => piece.tolerated().then(Piece::fail("ForceFailure")),
        "Repeat" => repeat(context, node, piece)?,
        "KeepRunningUntilFailure" => piece.forever(),
        "Timeout" => match milliseconds(context, node, "msec")? {
            Some(time) if time > 0 => piece.limited(time),
            Some(_) | None => piece,
        },
        "Delay" => match milliseconds(context, node, "delay_msec")? {
            Some(time) if time > 0 => Piece::wait(time).then(piece),
            Some(_) | None => piece,
        },
        "RunOnce" => {
            let later = match node.attribute("then_skip").map(str::trim) {
                None | Some("true" | "1") => "are skipped",
                Some("false" | "0") => "return its first result",
                Some(_) => "are skipped, or return its first result",
            };
            let text = format!("this node runs each time; in the tree, it runs once, and later ticks {later}");
            context.remark(node, RemarkKind::Differs, text);
            piece
        }
        "Precondition" => precondition(context, node, piece, around),
        "RetryUntilSuccessful" | "RetryUntilSuccesful" => retry(context, node, piece)?,
        _ => {
            context.remark(
                node,
                RemarkKind::Missing,
                format!("`{name}` has no counterpart: only its child is imported"),
            );
            piece
        }
    }))
}

/// The reason of the failure of an inverted node.
pub(super) fn succeeded<'a>(context: &Context<'a>, node: Node<'a>) -> Result<String, ImportError> {
    let id = super::leaf::id_of(context, node)?;
    Ok(format!("{} has succeeded", node.attribute("name").unwrap_or(id)))
}

fn retry(context: &mut Context<'_>, node: Node<'_>, piece: Piece) -> Result<Piece, ImportError> {
    let attempts = number(context, node, "num_attempts")?.unwrap_or(1);
    Ok(match attempts {
        // Until the child succeeds: a loop that only a success ends, with a failure of the loop.
        -1 => piece.inverted("it has succeeded").forever().tolerated(),
        ..=0 => Piece::fail("no attempts"),
        1 => piece,
        2.. => {
            let tries = (attempts - 1).min(RETRIES_MAX);
            if tries < attempts - 1 {
                let text = format!(
                    "in the tree, this node tries {attempts} times; a spec can try at most {} times",
                    RETRIES_MAX + 1
                );
                context.remark(node, RemarkKind::Differs, text);
            }
            piece.prefixed(&format!("retry({tries})"))
        }
    })
}

fn repeat(context: &mut Context<'_>, node: Node<'_>, piece: Piece) -> Result<Piece, ImportError> {
    let cycles = number(context, node, "num_cycles")?.unwrap_or(1);
    Ok(match cycles {
        -1 => piece.forever(),
        ..=0 => Piece::skip(),
        1 => piece,
        2..=ROUNDS_MAX => {
            // Each index is different from the indexes of the loops around it.
            context.indices += 1;
            piece.repeated(&format!("i{}", context.indices), cycles)
        }
        _ => return Err(context.error(node, format!("{cycles} rounds; a spec can write {ROUNDS_MAX} of them, or -1"))),
    })
}

/// `<Precondition if="…" else="…">`
fn precondition(context: &mut Context<'_>, node: Node<'_>, piece: Piece, around: Around) -> Piece {
    let code = node.attribute("if").unwrap_or_default();
    let otherwise = node.attribute("else").unwrap_or("FAILURE");
    let role = if otherwise == "RUNNING" { Role::Until } else { Role::Once };
    let check = check(context, node, code, role);
    match (otherwise, around) {
        ("RUNNING", _) => check.then(piece),
        ("SUCCESS", _) | ("SKIPPED", Around::Sequence | Around::Other) => check.choice(piece, Piece::skip()),
        _ => check.then(piece),
    }
}
