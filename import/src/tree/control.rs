//! Nodes with several children.

use super::condition::{self, check, script};
use super::context::{Around, Context, children, node as child_node};
use super::decorator;
use super::leaf::{id_of, key_of, leaf, subtree};
use super::library::{Direction, Sort, sort_of};
use super::module::{ModuleKey, Role};
use super::navigation;
use super::piece::Piece;
use super::reactive;
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// Translates a node by its name.
pub(super) fn content<'a>(context: &mut Context<'a>, node: Node<'a>, around: Around) -> Result<Piece, ImportError> {
    if sort_of(tag(node)) == Some(Sort::SubTree) {
        return subtree(context, node);
    }
    let name = id_of(context, node)?;
    match name {
        "Sequence" | "AsyncSequence" => {
            let inside = condition::inside(name, elements(node).count(), around);
            Ok(Piece::joined(";", children(context, node, inside)?))
        }
        "Fallback" | "AsyncFallback" => {
            let inside = condition::inside(name, elements(node).count(), around);
            Ok(fallback(children(context, node, inside)?))
        }
        "SequenceWithMemory" | "SequenceStar" => {
            let text = "when this node is tried again, it begins with its first child; in the tree, it begins with the child that failed";
            context.remark(node, RemarkKind::Differs, text);
            Ok(Piece::joined(";", children(context, node, Around::Sequence)?))
        }
        "Parallel" => parallel(context, node),
        "ParallelAll" => parallel_all(context, node),
        "ReactiveSequence" => reactive::sequence(context, node),
        "ReactiveFallback" => reactive::fallback(context, node),
        "WhileDoElse" => reactive::while_do_else(context, node),
        "IfThenElse" => if_then_else(context, node),
        "Switch2" | "Switch3" | "Switch4" | "Switch5" | "Switch6" => switch(context, node),
        "TryCatch" => try_catch(context, node),
        "AlwaysSuccess" => Ok(Piece::skip()),
        "AlwaysFailure" => Ok(Piece::fail("AlwaysFailure")),
        "Script" => Ok(script(context, node, node.attribute("code").unwrap_or_default())),
        "ScriptCondition" => Ok(check(context, node, node.attribute("code").unwrap_or_default(), Role::Once)),
        "Sleep" => Ok(match decorator::milliseconds(context, node, "msec")? {
            Some(time) => Piece::wait(time),
            None => leaf(context, node, Role::Once)?,
        }),
        _ => match decorator::content(context, node, name, around)? {
            Some(piece) => Ok(piece),
            None => match navigation::content(context, node, name)? {
                Some(piece) => Ok(piece),
                None => unknown(context, node, name),
            },
        },
    }
}

/// Returns `a else b else c`.
pub(super) fn fallback(pieces: Vec<Piece>) -> Piece {
    if pieces.is_empty() { Piece::fail("a Fallback without children") } else { Piece::joined("else", pieces) }
}

/// A node that only its program knows.
fn unknown<'a>(context: &mut Context<'a>, node: Node<'a>, name: &str) -> Result<Piece, ImportError> {
    let count = elements(node).count();
    if count == 0 {
        return leaf(context, node, Role::Once);
    }
    let what = if count == 1 { "only its child is imported" } else { "its children run one after the other here" };
    context.remark(node, RemarkKind::Missing, format!("`{name}` is not a node of BehaviorTree.CPP: {what}"));
    Ok(Piece::joined(";", children(context, node, Around::Sequence)?))
}

/// How many children a threshold means; a negative number counts from the end.
fn threshold(context: &Context<'_>, node: Node<'_>, value: i64) -> Result<usize, ImportError> {
    let count = elements(node).count();
    let signed = i64::try_from(count).unwrap_or(i64::MAX);
    let wanted = if value < 0 { signed.saturating_add(value).saturating_add(1).max(0) } else { value };
    usize::try_from(wanted)
        .ok()
        .filter(|wanted| *wanted <= count)
        .ok_or_else(|| context.error(node, format!("`{value}` is more than the {count} children of this node")))
}

fn parallel<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let count = elements(node).count();
    let successes = decorator::number(context, node, "success_count")?.unwrap_or(-1);
    let failures = decorator::number(context, node, "failure_count")?.unwrap_or(1);
    let (successes, failures) = (threshold(context, node, successes)?, threshold(context, node, failures)?);
    let pieces = children(context, node, Around::Other)?;
    if successes == 0 {
        context.remark(
            node,
            RemarkKind::Differs,
            "in the tree, this node succeeds before a child runs; here, no child is started",
        );
        return Ok(Piece::skip());
    }
    // So many failures leave too few children for a success.
    let hopeless = count - successes + 1;
    if failures < hopeless && failures == 1 && successes == 1 {
        return Ok(Piece::joined("#", pieces));
    }
    if failures < hopeless {
        let text = format!(
            "in the tree, this node fails after {failures} failures; here, it fails after {hopeless} failures, when it can no longer succeed"
        );
        context.remark(node, RemarkKind::Differs, text);
    }
    Ok(match successes == count {
        true => Piece::joined("&", pieces),
        false => Piece::any_of(successes, pieces),
    })
}

