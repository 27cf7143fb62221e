//! The states of an activity as a picture: a state is a box, and a transition is an arrow.
//!
//! Transitions arrive at a port on the left of a state. On its right it has a port for each of its transitions. An arrow between
//! states of different depth passes through ports of the states around them.

use super::model::{self, End, Link, Port, Unit};
use super::words;
use crate::automaton::{Chart, History, StateKind, Target};
use crate::check::spec::{ChartModel, Direction};
use crate::plan::{Group, StateChart};
use std::collections::BTreeMap;

/// The port at which transitions arrive.
const ARRIVAL: &str = "in";

/// The texts in the picture of an activity.
struct ChartTexts {
    /// The trigger and the condition of each transition.
    labels: Vec<String>,
    /// The expression of each run, by its state.
    runs: BTreeMap<usize, String>,
    /// The host of each box: an index into the hosts.
    host: usize,
    /// Whether a page colours its states.
    is_live: bool,
}

/// Returns the picture of an activity that runs on a host.
pub(super) fn unit(model: &ChartModel, host: usize) -> Unit {
    let states = model.runs.iter().map(|(state, _)| *state);
    let runs = states.zip(model.run_labels.iter().cloned()).collect();
    draw(&model.chart.chart, &ChartTexts { labels: model.labels.clone(), runs, host, is_live: false })
}

/// Returns the picture of an activity of a plan, for a page that colours its states.
pub(super) fn live_unit(chart: &StateChart, group: &Group) -> Unit {
    let labels = chart.chart.transitions.iter().map(|transition| words::transition(chart, transition)).collect();
    let runs = chart.runs.iter().map(|run| (run.state as usize, words::members(&run.expression, group))).collect();
    draw(&chart.chart, &ChartTexts { labels, runs, host: 0, is_live: true })
}

fn draw(chart: &Chart, texts: &ChartTexts) -> Unit {
    let mut drawing = Drawing { chart, boxes: vec![Drawn::default(); chart.states.len()] };
    for (state, declared) in chart.states.iter().enumerate() {
        let first: Vec<usize> = match &declared.kind {
            StateKind::Compound { initial } => initial.clone(),
            StateKind::Parallel => {
                let is_history = |child: &usize| matches!(chart.states[*child].kind, StateKind::History { .. });
                drawing.children(state).into_iter().filter(|child| !is_history(child)).collect()
            }
            StateKind::History { default, .. } => {
                default.iter().for_each(|&target| drawing.arrow(state, target, "at first"));
                continue;
            }
            StateKind::Atomic | StateKind::Final | StateKind::Suspended => continue,
        };
        first.into_iter().for_each(|target| drawing.inward(state, target, ARRIVAL));
    }
    for (transition, label) in chart.transitions.iter().zip(&texts.labels) {
        match &transition.target {
            Target::Stay => drawing.note(transition.source, label),
            Target::Resume => drawing.note(transition.source, &format!("{label} → resume")),
            Target::Done(_) => drawing.note(transition.source, &format!("{label} → done")),
            Target::Abort(why) => drawing.note(transition.source, &format!("{label} → abort: {why}")),
            Target::States(targets) => {
                targets.iter().for_each(|&target| drawing.arrow(transition.source, target, label));
            }
        }
    }
    drawing.unit(texts, 0)
}

/// The ports of a state, and the arrows inside it.
#[derive(Clone, Default)]
struct Drawn {
    ports: Vec<Port>,
    links: Vec<Link>,
}

struct Drawing<'a> {
    chart: &'a Chart,
    boxes: Vec<Drawn>,
}

