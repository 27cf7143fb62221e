//! Reads activities. Their states, transitions, variables and ports become a chart.

mod action;
mod domain;
mod endless;
mod filter;
mod formula;
mod notice;
mod outcome;
mod question;
mod remarks;
mod script;
mod shape;
mod state;
mod transition;

use super::declare;
use super::expression::{Group, useless_labels};
use super::names::{listed, twice};
use super::spec::{ChartModel, Direction, Expr, ExprKind, Outcome, Port};
use crate::automaton::{Automaton, Chart, Variable};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Filter, Notice, Question, StateChart};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Number};
use crate::syntax::ast::{Name, Node};
use domain::Domain;
use script::Scripts;
use std::collections::BTreeMap;

/// The number of messages that may wait at a port, unless the port declares another number.
const QUEUE: usize = 16;
/// The largest number of messages that may wait at a port.
const QUEUE_MAX: usize = 10_000;

/// Returns whether a process is an activity.
pub(crate) fn is_activity(node: &Node) -> bool {
    node.kind() == SyntaxKind::Process && node.names().next().is_some_and(|word| word.text == "activity")
}

/// Reads the states of an activity.
pub(super) fn read(node: &Node, group: &mut Group<'_>) -> Option<Expr> {
    let span = node.title().map_or(node.span(), |name| name.span);
    let mut reader = ActivityReader::new(group);
    reader.ports(node);
    reader.outcomes(node);
    reader.variables(node);
    reader.states(node);
    let runs = reader.take_runs();
    if reader.group.damage.actions {
        // The names in the runs are known. Errors in the states follow from the damaged text, so the states are not
        // checked.
        let parts: Vec<Expr> = runs.into_iter().map(|(_, run)| run).collect();
        return Some(Expr { span, kind: ExprKind::Sequence(parts) }).filter(|expr| !expr.parts().is_empty());
    }
    reader.transitions(node);
    reader.remarks(node);
    let written = std::mem::take(&mut reader.places).into_iter();
    let (places, labels): (Vec<Span>, Vec<String>) = written.map(|written| (written.span, written.label)).unzip();
    let run_labels = runs.iter().map(|(state, _)| reader.run_label(*state)).collect();
    let states: BTreeMap<usize, Span> = reader.names.values().map(|(state, name)| (*state, name.span)).collect();
    let chart = reader.chart();
    reader.check_outcomes(&chart, span);
    let is_sound = reader.is_sound;
    let notices = reader.heard.notices.iter().map(|(_, place)| *place).collect();
    let Scripts { models: scripts, kinds, .. } = std::mem::take(&mut reader.scripts);
    let ActivityInterface { inputs: mut ports, outputs, outcomes } = reader.interface;
    ports.extend(outputs);
    if let Some(diagnostic) = useless_labels(group) {
        group.diagnostics().push(diagnostic);
    }
    if is_sound && let Err(error) = Automaton::new(chart.chart.clone()) {
        let (place, message) = shape::explained(&error, &chart.chart, &states, &places);
        group.diagnostics().push(Diagnostic::new(Code::E0902, place.unwrap_or(span), message));
    }
    Some(Expr {
        span,
        kind: ExprKind::Chart(Box::new(ChartModel {
            chart,
            runs,
            notices,
            places,
            labels,
            run_labels,
            ports,
            outcomes,
            kinds,
            scripts,
        })),
    })
}

/// The events that the transitions of an activity wait for by a number.
#[derive(Default)]
struct Heard {
    filters: Vec<Filter>,
    /// The notices, each with the place where it is used first.
    notices: Vec<(Notice, Span)>,
    /// The signals. The flag says whether an action raises the signal.
    signals: Vec<(Name, bool)>,
    questions: Vec<Question>,
}

/// The parts of an activity that the group around it sees.
#[derive(Default)]
struct ActivityInterface {
    inputs: Vec<Port>,
    outputs: Vec<Port>,
    outcomes: Vec<Outcome>,
}

/// A transition in the text.
struct TransitionText {
    span: Span,
    /// The trigger and the condition.
    label: String,
}

