//! The parts of a chart: states, events and data.

use super::event::{self, Awaited, EventUse};
use super::expression;
use super::timer::{self, Clock, ClockKey, Timer};
use crate::name::{Names, identifier};
use crate::xml::{ImportError, Node, number, tag};
use std::collections::{BTreeMap, BTreeSet};

/// A state, or a history.
#[derive(Clone, Debug)]
pub(super) struct State<'a> {
    /// The name in the spec.
    pub(super) name: String,
    pub(super) node: Node<'a>,
}

/// The values of a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Number(i32),
    Truth(bool),
    /// The values, each with its name in the spec.
    Named {
        values: Vec<(String, String)>,
        first: String,
    },
    /// Something that an activity cannot look into.
    Unknown,
}

/// A variable.
#[derive(Clone, Debug)]
pub(super) struct Variable<'a> {
    pub(super) name: String,
    pub(super) kind: Kind,
    pub(super) node: Node<'a>,
}

/// A chart.
#[derive(Debug)]
pub(super) struct Model<'a> {
    pub(super) file: &'a str,
    pub(super) states: BTreeMap<&'a str, State<'a>>,
    /// The name of each state, also of states without an id, by node.
    names: BTreeMap<u32, String>,
    pub(super) state_names: Names,
    pub(super) events: BTreeMap<String, EventUse>,
    /// The events that are timers of one state.
    pub(super) timers: BTreeMap<String, Timer>,
    pub(super) variables: BTreeMap<&'a str, Variable<'a>>,
    /// The delayed events that need a region of their own.
    pub(super) clocks: BTreeMap<ClockKey, Clock>,
    /// The variables that say whether a signal has reported the completion of a parallel state, by the number of its node.
    pub(super) told: BTreeMap<u32, String>,
    /// The names that transitions wait for, with the states of these transitions.
    awaited: Awaited,
    /// Whether a transition takes any event.
    pub(super) has_any: bool,
}

/// Returns whether an element is a state or a history.
pub(super) fn is_state(node: Node<'_>) -> bool {
    matches!(tag(node), "state" | "parallel" | "final" | "history")
}

