//! Exports a plan as a transition system for other tools: the Aldebaran format of CADP and mCRL2, and the DOT format of Graphviz.

use crate::explore::{Graph, Limits, Nobody, Reached, explore};
use crate::model::Model;
use crate::story::{member_name, seconds, timer_of};
use crate::system::{Label, Mode, System};
use language::automaton::Failure;
use language::plan::Plan;
use language::sites::Sites;

/// A transition system. State 0 is the initial state. A state without transitions has ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transitions {
    /// The number of states.
    pub states: u32,
    /// The source, the event and the target.
    pub all: Vec<(u32, String, u32)>,
    /// The limit that was reached. If there is one, states are missing.
    pub reached: Option<Reached>,
}

/// Returns the complete behaviour of a plan, if its programs may fail and stops may come at any time. Nothing is reduced.
pub fn transitions(plan: &Plan, sites: &Sites, limits: &Limits<'_>) -> Transitions {
    let model = Model::of_groups(plan, sites);
    let mut system = System::new(&model, 0, &|_| true);
    // The models for other tools have no order of timers.
    system.forget_order();
    explored(system, limits)
}

/// Returns the same behaviour, but timers of an expression expire in their order. For comparisons with the answers.
#[doc(hidden)]
pub fn transitions_in_order(plan: &Plan, sites: &Sites, limits: &Limits<'_>) -> Transitions {
    let model = Model::of_groups(plan, sites);
    explored(System::new(&model, 0, &|_| true), limits)
}

fn explored(mut system: System<'_>, limits: &Limits<'_>) -> Transitions {
    system.mode = Mode { aborts: true, stops: true, ..Mode::default() };
    let graph: Graph = explore(&system, limits, true, &Nobody).graph;
    let states = graph.store.count();
    let from = |state| graph.from(state).map(move |(label, target)| (state, label, target));
    let all = (0..states).flat_map(from).map(|(state, label, target)| (state, word(&system, label), target));
    Transitions { states, all: all.collect(), reached: graph.reached }
}

/// Returns a label as one word: `done(hit/force)`, `elapsed(main, 5 s)`.
fn word(system: &System<'_>, label: Label) -> String {
    let part = |unit: u16| &system.model.parts[system.units[usize::from(unit)].part];
    let group = |unit: u16| system.model.group_name(part(unit).group);
    let member = |unit: u16, slot: u16| member_name(system, usize::from(unit), u32::from(slot)).unwrap_or_default();
    match label {
        Label::Start | Label::StartWith(_) => "start".to_owned(),
        Label::Stop => "stop".to_owned(),
        Label::Done(unit, slot, value) => match system.tag(value) {
            Some(tag) => format!("done({}, {tag})", member(unit, slot)),
            None => format!("done({})", member(unit, slot)),
        },
        Label::Aborted(unit, slot, why) => match system.reason_told(why) {
            Some(reason) => format!("aborted({}, {})", member(unit, slot), reason.to_string().replace('"', "'")),
            None => format!("aborted({})", member(unit, slot)),
        },
        Label::Stopped(unit, slot) => format!("stopped({})", member(unit, slot)),
        Label::Elapsed(unit, timer) => {
            let time = timer_of(&part(unit).expression, usize::from(timer)).map(seconds).unwrap_or_default();
            format!("elapsed({}, {time}, {timer})", group(unit))
        }
        Label::Told(unit, number) => format!("message({}, {number})", group(unit)),
        Label::Script(unit, kind) => format!("script({}, {})", group(unit), Failure::of_script(kind)),
        Label::Reached(unit) => format!("reached({})", group(unit)),
        Label::Arrived(unit, slot) => format!("arrived({})", member(unit, slot)),
        Label::Heard(unit, slot) => format!("heard({})", member(unit, slot)),
        Label::Fault(unit, slot) | Label::Second(unit, slot) => format!("fault({})", member(unit, slot)),
        Label::Died(unit, slot) | Label::Back(unit, slot) => format!("restart({})", member(unit, slot)),
        Label::TooMany(unit) => format!("restarts({})", group(unit)),
        Label::Lost | Label::Noted(_) => "lost".to_owned(),
    }
}

impl Transitions {
    /// Returns the system in the Aldebaran format.
    pub fn aut(&self) -> String {
        let mut text = format!("des (0, {}, {})\n", self.all.len(), self.states);
        for (from, word, to) in &self.all {
            text += &format!("({from}, \"{word}\", {to})\n");
        }
        text
    }

    /// Returns the system for Graphviz.
    pub fn dot(&self) -> String {
        let mut text =
            "digraph {\n  rankdir=LR;\n  node [shape=circle, label=\"\", width=0.2];\n  0 [style=filled];\n".to_owned();
        for (from, word, to) in &self.all {
            text += &format!("  {from} -> {to} [label=\"{word}\"];\n");
        }
        text + "}\n"
    }
}