/// Reads one activity.
struct ActivityReader<'r, 'g> {
    group: &'r mut Group<'g>,
    chart: Chart,
    /// The nodes of the states, also of histories.
    nodes: Vec<Node>,
    names: BTreeMap<String, (usize, Name)>,
    variables: BTreeMap<String, (usize, Domain)>,
    /// The values of variables with named values, with their numbers.
    values: BTreeMap<String, i64>,
    interface: ActivityInterface,
    heard: Heard,
    runs: Vec<(usize, Expr)>,
    /// The transitions in the text.
    places: Vec<TransitionText>,
    scripts: Scripts,
    is_sound: bool,
}

impl<'r, 'g> ActivityReader<'r, 'g> {
    fn new(group: &'r mut Group<'g>) -> Self {
        Self {
            group,
            chart: Chart::default(),
            nodes: Vec::new(),
            names: BTreeMap::new(),
            variables: BTreeMap::new(),
            values: BTreeMap::from([("false".to_owned(), 0), ("true".to_owned(), 1)]),
            interface: ActivityInterface::default(),
            heard: Heard::default(),
            runs: Vec::new(),
            places: Vec::new(),
            scripts: Scripts::default(),
            is_sound: true,
        }
    }

    /// Reports an error. The chart is then not checked as a whole.
    fn report(&mut self, diagnostic: Diagnostic) {
        self.is_sound = false;
        if !self.group.damage.actions {
            self.group.diagnostics().push(diagnostic);
        }
    }

    /// Returns the text of the expression that a state runs.
    fn run_label(&self, state: usize) -> String {
        let run = self.nodes[state].child(SyntaxKind::StateRun).and_then(|run| run.children().next());
        run.map_or_else(String::new, |run| formula::text(&run))
    }

    /// Returns the number of an opaque variable.
    fn kept(&self, name: &str) -> Option<usize> {
        self.group.kept.variables.get(name).copied().flatten()
    }

    fn take_runs(&mut self) -> Vec<(usize, Expr)> {
        std::mem::take(&mut self.runs)
    }

    /// Returns everything but the runs.
    fn chart(&mut self) -> StateChart {
        let names = |ports: &[Port]| ports.iter().map(|port| port.name.text.clone()).collect();
        StateChart {
            chart: std::mem::take(&mut self.chart),
            runs: Vec::new(),
            inputs: names(&self.interface.inputs),
            outputs: names(&self.interface.outputs),
            filters: std::mem::take(&mut self.heard.filters),
            notices: self.heard.notices.iter().map(|(notice, _)| notice.clone()).collect(),
            questions: std::mem::take(&mut self.heard.questions),
            signals: self.heard.signals.iter().map(|(name, _)| name.text.clone()).collect(),
        }
    }

    /// Reads `in speech: Text queue 8;` and `out say: Text;`.
    fn ports(&mut self, node: &Node) {
        let mut known: BTreeMap<String, Span> = BTreeMap::new();
        for port in node.children_of(SyntaxKind::Port).collect::<Vec<_>>() {
            let mut names = port.names();
            let (Some(word), Some(name)) = (names.next(), names.next()) else { continue };
            if let Some(&first) = known.get(&name.text) {
                self.report(twice("port", &name.text, name.span, first));
                continue;
            }
            known.insert(name.text.clone(), name.span);
            let kind = declare::kind(&port, &mut self.group.reader());
            let is_output = word.text == "out";
            let direction = if is_output { Direction::Out } else { Direction::In };
            let declared = Port { name, direction, kind, is_optional: true, call: None };
            if is_output {
                self.interface.outputs.push(declared);
                continue;
            }
            self.interface.inputs.push(declared);
            let queue = self.queue(&port);
            self.chart.ports.push(queue);
        }
    }

    /// Reads `done(held: Pose | gave_up);`.
    fn outcomes(&mut self, node: &Node) {
        let mut flags = node.children_of(SyntaxKind::Flag);
        let Some(first) = flags.next() else { return };
        if let Some(second) = flags.next() {
            self.report(twice("statement", "done", second.span(), first.span()));
        }
        let mut outcomes = Vec::new();
        declare::outcomes(&first, &mut outcomes, &mut self.group.reader());
        self.interface.outcomes = outcomes;
    }

