//! Random charts of SCXML.

use crate::random::Random;
use std::fmt::Write as _;

/// An action.
#[derive(Clone, Debug)]
pub(super) enum Act {
    Log(String),
    Raise(String),
    /// The counter goes up by one.
    Count,
    Reset,
    Send {
        event: usize,
        milliseconds: u64,
        id: usize,
    },
    Cancel(usize),
}

/// The condition of a transition.
#[derive(Clone, Copy, Debug)]
pub(super) enum Condition {
    /// The counter is below a limit.
    Below(i64),
    In(usize),
    NotIn(usize),
    /// The import leaves out the transition.
    Foreign,
}

#[derive(Clone, Debug)]
pub(super) struct Transition {
    pub(super) source: usize,
    /// The tokens of its `event`; none for a transition without an event.
    pub(super) events: Vec<String>,
    pub(super) condition: Option<Condition>,
    pub(super) targets: Vec<usize>,
    pub(super) is_internal: bool,
    pub(super) acts: Vec<Act>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Atomic,
    Compound,
    Parallel,
    Final,
    History { deep: bool },
}

/// A state; number 0 is the chart itself, and each state stands before the states inside it.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub(super) kind: Kind,
    pub(super) parent: Option<usize>,
    /// The states directly inside, with histories.
    pub(super) children: Vec<usize>,
    /// The `initial` of the chart, or where a history leads at first.
    pub(super) initial: Vec<usize>,
    pub(super) entry: Vec<Act>,
    pub(super) exit: Vec<Act>,
    pub(super) transitions: Vec<Transition>,
}

/// The events from outside.
pub(super) const OUTSIDE: [&str; 8] = ["e0", "e0.a", "e0.a.b", "e1", "e2", "i0", "i0.a", "i1"];
const INSIDE: [&str; 3] = ["i0", "i0.a", "i1"];
const TOKENS: [&str; 13] =
    ["e0", "e0", "e0.*", "e0.a", "e1", "e1", "e2", "i0", "i0.a", "i1", "*", "done.state", "done.state.*"];

/// Makes a random chart.
pub(super) fn chart(random: &mut Random) -> Vec<State> {
    let mut maker = Maker { random, states: Vec::new(), labels: 0 };
    maker.grow(None, Kind::Compound, 0);
    for state in 0..maker.states.len() {
        maker.fill(state);
    }
    maker.states
}

struct Maker<'r> {
    random: &'r mut Random,
    states: Vec<State>,
    labels: usize,
}

impl Maker<'_> {
    fn grow(&mut self, parent: Option<usize>, kind: Kind, depth: usize) -> usize {
        let number = self.states.len();
        let (children, initial, transitions) = (vec![], vec![], vec![]);
        self.states.push(State { kind, parent, children, initial, entry: vec![], exit: vec![], transitions });
        let count = match kind {
            Kind::Compound => 1 + self.random.below(3) + usize::from(depth == 0),
            Kind::Parallel => 2,
            Kind::Atomic | Kind::Final | Kind::History { .. } => return number,
        };
        let mut children = Vec::new();
        for _ in 0..count {
            let kind = match self.random.below(if depth < 3 { 7 } else { 1 }) {
                1..=3 => Kind::Compound,
                // A parallel state directly in a parallel state completes without an event of its own in the algorithm.
                4 if kind != Kind::Parallel => Kind::Parallel,
                _ => Kind::Atomic,
            };
            children.push(self.grow(Some(number), kind, depth + 1));
        }
        if kind == Kind::Compound && self.random.one_in(3) {
            children.push(self.grow(Some(number), Kind::Final, depth + 1));
        }
        if depth > 0 && self.random.one_in(3) {
            let deep = self.random.one_in(2);
            let history = self.grow(Some(number), Kind::History { deep }, depth + 1);
            let first = children[self.random.below(children.len())];
            self.states[history].initial = vec![if deep { self.inner(first) } else { first }];
            children.push(history);
        }
        self.states[number].children = children;
        number
    }

    /// A state that is this one or inside it.
    fn inner(&mut self, state: usize) -> usize {
        let inside = self.states[state].children.iter().copied();
        let inside: Vec<usize> =
            inside.filter(|child| !matches!(self.states[*child].kind, Kind::History { .. })).collect();
        if inside.is_empty() || self.random.one_in(2) {
            return state;
        }
        let child = inside[self.random.below(inside.len())];
        self.inner(child)
    }

    fn is_inside(&self, state: usize, around: usize) -> bool {
        std::iter::successors(self.states[state].parent, |state| self.states[*state].parent).any(|one| one == around)
    }

    /// One state, or one in each of two regions.
    fn targets(&mut self, around: usize) -> Vec<usize> {
        let count = self.states.len();
        let inside: Vec<usize> = (1..count).filter(|state| self.is_inside(*state, around)).collect();
        let target = inside[self.random.below(inside.len())];
        let children = self.states[target].children.clone();
        if self.states[target].kind == Kind::Parallel && self.random.one_in(2) {
            return vec![self.inner(children[0]), self.inner(children[1])];
        }
        vec![target]
    }

    fn fill(&mut self, state: usize) {
        let kind = self.states[state].kind;
        if kind == Kind::Compound && self.random.one_in(3) {
            let targets = self.targets(state);
            let is_history = |target: &usize| matches!(self.states[*target].kind, Kind::History { .. });
            let is_near = targets.iter().any(is_history);
            if !is_near {
                self.states[state].initial = targets;
            }
        }
        if state == 0 || matches!(kind, Kind::History { .. }) {
            return;
        }
        self.states[state].entry = self.acts(&format!("enter {state}"));
        self.states[state].exit = self.acts(&format!("exit {state}"));
        if kind != Kind::Final {
            let count = self.random.below(4);
            self.states[state].transitions = (0..count).map(|_| self.transition(state)).collect();
        }
    }

    fn transition(&mut self, source: usize) -> Transition {
        let has_children = !self.states[source].children.is_empty();
        let is_internal = has_children && self.random.one_in(2);
        let targets = match (self.random.below(5), is_internal) {
            (0, _) => Vec::new(),
            (_, true) => self.targets(source),
            (_, false) => self.targets(0),
        };
        let events = match self.random.below(8) {
            0 => Vec::new(),
            1 => vec![self.token(), self.token()],
            2 => vec![format!("t{}", self.random.below(2))],
            3 => vec![format!("done.state.s{}", 1 + self.random.below(self.states.len() - 1))],
            _ => vec![self.token()],
        };
        let condition = match self.random.below(if events.is_empty() { 4 } else { 11 }) {
            0 => Some(Condition::Below(1 + self.random.below(4) as i64)),
            1 => Some(Condition::In(self.any_state())),
            2 => Some(Condition::NotIn(self.any_state())),
            3 => Some(Condition::Foreign),
            _ => None,
        };
        self.labels += 1;
        let acts = self.acts(&format!("take {}", self.labels));
        Transition { source, events, condition, targets, is_internal, acts }
    }

    fn token(&mut self) -> String {
        self.random.pick(&TOKENS).to_owned()
    }

    fn any_state(&mut self) -> usize {
        let states: Vec<usize> =
            (1..self.states.len()).filter(|state| !matches!(self.states[*state].kind, Kind::History { .. })).collect();
        states[self.random.below(states.len())]
    }

    fn acts(&mut self, label: &str) -> Vec<Act> {
        let mut acts = vec![Act::Log(label.to_owned())];
        let count = if self.random.one_in(2) { 1 + self.random.below(2) } else { 0 };
        for _ in 0..count {
            let event = self.random.below(2);
            let id = if self.random.one_in(4) { 2 } else { event };
            acts.push(match self.random.below(6) {
                0 | 1 => Act::Raise(self.random.pick(&INSIDE).to_owned()),
                2 => Act::Count,
                3 => Act::Reset,
                4 => Act::Cancel(id),
                _ => {
                    let milliseconds = 1_009 + 700 * event as u64 + 91 * self.random.below(2) as u64;
                    Act::Send { event, milliseconds, id }
                }
            });
        }
        acts
    }
}

