//! Transitions: the event that each one waits for, and its target.

use super::event::{is_completion, is_of_platform, matches, stems};
use super::expression;
use super::model::Model;
use super::{Writer, action};
use crate::name::{duration, plain};
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// Returns whether a transition stays inside its source.
pub(super) fn is_internal(model: &Model<'_>, transition: Node<'_>, source: Node<'_>) -> bool {
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

/// Returns whether a transition waits for the end of the process that its state invokes.
pub(super) fn is_about_run(transition: Node<'_>) -> bool {
    stems(transition.attribute("event").unwrap_or_default())
        .any(|stem| matches("done.invoke", stem) || matches("error", stem))
}

/// Returns a transition: one for each event that fits, since a name of SCXML means all names that begin with it.
///
/// # Errors
/// It leads to a state that the chart does not have.
pub(super) fn transition(writer: &mut Writer<'_>, node: Node<'_>, source: Node<'_>) -> Result<String, ImportError> {
    let mut remarks = String::new();
    let target = match node.attribute("target") {
        None => String::new(),
        Some(ids) => {
            let names: Vec<String> = writer.model.named(node, ids)?.iter().map(|state| state.name.clone()).collect();
            if names.is_empty() { String::new() } else { format!(" -> {}", names.join(", ")) }
        }
    };
    let triggers = triggers(writer, node, source, &mut remarks);
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
        return Ok(remarks + &writer.remark(node, RemarkKind::Missing, why));
    };
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
    let invoked = elements(source).filter(|child| tag(*child) == "invoke").count();
    for stem in stems(tokens) {
        let mut is_known = false;
        if stem == "*" || stem.is_empty() {
            add("any".into());
            continue;
        }
        if invoked > 0 && matches("error", stem) {
            *remarks += &writer.remark(
                node,
                RemarkKind::Differs,
                "here, an error event is the failure of the process of this state",
            );
            add("aborted".into());
            continue;
        }
        if invoked == 1 && matches("done.invoke", stem) {
            add("done".into());
            continue;
        }
        let from = writer.model.events.range(stem.to_owned()..);
        let similar = from.take_while(|(event, _)| event.starts_with(stem));
        for (event, known) in similar.filter(|(event, _)| matches(stem, event)) {
            is_known = true;
            let own = is_completion(event) && source.attribute("id").is_some_and(|id| event[11..] == *id);
            match (&known.port, &known.signal) {
                _ if own => add("complete".into()),
                (Some(port), _) => add(format!("message {port}")),
                (None, Some(signal)) => add(format!("signal {signal}")),
                (None, None) => {}
            }
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

/// Returns the transition that tells other states of the completion of a state.
pub(super) fn completion(writer: &mut Writer<'_>, node: Node<'_>) -> String {
    let Some(id) = node.attribute("id").filter(|_| super::model::inner_states(node).next().is_some()) else {
        return String::new();
    };
    let event = format!("done.state.{id}");
    let Some(known) = writer.model.events.get(&event) else { return String::new() };
    let is_needed = writer.model.is_awaited(&event, Some(node));
    match known.signal.as_ref().filter(|_| is_needed) {
        Some(signal) => format!("on complete {{ raise {signal}; }}\n"),
        None => String::new(),
    }
}