impl Drawing<'_> {
    fn parent(&self, state: usize) -> Option<usize> {
        self.chart.states[state].parent
    }

    fn children(&self, state: usize) -> Vec<usize> {
        (0..self.chart.states.len()).filter(|&child| self.parent(child) == Some(state)).collect()
    }

    /// Whether a state is inside another one, at any depth.
    fn is_inside(&self, state: usize, other: usize) -> bool {
        self.chart.upward(state).skip(1).any(|around| around == other)
    }

    /// The port of a state with this name.
    fn port(&mut self, state: usize, name: &str, direction: Direction) -> usize {
        model::port(&mut self.boxes[state].ports, name, direction)
    }

    /// A transition without an arrow.
    fn note(&mut self, state: usize, label: &str) {
        let direction = if self.parent(state).is_none() { Direction::In } else { Direction::Out };
        self.port(state, label, direction);
    }

    /// An arrow from a state to another one.
    fn arrow(&mut self, source: usize, target: usize, label: &str) {
        if source == 0 || self.is_inside(target, source) {
            return self.inward(source, target, label);
        }
        let mut around = self.chart.upward(source).skip(1);
        let around = around.find(|&state| self.is_inside(target, state)).unwrap_or(0);
        let (from, to) = (self.leaves(source, label, around), self.enters(target, around));
        self.link(around, from, to);
    }

    /// An arrow from the border of a state to a state inside it.
    fn inward(&mut self, state: usize, target: usize, label: &str) {
        if !self.is_inside(target, state) {
            return self.note(state, label);
        }
        let from = End { unit: None, port: self.port(state, label, Direction::In) };
        let to = self.enters(target, state);
        self.link(state, from, to);
    }

    /// The end of an arrow to a state, at the border of the state around it that stands directly in `around`.
    fn enters(&mut self, target: usize, around: usize) -> End {
        let name = format!("to {}", self.chart.states[target].name);
        let (mut state, mut port) = (target, self.port(target, ARRIVAL, Direction::In));
        while let Some(parent) = self.parent(state).filter(|&parent| parent != around) {
            let outer = self.port(parent, &name, Direction::In);
            let inner = self.end(state, port);
            self.link(parent, End { unit: None, port: outer }, inner);
            (state, port) = (parent, outer);
        }
        self.end(state, port)
    }

    /// The same of an arrow from a state.
    fn leaves(&mut self, source: usize, label: &str, around: usize) -> End {
        let name = format!("{}: {label}", self.chart.states[source].name);
        let (mut state, mut port) = (source, self.port(source, label, Direction::Out));
        while let Some(parent) = self.parent(state).filter(|&parent| parent != around) {
            let outer = self.port(parent, &name, Direction::Out);
            let inner = self.end(state, port);
            self.link(parent, inner, End { unit: None, port: outer });
            (state, port) = (parent, outer);
        }
        self.end(state, port)
    }

    /// A port of a state, as the state around it knows it.
    fn end(&self, state: usize, port: usize) -> End {
        let slot = self.parent(state).and_then(|parent| self.children(parent).iter().position(|&child| child == state));
        End { unit: slot, port }
    }

    fn link(&mut self, around: usize, from: End, to: End) {
        let links = &mut self.boxes[around].links;
        if links.iter().all(|link| (link.from, link.to) != (from, to)) {
            links.push(Link::plain(from, to));
        }
    }

    fn unit(&self, texts: &ChartTexts, state: usize) -> Unit {
        let declared = &self.chart.states[state];
        let kind = match &declared.kind {
            StateKind::Atomic | StateKind::Compound { .. } => "",
            StateKind::Parallel => "parallel",
            StateKind::Final => "final",
            StateKind::Suspended => "suspended",
            StateKind::History { depth: History::Shallow, .. } => "history",
            StateKind::History { depth: History::Deep, .. } => "deep history",
        };
        let parts = [Some(kind), texts.runs.get(&state).map(String::as_str)];
        let parts: Vec<&str> = parts.into_iter().flatten().filter(|part| !part.is_empty()).collect();
        let children = self.children(state);
        Unit {
            name: declared.name.clone(),
            key: texts.is_live.then(|| declared.name.clone()),
            kind: parts.join(", "),
            host: texts.host,
            is_group: !children.is_empty(),
            ports: self.boxes[state].ports.clone(),
            units: children.into_iter().map(|child| self.unit(texts, child)).collect(),
            links: self.boxes[state].links.clone(),
            ..Unit::default()
        }
    }
}
