//! Translates SCXML into charts, as far as activities have a counterpart.
//!
//! An external event is a message, with a port for each name. An event that is raised is a signal. If a chart sends an event to itself,
//! the event leaves through an output, and the test brings it back. Data are integers in finite variables.

mod expression;
mod xml;

use language::algebra::Value;
use language::automaton::{
    Action, Chart, ChartState, Formula, History, StateKind, Target, Transition, Trigger, ValueSource, Variable,
};
use std::time::Duration;
use xml::Element;

/// A chart and the meaning of its ports and outputs.
pub(super) struct Translated {
    pub(super) chart: Chart,
    /// The names of events; a port and a signal each.
    pub(super) events: Vec<String>,
    /// The meaning of each output.
    pub(super) outputs: Vec<Output>,
}

/// The meaning of an output of a translated chart.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Output {
    /// The event comes back after a time.
    Event(usize, Duration),
    /// This final state of the root was entered.
    Final(usize),
}

/// Translates a chart whose script sends these events.
///
/// # Errors
/// The first part of the chart without a counterpart.
pub(super) fn translate(text: &str, sent: &[String]) -> Result<Translated, String> {
    let root = xml::parse(text)?;
    let mut translator = Translator { events: sent.to_vec(), ..Translator::default() };
    root.walk(&mut |element| translator.declare(element))?;
    translator.state(&root, None)?;
    let states = translator.elements.clone();
    for (number, element) in states.iter().enumerate() {
        translator.fill(number, element)?;
    }
    let ports = vec![16; translator.events.len()];
    let Translator { states, transitions, variables, events, outputs, .. } = translator;
    Ok(Translated { chart: Chart { states, transitions, variables, slots: 0, ports }, events, outputs })
}

#[derive(Default)]
struct Translator<'a> {
    states: Vec<ChartState>,
    elements: Vec<&'a Element>,
    transitions: Vec<Transition>,
    variables: Vec<Variable>,
    events: Vec<String>,
    outputs: Vec<Output>,
}

/// Whether an element is a state or a history.
fn is_state(element: &Element) -> bool {
    ["state", "parallel", "final", "history"].contains(&element.name.as_str())
}

impl<'a> Translator<'a> {
    /// Notes names of events and variables, and refuses elements without a counterpart.
    fn declare(&mut self, element: &Element) -> Result<(), String> {
        match element.name.as_str() {
            "scxml" | "state" | "parallel" | "final" | "history" | "initial" | "onentry" | "onexit" | "transition"
            | "datamodel" | "log" | "assign" => {}
            "raise" => self.note(element.get("event").ok_or("an event without a name")?),
            "send" => self.note(element.get("event").ok_or("an event whose name is computed")?),
            "data" => {
                let name = element.get("id").ok_or("data without a name")?;
                let initial = match element.get("expr") {
                    _ if element.get("src").is_some() => return Err("data in a file".into()),
                    None if element.is_empty => 0,
                    None => return Err("data that is not a number".into()),
                    Some(expression) => expression.trim().parse().map_err(|_not| "data that is not a number")?,
                };
                let variable = Variable { name: name.into(), min: i32::MIN, max: i32::MAX, initial };
                self.variables.push(variable);
            }
            other => return Err(format!("<{other}>")),
        }
        let event = element.get("event").filter(|_| element.name == "transition");
        for token in event.unwrap_or_default().split_whitespace() {
            if token.starts_with("error") || token.starts_with("done.invoke") {
                // Nothing of the kind happens here: a chart that waits for it has no counterpart.
                return Err("an event of the platform".into());
            }
            if token != "*" {
                self.note(token.trim_end_matches(".*").trim_end_matches('.'));
            }
        }
        Ok(())
    }

    fn note(&mut self, event: &str) {
        if !self.events.iter().any(|other| other == event) {
            self.events.push(event.into());
        }
    }

    /// Adds a state with the states inside it.
    fn state(&mut self, element: &'a Element, parent: Option<usize>) -> Result<(), String> {
        let number = self.states.len();
        let name = element.get("id").map_or_else(|| format!("#{number}"), str::to_owned);
        let state = ChartState { name, parent, kind: StateKind::Atomic, run: None, entry: vec![], exit: vec![] };
        self.states.push(state);
        self.elements.push(element);
        element.children.iter().filter(|child| is_state(child)).try_for_each(|child| self.state(child, Some(number)))
    }

    fn named(&self, names: &str) -> Result<Vec<usize>, String> {
        let number = |name: &str| self.states.iter().position(|state| state.name == name);
        names.split_whitespace().map(|name| number(name).ok_or_else(|| format!("no state {name}"))).collect()
    }

    /// Fills in the content of a state.
    fn fill(&mut self, number: usize, element: &'a Element) -> Result<(), String> {
        let first = self.states.iter().position(|state| state.parent == Some(number));
        self.states[number].kind = match element.name.as_str() {
            "parallel" => StateKind::Parallel,
            "final" => StateKind::Final,
            "history" => {
                let depth = if element.get("type") == Some("deep") { History::Deep } else { History::Shallow };
                StateKind::History { depth, default: self.default_of(element)? }
            }
            _ => match (element.child("initial"), element.get("initial"), first) {
                (Some(initial), _, _) => StateKind::Compound { initial: self.default_of(initial)? },
                (None, Some(names), _) => StateKind::Compound { initial: self.named(names)? },
                (None, None, Some(first)) => StateKind::Compound { initial: vec![first] },
                (None, None, None) => StateKind::Atomic,
            },
        };
        let is_history = element.name == "history";
        for child in element.children.iter().filter(|_| !is_history) {
            match child.name.as_str() {
                "onentry" => {
                    let actions = self.actions(child)?;
                    self.states[number].entry.extend(actions);
                }
                "onexit" => {
                    let actions = self.actions(child)?;
                    self.states[number].exit.extend(actions);
                }
                "transition" => self.transition(number, child)?,
                _ => {}
            }
        }
        if element.name == "final" && self.states[number].parent == Some(0) {
            let output = self.output(Output::Final(number));
            self.states[number].entry.push(output);
        }
        self.completion(number);
        Ok(())
    }

