//! Transitions: the event that each one waits for, and its target.

use super::event::{completion_of, is_of_platform, matches, stems};
use super::expression;
use super::model::{Model, inner_states};
use super::{Writer, action};
use crate::name::{duration, plain};
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, number, tag};

/// Whether a transition stays inside its source.
fn is_internal(model: &Model<'_>, transition: Node<'_>, source: Node<'_>) -> bool {
    let ids = transition.attribute("target").unwrap_or_default();
    let is_inside = |id: &str| {
        let target = model.states.get(id);
        target.is_some_and(|target| target.node.ancestors().skip(1).any(|around| around == source))
    };
    transition.attribute("type") == Some("internal")
        && tag(source) == "state"
        && !ids.is_empty()
        && ids.split_whitespace().all(is_inside)
}

/// The parallel state that a transition from one of its regions does not leave here, but in SCXML.
fn parallel_that_stays<'a>(model: &Model<'a>, transition: Node<'a>, source: Node<'a>) -> Option<Node<'a>> {
    let ids = transition.attribute("target").filter(|ids| !ids.trim().is_empty())?;
    let targets: Vec<Node<'_>> = ids.split_whitespace().filter_map(|id| Some(model.states.get(id)?.node)).collect();
    let holds =
        |around: &Node<'_>| targets.iter().all(|target| target.ancestors().skip(1).any(|outer| outer == *around));
    let around = source.ancestors().skip(1).find(holds)?;
    (tag(around) == "parallel" && !is_internal(model, transition, source)).then_some(around)
}

/// Returns a transition: one for each event that fits, since a name of SCXML means all names that begin with it.
///
/// # Errors
/// It leads to a state that the chart does not have.
pub(super) fn transition(writer: &mut Writer<'_>, node: Node<'_>, source: Node<'_>) -> Result<String, ImportError> {
    let ids = node.attribute("target").unwrap_or_default();
    let names: Vec<String> = writer.model.named(node, ids)?.iter().map(|state| state.name.clone()).collect();
    let internal = if is_internal(&writer.model, node, source) { "internal " } else { "" };
    let target = if names.is_empty() { String::new() } else { format!(" -> {internal}{}", names.join(", ")) };
    let guard = match node.attribute("cond") {
        None => Some(String::new()),
        Some(code) => {
            expression::condition(code, &writer.model).map(|guard| format!(" when {}", action::outer(&guard)))
        }
    };
    let Some(guard) = guard else {
        let code = plain(node.attribute("cond").unwrap_or_default());
        let event = plain(node.attribute("event").unwrap_or("always"));
        let why = format!("a transition is left out, since its condition has no counterpart: {event} [{code}]{target}");
        return Ok(writer.remark(node, RemarkKind::Missing, why));
    };
    let mut remarks = String::new();
    let staying = parallel_that_stays(&writer.model, node, source).map(|around| writer.model.name(around).to_owned());
    if let Some(around) = staying {
        let why =
            format!("`{around}` stays active here, and its regions begin again; a chart leaves `{around}` as well");
        remarks += &writer.remark(node, RemarkKind::Differs, why);
    }
    let triggers = triggers(writer, node, source, &mut remarks);
    if triggers.is_empty() {
        return Ok(remarks);
    }
    let actions = action::actions(writer, node);
    let block = if actions.is_empty() { ";".to_owned() } else { format!(" {{\n{actions}}}") };
    let written: String = triggers.iter().map(|trigger| format!("on {trigger}{guard}{target}{block}\n")).collect();
    Ok(remarks + &written)
}

