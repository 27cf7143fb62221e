//! The events of a chart: messages from outside, and signals from inside.

use super::model::{Model, inner_states, is_trigger};
use super::timer::{self, Timer};
use crate::name::{Names, identifier};
use crate::xml::{Node, number, tag};
use std::collections::{BTreeMap, BTreeSet};

/// How an event comes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct EventUse {
    /// The port for this event; none if it cannot come from outside.
    pub(super) port: Option<String>,
    /// The signal; none if the chart does not raise it.
    pub(super) signal: Option<String>,
}

/// Returns whether an event says that a state is complete.
fn is_completion(event: &str) -> bool {
    event.starts_with("done.state.")
}

/// Returns the event that says that a state is complete.
pub(super) fn completion_of(state: Node<'_>) -> String {
    match state.attribute("id") {
        Some(id) => format!("done.state.{id}"),
        // No id has a space, so no transition names this event alone.
        None => format!("done.state. {}", number(state)),
    }
}

/// Returns whether a state can complete.
pub(super) fn can_complete(state: Node<'_>) -> bool {
    match tag(state) {
        "state" => inner_states(state).any(|inner| tag(inner) == "final"),
        "parallel" => inner_states(state).next().is_some() && inner_states(state).all(can_complete),
        _ => false,
    }
}

/// Returns whether an event comes from the platform, or from a process that a state invokes.
pub(super) fn is_of_platform(event: &str) -> bool {
    ["error", "done.invoke", "done.state"].iter().any(|stem| matches(stem, event))
}

/// Returns whether a token of a transition takes an event.
pub(super) fn matches(stem: &str, event: &str) -> bool {
    event == stem || event.strip_prefix(stem).is_some_and(|rest| rest.starts_with('.'))
}

/// Returns the names in the `event` of a transition, without the marks of a prefix.
pub(super) fn stems(tokens: &str) -> impl Iterator<Item = &str> {
    tokens.split_whitespace().map(|token| token.trim_end_matches(".*").trim_end_matches('.'))
}

/// The names that transitions wait for, each with the states of these transitions.
pub(super) type Awaited = BTreeMap<String, BTreeSet<u32>>;

/// Returns the names that the transitions of a chart wait for.
pub(super) fn awaited(own: &[Node<'_>]) -> Awaited {
    let mut awaited = Awaited::new();
    for node in own.iter().filter(|node| is_trigger(**node)) {
        let Some(source) = node.parent() else { continue };
        for stem in stems(node.attribute("event").unwrap_or_default()) {
            awaited.entry(stem.to_owned()).or_default().insert(number(source));
        }
    }
    awaited
}

/// Returns the names that take an event: `a.b` is taken by `a.b` and by `a`.
pub(super) fn stems_of(event: &str) -> impl Iterator<Item = &str> {
    event.match_indices('.').map(|(end, _)| &event[..end]).chain([event])
}

/// Returns the event that a `<send>` gives to the chart itself, at once or later.
pub(super) fn sent_to_self(send: Node<'_>) -> Option<&str> {
    let is_own = send.attribute("target").is_none_or(|target| target == "#_internal")
        && send.attribute("targetexpr").is_none()
        && send.attribute("typeexpr").is_none()
        && send.attribute("type").is_none_or(|kind| kind.ends_with("SCXMLEventProcessor") || kind == "scxml");
    send.attribute("event").filter(|_| is_own)
}

/// Returns the events that the elements of a chart name, without those that are timers.
pub(super) fn events(own: &[Node<'_>], timers: &BTreeMap<String, Timer>) -> BTreeMap<String, EventUse> {
    let completions: Vec<String> =
        own.iter().filter(|node| can_complete(**node)).map(|node| completion_of(*node)).collect();
    let (mut raised, mut awaited, mut completed) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    for node in own {
        match tag(*node) {
            "raise" => raised.extend(node.attribute("event")),
            "send" if timer::delay(*node) == Some(0) => raised.extend(sent_to_self(*node)),
            "send" if timer::delay(*node).is_some() => {
                raised.extend(sent_to_self(*node).filter(|event| !timers.contains_key(*event)));
            }
            // An event after a computed time has to come from outside.
            "send" => awaited.extend(sent_to_self(*node).filter(|event| !timers.contains_key(*event))),
            "transition" if is_trigger(*node) => {
                let tokens = node.attribute("event").unwrap_or_default();
                for stem in stems(tokens) {
                    let is_any = stem == "*" || stem.is_empty();
                    let similar = completions.iter().map(String::as_str);
                    completed.extend(similar.filter(|event| is_any || matches(stem, event)));
                    if is_any {
                        continue;
                    }
                    if is_completion(stem) {
                        completed.insert(stem);
                    } else if !is_of_platform(stem) && !timers.contains_key(stem) {
                        awaited.insert(stem);
                    }
                }
            }
            _ => {}
        }
    }
    let (mut ports, mut signals) = (Names::default(), Names::default());
    let mut events = BTreeMap::new();
    for event in raised.union(&awaited).copied().chain(completed.difference(&raised).copied()) {
        let is_raised = raised.contains(event) || completed.contains(event);
        // An event that the chart raises can also come from outside, if a transition names it.
        let port = awaited.contains(event).then(|| ports.take(&identifier(event)));
        let signal = is_raised.then(|| signals.take(&identifier(event)));
        events.insert(event.to_owned(), EventUse { port, signal });
    }
    if own
        .iter()
        .any(|node| is_trigger(*node) && stems(node.attribute("event").unwrap_or_default()).any(|stem| stem == "*"))
    {
        events.insert("*".into(), EventUse { port: Some(ports.take("other")), signal: None });
    }
    events
}

/// Transitions of the whole chart that do nothing, for signals that only `on any` takes: a signal has to be declared.
pub(super) fn dummies(model: &Model<'_>) -> String {
    let mut text = String::new();
    for known in model.events.values().filter(|_| model.has_any) {
        if let Some(signal) = &known.signal {
            text += &format!("on signal {signal};\n");
        }
    }
    text
}
