//! Delayed events that a chart sends to itself. Most of them become a timer of one state.

use super::event::{Awaited, matches, sent_to_self, stems, stems_of};
use super::model::{inner_states, is_state};
use crate::name::{Names, identifier};
use crate::xml::{Node, elements, number, tag};
use std::collections::{BTreeMap, BTreeSet};

/// The least time of a timer, in milliseconds.
pub(super) const LEAST: u64 = 10;

/// A delayed event that is a timer of the state that waits for it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Timer {
    /// The time, in milliseconds.
    pub(super) time: u64,
    /// The state that waits for the event.
    pub(super) state: u32,
    /// The id of the `<send>`, by which a `<cancel>` names it.
    pub(super) id: Option<String>,
}

/// A delayed event that waits in a region of its own.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ClockKey {
    pub(super) event: String,
    /// The time, in milliseconds.
    pub(super) time: u64,
    /// The id of the `<send>`, by which a `<cancel>` names it.
    pub(super) id: Option<String>,
}

/// The variables of a region for a delayed event.
///
/// They are not signals, because a transition for any event would take these.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Clock {
    /// The variable that begins the time.
    pub(super) start: String,
    /// The variable that ends it without the event, if a `<cancel>` names it.
    pub(super) cancel: Option<String>,
}

/// Returns the region that a `<send>` needs.
pub(super) fn clock_of(send: Node<'_>) -> Option<ClockKey> {
    let event = sent_to_self(send)?.to_owned();
    let time = delay(send).filter(|time| *time > 0)?.max(LEAST);
    Some(ClockKey { event, time, id: send.attribute("id").map(str::to_owned) })
}

/// Returns the regions for delayed events that are not timers of one state.
pub(super) fn clocks(
    own: &[Node<'_>],
    timers: &BTreeMap<String, Timer>,
    awaited: &Awaited,
    names: &mut Names,
) -> BTreeMap<ClockKey, Clock> {
    let cancelled: BTreeSet<&str> =
        own.iter().filter(|node| tag(**node) == "cancel").filter_map(|node| node.attribute("sendid")).collect();
    let sends = own.iter().filter(|node| tag(**node) == "send").filter_map(|send| clock_of(*send));
    let mut clocks = BTreeMap::new();
    let is_awaited = |event: &str| stems_of(event).chain(["*"]).any(|stem| awaited.contains_key(stem));
    for key in sends.filter(|key| !timers.contains_key(&key.event) && is_awaited(&key.event)) {
        clocks.entry(key).or_insert_with_key(|key: &ClockKey| {
            let event = identifier(&key.event);
            let is_cancelled = key.id.as_deref().is_some_and(|id| cancelled.contains(id));
            let start = names.take(&format!("later_{event}"));
            Clock { start, cancel: is_cancelled.then(|| names.take(&format!("cancel_{event}"))) }
        });
    }
    clocks
}

/// Returns the delay of a `<send>` in milliseconds; none if it is computed.
pub(super) fn delay(send: Node<'_>) -> Option<u64> {
    let text = match (send.attribute("delay"), send.attribute("delayexpr")) {
        (Some(text), None) => text.trim(),
        (None, None) => return Some(0),
        (None, Some(expression)) => super::expression::text_of(expression.trim())?,
        (Some(_), Some(_)) => return None,
    };
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 1.0),
        None => (text.strip_suffix('s')?, 1_000.0),
    };
    let time = number.trim().parse::<f64>().ok().filter(|number| *number >= 0.0)?;
    let time = std::time::Duration::try_from_secs_f64(time * unit / 1_000.0).ok()?;
    u64::try_from(time.as_millis()).ok().filter(|time| *time < 1_000_000_000)
}