fn parallel_all<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let failures = decorator::number(context, node, "max_failures")?.unwrap_or(1);
    if threshold(context, node, failures)? != 1 {
        let text = format!(
            "in the tree, this node fails when {failures} children fail; here, it fails when one child fails, after all children have ended"
        );
        context.remark(node, RemarkKind::Differs, text);
    }
    Ok(Piece::joined(",", children(context, node, Around::Other)?))
}

/// The children of a node that has two or three.
pub(super) fn branches<'a>(
    context: &Context<'a>,
    node: Node<'a>,
) -> Result<(Node<'a>, Node<'a>, Option<Node<'a>>), ImportError> {
    let all: Vec<Node<'a>> = elements(node).collect();
    match all.as_slice() {
        [condition, yes] => Ok((*condition, *yes, None)),
        [condition, yes, no] => Ok((*condition, *yes, Some(*no))),
        [..] => Err(context.error(node, format!("<{}> has {} children; it needs two or three", tag(node), all.len()))),
    }
}

/// Translates a node that chooses once.
pub(super) fn if_then_else<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let (condition, yes, no) = branches(context, node)?;
    let condition = child_node(context, condition, Around::Other)?;
    let yes = child_node(context, yes, Around::Other)?;
    Ok(match no {
        None => condition.then(yes),
        Some(no) => {
            let no = child_node(context, no, Around::Other)?;
            condition.choice(yes, no)
        }
    })
}

/// A `Switch` becomes a module with an outcome for each case.
fn switch<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    let arms: Vec<Node<'a>> = elements(node).collect();
    let cases = id_of(context, node)?.trim_start_matches("Switch").parse::<usize>().unwrap_or(0);
    if arms.len() != cases + 1 {
        let why = format!("<{}> has {} children; it needs one for each case, and a default", tag(node), arms.len());
        return Err(context.error(node, why));
    }
    let variable = node.attribute("variable").unwrap_or_default();
    let values: Vec<&str> =
        (1..=cases).map(|number| node.attribute(format!("case_{number}").as_str()).unwrap_or_default()).collect();
    let key = ModuleKey { id: format!("switch {variable} {values:?}"), role: Role::Once };
    let listed: Vec<String> =
        (1..).zip(&values).map(|(number, value)| format!("`case_{number}` is `{value}`")).collect();
    context.modules.declare(&key, "Switch", &format!("Chooses by the value of `{variable}`: {}.", listed.join(", ")));
    let outcomes: Vec<String> = (1..=cases).map(|number| format!("case_{number}")).chain(["other".into()]).collect();
    context.modules.outcomes(&key, &outcomes);
    let name = context.modules.name(&key).to_owned();
    context.remark(
        node,
        RemarkKind::Missing,
        format!("`{name}` is a program that you have to write; it reads `{variable}`"),
    );
    let text = "this node chooses once; in the tree, it chooses again at each tick, and halts the previous child";
    context.remark(node, RemarkKind::Differs, text);
    let port = super::leaf::PortUse {
        port: "variable".into(),
        value: variable.into(),
        direction: Some(Direction::Reads).filter(|_| key_of("variable", variable).is_some()),
    };
    let chosen = super::leaf::program(context, node, &key, &crate::name::snake(&name), vec![port]);
    let mut matched = Vec::new();
    for (outcome, arm) in outcomes.into_iter().zip(arms) {
        matched.push((outcome, child_node(context, arm, Around::Other)?));
    }
    Ok(chosen.matched(matched))
}

/// The last child cleans up after a failure of the others.
fn try_catch<'a>(context: &mut Context<'a>, node: Node<'a>) -> Result<Piece, ImportError> {
    super::attribute::catch_on_halt(context, node);
    let mut pieces = children(context, node, Around::Sequence)?;
    let (Some(last), false) = (pieces.pop(), pieces.is_empty()) else {
        return Err(context.error(node, "<TryCatch> needs two children at least"));
    };
    let failure = last.tolerated().then(Piece::fail("a child of TryCatch failed"));
    Ok(Piece::joined(";", pieces).or_else(failure))
}