fn acts_xml(acts: &[Act]) -> String {
    let act = |act: &Act| match act {
        Act::Log(label) => format!("<log expr=\"'{label}'\"/>"),
        Act::Raise(event) => format!("<raise event=\"{event}\"/>"),
        Act::Count => "<assign location=\"count\" expr=\"count + 1\"/>".to_owned(),
        Act::Reset => "<assign location=\"count\" expr=\"0\"/>".to_owned(),
        Act::Send { event, milliseconds, id } => {
            format!("<send event=\"t{event}\" delay=\"{milliseconds}ms\" id=\"i{id}\"/>")
        }
        Act::Cancel(id) => format!("<cancel sendid=\"i{id}\"/>"),
    };
    acts.iter().map(act).collect()
}

fn ids(states: &[usize]) -> String {
    states.iter().map(|state| format!("s{state}")).collect::<Vec<_>>().join(" ")
}

fn transition_xml(transition: &Transition) -> String {
    let mut text = "<transition".to_owned();
    let mut add = |name: &str, value: String| {
        if !value.is_empty() {
            write!(text, " {name}=\"{value}\"").expect("it is a text");
        }
    };
    add("event", transition.events.join(" "));
    add(
        "cond",
        match transition.condition {
            None => String::new(),
            Some(Condition::Below(limit)) => format!("count &lt; {limit}"),
            Some(Condition::In(state)) => format!("In('s{state}')"),
            Some(Condition::NotIn(state)) => format!("!In('s{state}')"),
            Some(Condition::Foreign) => "Math.max(1, 2) == 2".to_owned(),
        },
    );
    add("target", ids(&transition.targets));
    add("type", if transition.is_internal { "internal".to_owned() } else { String::new() });
    format!("{text}>{}</transition>\n", acts_xml(&transition.acts))
}

fn state_xml(chart: &[State], number: usize) -> String {
    let state = &chart[number];
    let first = ids(&state.initial);
    let tag = match state.kind {
        Kind::Atomic | Kind::Compound => "state",
        Kind::Parallel => "parallel",
        Kind::Final => "final",
        Kind::History { deep } => {
            let kind = if deep { "deep" } else { "shallow" };
            return format!("<history id=\"s{number}\" type=\"{kind}\"><transition target=\"{first}\"/></history>\n");
        }
    };
    let initial = if first.is_empty() { String::new() } else { format!(" initial=\"{first}\"") };
    let inside: String = state.children.iter().map(|child| state_xml(chart, *child)).collect();
    let transitions: String = state.transitions.iter().map(transition_xml).collect();
    format!(
        "<{tag} id=\"s{number}\"{initial}>\n<onentry>{}</onentry><onexit>{}</onexit>\n{transitions}{inside}</{tag}>\n",
        acts_xml(&state.entry),
        acts_xml(&state.exit)
    )
}

/// The text of a chart.
pub(super) fn xml(chart: &[State]) -> String {
    let first = ids(&chart[0].initial);
    let initial = if first.is_empty() { String::new() } else { format!(" initial=\"{first}\"") };
    let inside: String = chart[0].children.iter().map(|child| state_xml(chart, *child)).collect();
    format!("<scxml{initial}>\n<datamodel><data id=\"count\" expr=\"0\"/></datamodel>\n{inside}</scxml>")
}