/// Returns the delayed events of a chart that are timers of one state.
///
/// A state has a timer if it alone waits for the event, and if the event is sent whenever the state is entered: by its own
/// `<onentry>`, or by each transition to it. A `<cancel>` may name the event only where the state is left, since the timer
/// ends there.
pub(super) fn timers(own: &[Node<'_>], awaited: &Awaited) -> BTreeMap<String, Timer> {
    let mut sends_of: BTreeMap<&str, Vec<Node<'_>>> = BTreeMap::new();
    for &send in own.iter().filter(|node| tag(**node) == "send") {
        if let Some(event) = sent_to_self(send) {
            sends_of.entry(event).or_default().push(send);
        }
    }
    let raised: BTreeSet<&str> =
        own.iter().filter(|node| tag(**node) == "raise").filter_map(|node| node.attribute("event")).collect();
    let transitions: Vec<Node<'_>> = own.iter().copied().filter(|node| tag(*node) == "transition").collect();
    let mut timers = BTreeMap::new();
    // A transition for any event would not take the end of a timer.
    if awaited.contains_key("*") {
        return timers;
    }
    for (event, sends) in sends_of.iter().filter(|(event, _)| !raised.contains(*event)) {
        let handlers: BTreeSet<_> = stems_of(event).filter_map(|stem| awaited.get(stem)).flatten().collect();
        let takes =
            |node: &&Node<'_>| stems(node.attribute("event").unwrap_or_default()).any(|stem| matches(stem, event));
        let mut taking: Vec<&Node<'_>> = transitions.iter().filter(takes).collect();
        taking.pop();
        // Here, each transition has its own timer, and only a transition that leaves the state ends the other timers.
        let leaves =
            |node: &&Node<'_>| node.attribute("target").is_some() && node.attribute("type") != Some("internal");
        if !taking.iter().all(leaves) {
            continue;
        }
        let times: BTreeSet<Option<u64>> = sends.iter().map(|send| delay(*send)).collect();
        let (Some(&&state), Some(&Some(time)), 1, 1) = (handlers.first(), times.first(), handlers.len(), times.len())
        else {
            continue;
        };
        let state = own.iter().find(|node| number(**node) == state).copied();
        let ids: BTreeSet<Option<&str>> = sends.iter().map(|send| send.attribute("id")).collect();
        let (Some(&id), 1) = (ids.first(), ids.len()) else { continue };
        let is_timer = |state: &Node<'_>| {
            time > 0
                && is_state(*state)
                && is_sent_at_entry(sends, &transitions, *state)
                && is_cancelled_at_exit(own, id, *state)
        };
        if let Some(state) = state.filter(is_timer) {
            let (time, state, id) = (time.max(LEAST), number(state), id.map(str::to_owned));
            timers.insert((*event).to_owned(), Timer { time, state, id });
        }
    }
    timers
}

/// Whether each `<cancel>` of an id stands where a state is left: in its `<onexit>`, or in a transition of it to some state.
fn is_cancelled_at_exit(own: &[Node<'_>], id: Option<&str>, state: Node<'_>) -> bool {
    let cancels = own.iter().filter(|node| tag(**node) == "cancel" && id.is_some() && node.attribute("sendid") == id);
    cancels.filter_map(roxmltree::Node::parent).all(|block| {
        let is_exit = tag(block) == "onexit" || tag(block) == "transition" && block.attribute("target").is_some();
        is_exit && block.parent() == Some(state)
    })
}

/// Whether an event is sent whenever a state is entered.
fn is_sent_at_entry(sends: &[Node<'_>], transitions: &[Node<'_>], state: Node<'_>) -> bool {
    if let [send] = sends
        && let Some(block) = send.parent().filter(|block| tag(*block) == "onentry")
    {
        return block.parent() == Some(state);
    }
    let leads_here = |node: &&Node<'_>| names(**node, "target", state);
    // A transition to a state inside enters this state as well, without its event.
    let enters = |transition: &Node<'_>| match transition.parent() == Some(state) {
        true => transition.attribute("type") != Some("internal"),
        false => !transition.ancestors().any(|around| around == state),
    };
    let is_entered_inside = state.descendants().skip(1).filter(|inner| is_state(*inner)).any(|inner| {
        let mut entering = transitions.iter().filter(|transition| enters(transition));
        entering.any(|transition| names(*transition, "target", inner))
    });
    let is_remembered = state.ancestors().skip(1).any(|around| elements(around).any(|inner| tag(inner) == "history"));
    let entries: Vec<_> = transitions.iter().filter(leads_here).map(|node| number(*node)).collect();
    let sending: BTreeSet<_> = sends.iter().filter_map(|send| send.parent()).map(number).collect();
    let is_first = state.ancestors().skip(1).any(|around| names(around, "initial", state))
        || state.parent().is_some_and(|around| {
            let has_no_initial = around.attribute("initial").is_none();
            has_no_initial && (tag(around) == "parallel" || inner_states(around).next() == Some(state))
        });
    !is_first
        && !is_remembered
        && !is_entered_inside
        && entries.len() == sends.len()
        && entries.iter().all(|entry| sending.contains(entry))
}

/// Whether an attribute of an element names a state.
fn names(node: Node<'_>, attribute: &str, state: Node<'_>) -> bool {
    let id = state.attribute("id");
    node.attribute(attribute).is_some_and(|ids| ids.split_whitespace().any(|named| Some(named) == id))
}