    /// Where an `<initial>` or a history leads.
    fn default_of(&self, element: &Element) -> Result<Vec<usize>, String> {
        let transition = element.child("transition").ok_or("a history without a default")?;
        if !transition.children.is_empty() {
            return Err("actions of an initial transition".into());
        }
        self.named(transition.get("target").unwrap_or_default())
    }

    /// An event `done.state.S` is a signal that `S` raises when it completes.
    fn completion(&mut self, number: usize) {
        let event = format!("done.state.{}", self.states[number].name);
        let has_children = matches!(self.states[number].kind, StateKind::Compound { .. } | StateKind::Parallel);
        if let Some(signal) = self.events.iter().position(|other| *other == event).filter(|_| has_children) {
            let mut transition = Transition::new(number, Trigger::Complete, Target::Stay);
            transition.actions.push(Action::Raise(signal));
            self.transitions.push(transition);
        }
    }

    fn output(&mut self, output: Output) -> Action {
        self.outputs.push(output);
        Action::Send { output: self.outputs.len() - 1, value: ValueSource::Constant(Value::EMPTY) }
    }

    fn actions(&mut self, block: &Element) -> Result<Vec<Action>, String> {
        let mut actions = vec![];
        for element in &block.children {
            let event = || element.get("event").and_then(|event| self.events.iter().position(|other| other == event));
            match element.name.as_str() {
                "log" => {}
                "raise" => actions.push(Action::Raise(event().ok_or("an event without a name")?)),
                "send" => {
                    let event = event().ok_or("an event without a name")?;
                    let unusual = |name: &&str| element.get(name).is_some();
                    let unusual = ["namelist", "type", "id", "idlocation", "delayexpr", "targetexpr"]
                        .iter()
                        .find(|name| unusual(name));
                    match (element.get("target"), unusual) {
                        (_, Some(name)) => return Err(format!("<send {name}>")),
                        (Some("#_internal"), None) => actions.push(Action::Raise(event)),
                        (Some(_), None) => return Err("<send target>".into()),
                        (None, None) => {
                            let delay = duration(element.get("delay").unwrap_or("0s"))?;
                            actions.push(self.output(Output::Event(event, delay)));
                        }
                    }
                }
                "assign" => {
                    let name = element.get("location").unwrap_or_default();
                    let variable = self.variables.iter().position(|variable| variable.name == name);
                    let variable = variable.ok_or("a variable that was not declared")?;
                    let formula = self.formula(element.get("expr").ok_or("an assignment of text")?)?;
                    actions.push(Action::Assign { variable, formula });
                }
                other => return Err(format!("<{other}>")),
            }
        }
        Ok(actions)
    }

    fn formula(&self, text: &str) -> Result<Formula, String> {
        let variable = |name: &str| self.variables.iter().position(|variable| variable.name == name);
        let state = |name: &str| self.states.iter().position(|state| state.name == name);
        expression::parse(text, &variable, &state).ok_or_else(|| "an expression that is not one of numbers".into())
    }

    /// One transition for each event that fits, since a name of SCXML means all names that begin with it.
    fn transition(&mut self, source: usize, element: &'a Element) -> Result<(), String> {
        let guard = element.get("cond").map(|text| self.formula(text)).transpose()?;
        let target = match element.get("target") {
            None => Target::Stay,
            Some(names) => Target::States(self.named(names)?),
        };
        let actions = self.actions(element)?;
        let internal = element.get("type") == Some("internal") || source == 0;
        let mut triggers = vec![];
        match element.get("event") {
            None => triggers.push(Trigger::Always),
            Some(tokens) => {
                for token in tokens.split_whitespace() {
                    let stem = token.trim_end_matches(".*").trim_end_matches('.');
                    if token == "*" {
                        triggers.push(Trigger::Any);
                    }
                    for (number, name) in self.events.iter().enumerate() {
                        if name == stem || name.strip_prefix(stem).is_some_and(|rest| rest.starts_with('.')) {
                            triggers.push(Trigger::Message { port: number, filter: None });
                            triggers.push(Trigger::Signal(number));
                        }
                    }
                }
            }
        }
        for trigger in triggers {
            let (guard, target, actions) = (guard.clone(), target.clone(), actions.clone());
            self.transitions.push(Transition { source, trigger, guard, target, internal, actions });
        }
        Ok(())
    }
}

/// A duration as CSS writes it.
fn duration(text: &str) -> Result<Duration, String> {
    let wrong = || format!("the delay {text}");
    let (number, unit) = match text.strip_suffix("ms") {
        Some(number) => (number, 0.001),
        None => (text.strip_suffix('s').ok_or_else(wrong)?, 1.0),
    };
    let number: f64 = number.parse().map_err(|_not| wrong())?;
    Duration::try_from_secs_f64(number * unit).map_err(|_not| wrong())
}