/// Returns the states directly inside an element, without histories.
pub(super) fn inner_states(node: Node<'_>) -> impl Iterator<Item = Node<'_>> {
    crate::xml::elements(node).filter(|child| is_state(*child) && tag(*child) != "history")
}

impl<'a> Model<'a> {
    /// Reads a chart.
    ///
    /// # Errors
    /// Two states have the same id.
    pub(super) fn read(file: &'a str, root: Node<'a>) -> Result<Self, ImportError> {
        // The content of an <invoke> is a chart of its own.
        let own: Vec<Node<'a>> = own_elements(root);
        let mut model = Self {
            file,
            states: BTreeMap::new(),
            names: BTreeMap::new(),
            state_names: Names::default(),
            events: BTreeMap::new(),
            clocks: BTreeMap::new(),
            told: BTreeMap::new(),
            timers: BTreeMap::new(),
            variables: BTreeMap::new(),
            awaited: Awaited::new(),
            has_any: false,
        };
        for &node in own.iter().filter(|node| is_state(**node)) {
            let id = node.attribute("id");
            let name = model.state_names.take(&identifier(id.unwrap_or("unnamed")));
            model.names.insert(number(node), name.clone());
            let Some(id) = id else { continue };
            if let Some(first) = model.states.insert(id, State { name, node }) {
                let (line, _) = crate::xml::place(first.node);
                let why = format!("a second state has the id `{id}`; the first one is in line {line}");
                return Err(ImportError::at(file, node, why));
            }
        }
        let mut names = Names::default();
        model.variables = variables(&own, &mut names);
        let written = written(&own, &model);
        model.awaited = event::awaited(&written);
        model.has_any = model.awaited.contains_key("*");
        model.timers = timer::timers(&written, &model.awaited);
        model.events = event::events(&written, &model.timers);
        model.clocks = timer::clocks(&written, &model.timers, &model.awaited, &mut names);
        for state in written.iter().filter(|node| tag(**node) == "parallel" && event::can_complete(**node)) {
            if model.tells_completion(*state) {
                model.told.insert(number(*state), names.take("told"));
            }
        }
        Ok(model)
    }

    /// Whether a transition waits for an event, without the transitions of one state.
    pub(super) fn is_awaited(&self, event: &str, besides: Option<Node<'_>>) -> bool {
        let besides = besides.map(number);
        event::stems_of(event)
            .filter_map(|stem| self.awaited.get(stem))
            .any(|states| states.iter().any(|state| Some(*state) != besides))
    }

    /// Whether a signal reports the completion of a state, because not only this state waits for it.
    pub(super) fn tells_completion(&self, state: Node<'_>) -> bool {
        let event = event::completion_of(state);
        let is_needed = self.has_any || self.is_awaited(&event, Some(state));
        is_needed && self.events.contains_key(&event) && inner_states(state).next().is_some()
    }

    /// The signal for an event; empty if there is none.
    pub(super) fn signal_of(&self, event: &str) -> &str {
        self.events.get(event).and_then(|known| known.signal.as_deref()).unwrap_or_default()
    }

    /// Whether only a state itself waits for its completion.
    pub(super) fn hears_completion(&self, state: Node<'_>) -> bool {
        inner_states(state).next().is_some() && !self.tells_completion(state)
    }

    /// Returns the name of a state.
    pub(super) fn name(&self, node: Node<'_>) -> &str {
        self.names.get(&number(node)).map_or("", String::as_str)
    }

    /// Returns the states that a list of ids means.
    ///
    /// # Errors
    /// The chart has no state with one of the ids.
    pub(super) fn named(&self, node: Node<'_>, ids: &str) -> Result<Vec<&State<'a>>, ImportError> {
        let state = |id: &str| {
            let why = || format!("no state has the id `{id}`");
            self.states.get(id).ok_or_else(|| ImportError::at(self.file, node, why()))
        };
        ids.split_whitespace().map(state).collect()
    }
}

/// The elements of a chart, without the content of elements that the chart does not know or invokes.
fn own_elements(root: Node<'_>) -> Vec<Node<'_>> {
    let mut found = Vec::new();
    let mut waiting = vec![root];
    while let Some(node) = waiting.pop() {
        found.push(node);
        let has_states = matches!(tag(node), "scxml" | "state" | "parallel" | "final");
        let is_known = has_states || is_state(node);
        if is_known || matches!(tag(node), "initial" | "transition" | "onentry" | "onexit" | "datamodel") {
            let inner = crate::xml::elements(node).filter(|inner| has_states || !is_state(*inner));
            waiting.extend(inner.collect::<Vec<_>>().into_iter().rev());
        }
    }
    found
}

/// The elements of a chart that have a counterpart: nothing waits for an event, or raises it, in a part that is left out.
fn written<'a>(own: &[Node<'a>], model: &Model<'a>) -> Vec<Node<'a>> {
    let mut left_out = BTreeSet::new();
    let mut written = Vec::new();
    for &node in own {
        let around = node.parent().filter(|around| around.is_element());
        let is_inside = |tags: &[&str]| around.is_some_and(|around| tags.contains(&tag(around)));
        let has_counterpart = match tag(node) {
            "raise" | "send" | "assign" | "log" | "cancel" | "script" => {
                is_inside(&["onentry", "onexit", "transition"])
            }
            "transition" if is_trigger(node) => {
                node.attribute("cond").is_none_or(|code| expression::condition(code, model).is_some())
            }
            "transition" => is_inside(&["initial", "history"]),
            "onentry" | "onexit" | "initial" | "invoke" | "datamodel" | "data" => true,
            _ => is_state(node) || around.is_none(),
        };
        if has_counterpart && around.is_none_or(|around| !left_out.contains(&number(around))) {
            written.push(node);
        } else {
            left_out.insert(number(node));
        }
    }
    written
}

/// Returns whether a transition waits for its event: it is not the first one of a history or of an `<initial>`.
pub(super) fn is_trigger(transition: Node<'_>) -> bool {
    let around = transition.parent().map(tag);
    tag(transition) == "transition" && around.is_some_and(|around| ["scxml", "state", "parallel"].contains(&around))
}

/// The variables, each with the values that it may have.
fn variables<'a>(own: &[Node<'a>], names: &mut Names) -> BTreeMap<&'a str, Variable<'a>> {
    let mut variables: BTreeMap<&'a str, Variable<'a>> = BTreeMap::new();
    for &node in own.iter().filter(|node| tag(**node) == "data") {
        let Some(id) = node.attribute("id") else { continue };
        let is_simple = node.attribute("src").is_none() && node.first_child().is_none();
        let first = node.attribute("expr").map(str::trim);
        let kind = match first.filter(|_| is_simple) {
            None if is_simple => Kind::Number(0),
            None => Kind::Unknown,
            Some("true") => Kind::Truth(true),
            Some("false") => Kind::Truth(false),
            Some(first) => match (first.parse(), expression::text_of(first)) {
                (Ok(number), _) => Kind::Number(number),
                (Err(_), Some(first)) => Kind::Named { values: Vec::new(), first: first.into() },
                (Err(_), None) => Kind::Unknown,
            },
        };
        variables.entry(id).or_insert_with(|| Variable { name: names.take(&identifier(id)), kind, node });
    }
    let mut assigned_to: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for node in own.iter().filter(|node| tag(**node) == "assign") {
        let (id, expression) = (node.attribute("location"), node.attribute("expr"));
        assigned_to.entry(id.unwrap_or_default()).or_default().push(expression.unwrap_or_default().trim());
    }
    let mut compared_with: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for code in own.iter().filter_map(|node| node.attribute("cond")) {
        for (id, text) in expression::compared(code) {
            compared_with.entry(id).or_default().insert(text);
        }
    }
    for (id, variable) in &mut variables {
        let assigned = assigned_to.get(id).map(Vec::as_slice).unwrap_or_default();
        match &mut variable.kind {
            Kind::Number(first) => {
                let is_truth = !assigned.is_empty() && assigned.iter().all(|expr| ["true", "false"].contains(expr));
                if is_truth && variable.node.attribute("expr").is_none() {
                    variable.kind = Kind::Truth(false);
                } else if !(-1_000_000..=1_000_000).contains(first) {
                    variable.kind = Kind::Unknown;
                }
            }
            Kind::Named { values, first } => {
                let all = std::iter::once(Some(first.clone()))
                    .chain(assigned.iter().map(|expr| expression::text_of(expr).map(str::to_owned)))
                    .collect::<Option<Vec<String>>>();
                match all {
                    None => variable.kind = Kind::Unknown,
                    Some(mut all) => {
                        all.extend(compared_with.get(*id).into_iter().flatten().cloned());
                        all.push("other".into());
                        for value in all {
                            if values.len() < 900 && !values.iter().any(|(known, _)| *known == value) {
                                let name = names.take(&identifier(&value));
                                values.push((value, name));
                            }
                        }
                    }
                }
            }
            Kind::Truth(_) | Kind::Unknown => {}
        }
    }
    variables
}
