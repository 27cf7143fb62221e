//! The attributes of nodes that the import reads. Each other attribute has a remark.

use super::context::Context;
use super::leaf::id_of;
use super::library::{Sort, is_port, sort_of};
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// The attributes of every node, beside its ports. The editors write the last ones, which mean nothing for the behavior.
const OF_ALL: [&str; 13] = [
    "_while",
    "_skipIf",
    "_successIf",
    "_failureIf",
    "_onSuccess",
    "_onFailure",
    "_post",
    "_onHalted",
    "_autoremap",
    "__autoremap",
    "_fullpath",
    "_uid",
    "_description",
];

/// Notes the attributes of a node that are not read.
pub(super) fn unread(context: &mut Context<'_>, node: Node<'_>) -> Result<(), ImportError> {
    let id = id_of(context, node)?;
    let ports = if sort_of(tag(node)) == Some(Sort::SubTree) { None } else { ports_of(id) };
    for attribute in node.attributes() {
        let name = attribute.name();
        if is_port(name) {
            if ports.is_some_and(|ports| !ports.contains(&name) && !is_case(id, name)) {
                let text = format!("the attribute `{name}` of <{id}> is not read");
                context.remark(node, RemarkKind::Missing, text);
            }
        } else if name.starts_with('_') && !OF_ALL.contains(&name) {
            context.remark(node, RemarkKind::Missing, format!("the attribute `{name}` is not known"));
        }
    }
    Ok(())
}

/// Whether an attribute is the value of a case of a `Switch`.
fn is_case(id: &str, name: &str) -> bool {
    let number = |text: &str, prefix: &str| text.strip_prefix(prefix)?.parse::<usize>().ok();
    let (cases, case) = (number(id, "Switch"), number(name, "case_"));
    cases.zip(case).is_some_and(|(cases, case)| (1..=cases).contains(&case))
}

/// The ports of a node that the import reads; none if it takes all of them, or has a remark on the whole node.
fn ports_of(id: &str) -> Option<&'static [&'static str]> {
    Some(match id {
        "Sequence"
        | "AsyncSequence"
        | "Fallback"
        | "AsyncFallback"
        | "SequenceWithMemory"
        | "SequenceStar"
        | "ReactiveSequence"
        | "ReactiveFallback"
        | "WhileDoElse"
        | "IfThenElse"
        | "AlwaysSuccess"
        | "AlwaysFailure"
        | "Inverter"
        | "ForceSuccess"
        | "ForceFailure"
        | "KeepRunningUntilFailure"
        | "PipelineSequence"
        | "RoundRobin"
        | "PersistentSequence"
        | "NonblockingSequence" => &[],
        "Parallel" => &["success_count", "failure_count"],
        "ParallelAll" => &["max_failures"],
        "Switch2" | "Switch3" | "Switch4" | "Switch5" | "Switch6" => &["variable"],
        "TryCatch" => &["catch_on_halt"],
        "Script" | "ScriptCondition" => &["code"],
        "Sleep" | "Timeout" => &["msec"],
        "Delay" => &["delay_msec"],
        "RetryUntilSuccessful" | "RetryUntilSuccesful" => &["num_attempts"],
        "Repeat" => &["num_cycles"],
        "RunOnce" => &["then_skip"],
        "Precondition" => &["if", "else"],
        "RecoveryNode" => &["number_of_retries"],
        "RateController" => &["hz"],
        _ => return None,
    })
}

/// Notes that the last child of a `TryCatch` does not run after a stop.
pub(super) fn catch_on_halt(context: &mut Context<'_>, node: Node<'_>) {
    let value = node.attribute("catch_on_halt").map(str::trim);
    if value.is_some_and(|value| value != "false" && value != "0") && elements(node).next().is_some() {
        let text = "`catch_on_halt` has no counterpart: here, a stop of this node does not run its last child; \
                    `P finally C` runs C after each end of P, also after a success";
        context.remark(node, RemarkKind::Missing, text);
    }
}