    /// Reports an activity whose states can complete, so that the activity ends without one of its outcomes.
    fn check_outcomes(&mut self, chart: &StateChart, span: Span) {
        if !self.interface.outcomes.is_empty() && chart.completes() {
            let message = "the states of this activity can complete without an outcome";
            let diagnostic = Diagnostic::new(Code::E0902, span, message);
            self.report(diagnostic.help("write a transition `-> done(OUTCOME)` instead of a `final state`"));
        }
    }

    /// Returns how many messages may wait at a port.
    fn queue(&mut self, port: &Node) -> usize {
        let Some(token) = port.token(Number) else { return QUEUE };
        let count = token.text().replace('_', "").parse::<usize>().ok();
        count.filter(|count| (1..=QUEUE_MAX).contains(count)).unwrap_or_else(|| {
            let message =
                format!("`{}` is not a number of waiting messages, which is from 1 to {QUEUE_MAX}", token.text());
            self.report(Diagnostic::new(Code::E0009, token.span(), message));
            QUEUE
        })
    }

    /// Reads `var tries: 0..3 = 0;` and `var place: opaque = ();`.
    fn variables(&mut self, node: &Node) {
        let mut known: BTreeMap<String, Span> = BTreeMap::new();
        for node in node.children_of(SyntaxKind::StateVariable).collect::<Vec<_>>() {
            let Some(name) = node.names().nth(1) else { continue };
            if let Some(&first) = known.get(&name.text) {
                self.report(twice("variable", &name.text, name.span, first));
                continue;
            }
            known.insert(name.text.clone(), name.span);
            let domain_node = node.child(SyntaxKind::Domain);
            let Some(domain) = domain_node.as_ref().and_then(|node| self.domain(node)) else {
                // The name is known, so uses of the variable are not reported as mistakes.
                self.group.kept.variables.insert(name.text.clone(), None);
                let any = Domain::Range(i32::MIN, i32::MAX);
                let (min, max) = any.range();
                self.variables.insert(name.text.clone(), (self.chart.variables.len(), any));
                self.chart.variables.push(Variable { name: name.text, min, max, initial: 0, names: Vec::new() });
                self.is_sound = false;
                continue;
            };
            let initial = node.child(SyntaxKind::Formula);
            if domain == Domain::Opaque {
                self.group.kept.variables.insert(name.text, Some(self.chart.slots));
                let kind = domain_node.and_then(|node| declare::kind(&node, &mut self.group.reader()));
                self.scripts.kinds.extend(kind.map(|kind| (self.chart.slots, kind)));
                self.chart.slots += 1;
                let is_empty = initial.as_ref().is_none_or(|initial| initial.compact_text() == "()");
                if let (false, Some(initial)) = (is_empty, initial) {
                    let message = "an opaque variable begins empty";
                    self.report(Diagnostic::new(Code::E0904, initial.span(), message).help("write `= ()`"));
                }
                continue;
            }
            self.group.kept.variables.insert(name.text.clone(), None);
            let (min, max) = domain.range();
            let value = initial.and_then(|initial| self.start_value(&initial, &domain));
            let names = domain.names();
            self.variables.insert(name.text.clone(), (self.chart.variables.len(), domain));
            self.chart.variables.push(Variable { name: name.text, min, max, initial: value.unwrap_or(min), names });
        }
    }

    /// Returns a state of the activity. If there is no such state, reports this, with a similar name.
    fn state_named(&mut self, name: &Name) -> Option<usize> {
        if let Some((state, _)) = self.names.get(&name.text) {
            return Some(*state);
        }
        let names: Vec<String> = self.names.keys().cloned().collect();
        let message = format!("`{}` is not a state of this activity", name.text);
        let diagnostic = Diagnostic::new(Code::E0901, name.span, message);
        let near = self.group.diagnostics().near(&name.text, names.iter().map(String::as_str));
        let diagnostic = match &near {
            Some(near) => diagnostic.rename(name.span, near),
            None => diagnostic.help(format!("its states are {}", listed(names.iter().map(String::as_str)))),
        };
        self.report(diagnostic);
        None
    }
}