/// The triggers of a transition.
fn triggers(writer: &mut Writer<'_>, node: Node<'_>, source: Node<'_>, remarks: &mut String) -> Vec<String> {
    let Some(tokens) = node.attribute("event") else { return vec!["always".into()] };
    let mut triggers: Vec<String> = Vec::new();
    let mut add = |trigger: String| {
        if !triggers.contains(&trigger) {
            triggers.push(trigger);
        }
    };
    let invokes: Vec<Node<'_>> = elements(source).filter(|child| tag(*child) == "invoke").collect();
    for stem in stems(tokens) {
        let mut is_known = false;
        if stem == "*" || stem.is_empty() {
            add("any".into());
            continue;
        }
        if !invokes.is_empty() && matches("error", stem) {
            *remarks += &writer.remark(
                node,
                RemarkKind::Differs,
                "here, an error event is the failure of the process of this state",
            );
            add("aborted".into());
            is_known = true;
        }
        if let [invoke] = invokes.as_slice()
            && is_end_of(*invoke, stem)
        {
            add("done".into());
            is_known = true;
        }
        let from = writer.model.events.range(stem.to_owned()..);
        let similar = from.take_while(|(event, _)| event.starts_with(stem));
        for (event, known) in similar.filter(|(event, _)| matches(stem, event)) {
            is_known = true;
            let own = *event == completion_of(source) && writer.model.hears_completion(source);
            if own {
                add("complete".into());
                continue;
            }
            known.port.iter().for_each(|port| add(format!("message {port}")));
            known.signal.iter().for_each(|signal| add(format!("signal {signal}")));
        }
        let timers = writer.model.timers.range(stem.to_owned()..).take_while(|(event, _)| event.starts_with(stem));
        for (_, timer) in timers.filter(|(event, _)| matches(stem, event)) {
            is_known = true;
            add(format!("after {}", duration(timer.time)));
        }
        if !is_known && is_of_platform(stem) {
            let why = format!("nothing here sends the event `{stem}`: this trigger is left out");
            *remarks += &writer.remark(node, RemarkKind::Missing, why);
        }
    }
    triggers
}

/// Whether a token of a transition takes the end of a process that its state invokes.
fn is_end_of(invoke: Node<'_>, stem: &str) -> bool {
    // Without an id, the platform chooses one.
    let end = invoke.attribute("id").map(|id| format!("done.invoke.{id}"));
    matches("done.invoke", stem) && end.is_none_or(|end| matches(stem, &end))
}

/// Returns the actions that report the completion of a state to other states, as a part of this state or of a final state in it.
///
/// A final state raises the signal on its entry, where the event of the chart comes too. A parallel state raises the signal as
/// soon as all its regions have completed, and again if it completes again.
pub(super) fn completion(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let Some(parent) = node.parent().filter(|_| tag(node) == "final") else {
        return if tag(node) == "parallel" { regions_completion(writer, node) } else { String::new() };
    };
    let mut text = String::new();
    if tag(parent) == "state" && writer.model.tells_completion(parent) {
        text = format!("on entry {{ raise {}; }}\n", writer.model.signal_of(&completion_of(parent)));
    }
    let around = parent.ancestors().skip(1).take_while(|around| tag(*around) == "parallel");
    let told = around.filter_map(|around| writer.model.told.get(&number(around)));
    let forgets: String = told.map(|told| format!("{told} = false;\n")).collect();
    if forgets.is_empty() { text } else { format!("{text}on exit {{\n{forgets}}}\n") }
}

fn regions_completion(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let Some(told) = writer.model.told.get(&number(node)).cloned() else { return String::new() };
    let event = completion_of(node);
    let (signal, are_over) = (writer.model.signal_of(&event).to_owned(), over(&writer.model, node));
    let why = format!("`{}` comes behind all events of the step that completes it", plain(&event));
    let remark = writer.remark(node, RemarkKind::Differs, why);
    format!("{remark}on always when !{told} && {are_over} {{\n{told} = true;\nraise {signal};\n}}\n")
}

/// The condition that a state has completed.
fn over(model: &Model<'_>, state: Node<'_>) -> String {
    let join = |parts: Vec<String>, sign: &str| match parts.len() {
        1 => parts.concat(),
        _ => format!("({})", parts.join(sign)),
    };
    if tag(state) == "parallel" {
        return join(inner_states(state).map(|region| over(model, region)).collect(), " && ");
    }
    let ends = inner_states(state).filter(|inner| tag(*inner) == "final");
    join(ends.map(|end| format!("in({})", model.name(end))).collect(), " || ")
}
