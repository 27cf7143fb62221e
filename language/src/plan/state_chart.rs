//! The event actions of an activity: a chart whose states run expressions.

use super::{Expression, PlanError};
use crate::algebra::{Event, Value};
use crate::automaton::{
    Automaton, Chart, ChartState, Configuration, Relation, StateKind, Target, Transition, Trigger, ValueSource,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// The most ports, filters, signals and notices of an activity.
const NAMES_MAX: usize = 1_000;
/// The longest line or text that an activity holds, in bytes.
const TEXT_MAX: usize = 64 * 1024;

/// The states of an activity, and the expressions that they run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StateChart {
    /// The states and transitions.
    pub chart: Chart,
    /// The runs of the states, in document order.
    pub runs: Vec<StateRun>,
    /// The names of the input ports; the numbers of ports in the chart point here.
    pub inputs: Vec<String>,
    /// The names of the output ports.
    pub outputs: Vec<String>,
    /// The filters of messages; the numbers of filters in the chart point here.
    pub filters: Vec<Filter>,
    /// The notices of the surroundings; the numbers of notices in the chart point here.
    pub notices: Vec<Notice>,
    /// The questions to people; the numbers of questions in notices point here.
    pub questions: Vec<Question>,
    /// The names of the signals.
    pub signals: Vec<String>,
}

/// A question to people: a state in which the activity waits for an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Question {
    /// The number of the state.
    pub state: u32,
    /// The question.
    pub text: String,
    /// The answers.
    pub options: Vec<String>,
    /// The answer that is used after a time. None if the activity waits for ever.
    pub default: Option<DefaultAnswer>,
}

/// The answer that is used if no answer was given in time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DefaultAnswer {
    /// The answer.
    pub option: String,
    /// How long people have.
    pub after: Duration,
}

/// As a person reads it: the text, and the answers.
impl std::fmt::Display for Question {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}", self.text, self.options.join(", "))?;
        match &self.default {
            Some(DefaultAnswer { option, after }) => write!(f, "; {option} after {} s)", after.as_secs_f64()),
            None => f.write_str(")"),
        }
    }
}

/// The run of one state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StateRun {
    /// The number of the state.
    pub state: u32,
    /// The expression.
    pub expression: Expression,
}

/// Something that the surroundings of an activity may notice.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Notice {
    /// A person asks the activity to suspend.
    Suspend,
    /// A person asks the activity to continue.
    Resume,
    /// A host is lost.
    HostLost(String),
    /// A host cannot be reached, and may return.
    LinkLost(String),
    /// A parameter of a member has another value.
    ParameterChanged {
        /// The name of the member.
        member: String,
        /// The name of the parameter.
        parameter: String,
    },
    /// A person answers a question.
    Answer {
        /// The number of the question.
        question: u32,
        /// The answer.
        option: String,
    },
    /// The member of this name is done.
    Done(String),
    /// The member of this name has aborted.
    Aborted(String),
}

impl Notice {
    /// The member whose end it is, and whether that is a normal end.
    pub(crate) fn end_of(&self) -> Option<(&str, bool)> {
        match self {
            Self::Done(member) => Some((member, true)),
            Self::Aborted(member) => Some((member, false)),
            Self::Suspend
            | Self::Resume
            | Self::HostLost(_)
            | Self::LinkLost(_)
            | Self::ParameterChanged { .. }
            | Self::Answer { .. } => None,
        }
    }
}

/// As a spec writes it.
impl std::fmt::Display for Notice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Suspend => f.write_str("suspend"),
            Self::Resume => f.write_str("resume"),
            Self::HostLost(host) => write!(f, "host {host} lost"),
            Self::LinkLost(host) => write!(f, "link {host} lost"),
            Self::ParameterChanged { member, parameter } => write!(f, "parameter {member}.{parameter} changed"),
            Self::Answer { option, .. } => write!(f, "answer {option}"),
            Self::Done(member) => write!(f, "{member}.done"),
            Self::Aborted(member) => write!(f, "{member}.aborted"),
        }
    }
}

/// A condition on a message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Filter {
    /// The text of the message is equal to this text, or differs from it.
    Text {
        /// The text.
        text: String,
        /// Whether it has to be this one.
        is_equal: bool,
    },
    /// The priority of the message has this relation to a number.
    Priority {
        /// The relation.
        relation: Relation,
        /// The number.
        number: u8,
        /// Whether the relation must not hold.
        is_negated: bool,
    },
    /// All of these hold.
    All(Vec<FilterPart>),
    /// At least one of these holds.
    Any(Vec<FilterPart>),
}

/// A condition on a message that is a part of another one.
pub type FilterPart = Box<Filter>;

impl Filter {
    /// The texts that it compares with, and the priorities at which it changes.
    fn bounds(&self, texts: &mut Vec<String>, priorities: &mut BTreeSet<u8>) {
        match self {
            Self::Text { text, .. } => {
                if !texts.contains(text) && texts.len() < NAMES_MAX {
                    texts.push(text.clone());
                }
            }
            Self::Priority { number, .. } => {
                priorities.extend([number.saturating_sub(1), *number, number.saturating_add(1)]);
            }
            Self::All(parts) | Self::Any(parts) => parts.iter().for_each(|part| part.bounds(texts, priorities)),
        }
    }

    /// Returns whether a message with this text and priority is let through.
    pub fn lets_through(&self, text: &str, priority: u8) -> bool {
        match self {
            Self::Text { text: wanted, is_equal } => (text == wanted) == *is_equal,
            Self::Priority { relation, number, is_negated } => {
                let holds = match relation {
                    Relation::Equal => priority == *number,
                    Relation::Less => priority < *number,
                    Relation::AtMost => priority <= *number,
                };
                holds != *is_negated
            }
            Self::All(parts) => parts.iter().all(|part| part.lets_through(text, priority)),
            Self::Any(parts) => parts.iter().any(|part| part.lets_through(text, priority)),
        }
    }
}

impl StateChart {
    /// Returns the message event of a text at a port; none if no port has this name.
    pub fn message(&self, port: &str, text: &str, priority: u8) -> Option<Event> {
        let port = self.inputs.iter().position(|name| name == port)?;
        self.message_at(u32::try_from(port).ok()?, text, priority)
    }

    /// Returns the message event of a text at the port of a number.
    pub fn message_at(&self, port: u32, text: &str, priority: u8) -> Option<Event> {
        self.value_at(port, text_value(text), priority)
    }

    /// Returns the message event of a value at the port with this number. If the value is a text, filters see this text.
    pub fn value_at(&self, port: u32, value: Value, priority: u8) -> Option<Event> {
        self.inputs.get(port as usize)?;
        let (numbers, text) = (0_u32.., value.text().unwrap_or_default());
        let passed = numbers.zip(&self.filters).filter(|(_, filter)| filter.lets_through(text, priority));
        let filters = passed.map(|(number, _)| number).collect();
        Some(Event::Message { port, filters, priority, value })
    }

    /// Returns the event of a notice; none if no transition waits for it.
    pub fn notice(&self, notice: &Notice) -> Option<Event> {
        let number = self.notices.iter().position(|known| known == notice)?;
        Some(Event::Notice(u32::try_from(number).ok()?))
    }

    /// Returns the questions that are open in a configuration, each with its number.
    pub fn open_questions<'c>(&'c self, place: &'c Configuration) -> impl Iterator<Item = (u32, &'c Question)> {
        let is_open = |(_, question): &(u32, &Question)| place.is_active(question.state as usize);
        (0_u32..).zip(&self.questions).filter(is_open)
    }

    /// Returns the numbers of the notices that come from outside of the activity: all but the ends of its members.
    pub fn notices_from_outside(&self) -> Vec<u32> {
        let is_outside = |(_, notice): &(u32, &Notice)| notice.end_of().is_none();
        (0_u32..).zip(&self.notices).filter(is_outside).map(|(number, _)| number).collect()
    }

    /// Returns messages that the activity tells apart, for one who lets all of them come: each with its port, its text and its
    /// priority.
    pub fn messages(&self) -> Vec<(u32, String, u8)> {
        let (mut texts, mut priorities) = (vec![String::new()], BTreeSet::from([0]));
        self.filters.iter().for_each(|filter| filter.bounds(&mut texts, &mut priorities));
        let mut seen = BTreeSet::new();
        let mut all = Vec::new();
        for port in 0..self.inputs.len() {
            let own: Vec<usize> = self.filters_of(port);
            for text in &texts {
                for &priority in &priorities {
                    let passed =
                        own.iter().copied().filter(|&filter| self.filters[filter].lets_through(text, priority));
                    if self.is_heard(port) && seen.insert((port, passed.collect::<Vec<_>>())) && all.len() < NAMES_MAX {
                        all.push((u32::try_from(port).unwrap_or(u32::MAX), text.clone(), priority));
                    }
                }
            }
        }
        all
    }

    /// Returns everything from outside that the activity tells apart: [`Self::messages`], then its notices.
    pub fn heard(&self) -> Vec<Event> {
        let messages = self.messages().into_iter();
        let messages = messages.filter_map(|(port, text, priority)| self.message_at(port, &text, priority));
        messages.chain(self.notices_from_outside().into_iter().map(Event::Notice)).collect()
    }

    /// The filters that a transition at a port has.
    fn filters_of(&self, port: usize) -> Vec<usize> {
        let filter = |transition: &Transition| {
            let Trigger::Message { port: other, filter } = &transition.trigger else { return None };
            filter.filter(|_| *other == port)
        };
        let filters: BTreeSet<usize> = self.chart.transitions.iter().filter_map(filter).collect();
        filters.into_iter().filter(|&filter| filter < self.filters.len()).collect()
    }

    /// Whether a transition waits for messages of a port.
    fn is_heard(&self, port: usize) -> bool {
        self.chart.transitions.iter().any(|transition| {
            let is_here = matches!(&transition.trigger, Trigger::Message { port: other, .. } if *other == port);
            is_here || transition.trigger == Trigger::Any
        })
    }

    /// Returns the tags of its outcomes, in the order of the text.
    pub fn outcomes(&self) -> impl Iterator<Item = &str> {
        self.chart.transitions.iter().filter_map(|transition| match &transition.target {
            Target::Done(ValueSource::Tagged { tag, .. }) => Some(tag.as_str()),
            Target::Done(_) | Target::Stay | Target::States(_) | Target::Resume | Target::Abort(_) => None,
        })
    }

    /// Returns whether the activity is done when its states inside are done.
    pub(crate) fn completes(&self) -> bool {
        can_complete(&self.chart.states, 0)
    }

    /// Returns whether no way leads to a normal end of the activity.
    pub fn is_service(&self) -> bool {
        let is_done = self.chart.transitions.iter().any(|transition| matches!(transition.target, Target::Done(_)));
        !is_done && !self.completes()
    }

    /// Checks that all numbers point to something, and that the chart is an automaton.
    pub(super) fn check(&self, group: &str) -> Result<(), PlanError> {
        let wrong = |why: String| PlanError::Chart { group: group.to_owned(), why };
        Automaton::new(self.chart.clone()).map_err(|error| wrong(error.to_string()))?;
        let running = |(number, state): (u32, &ChartState)| state.run.as_ref().map(|_| number);
        let states: Vec<u32> = (0_u32..).zip(&self.chart.states).filter_map(running).collect();
        if !self.runs.iter().map(|run| run.state).eq(states) {
            return Err(wrong("the runs differ from the runs of the states".to_owned()));
        }
        if self.inputs.len() != self.chart.ports.len() {
            return Err(wrong("the input ports differ from the ports of the chart".to_owned()));
        }
        let counts = [&self.inputs, &self.outputs, &self.signals].map(Vec::len);
        if counts
            .into_iter()
            .chain([self.filters.len(), self.notices.len(), self.questions.len()])
            .any(|count| count > NAMES_MAX)
        {
            return Err(wrong(format!("more than {NAMES_MAX} ports, filters, signals or notices")));
        }
        let is_known = |trigger: &Trigger| match trigger {
            Trigger::Message { filter, .. } => filter.is_none_or(|filter| filter < self.filters.len()),
            Trigger::Signal(signal) => *signal < self.signals.len(),
            Trigger::Notice(notice) => *notice < self.notices.len(),
            Trigger::Always
            | Trigger::Any
            | Trigger::Done(_)
            | Trigger::Aborted(_)
            | Trigger::Complete
            | Trigger::After(_)
            | Trigger::Every(_) => true,
        };
        let transitions = &self.chart.transitions;
        if self.questions.iter().any(|question| question.state as usize >= self.chart.states.len()) {
            return Err(wrong("a question belongs to a state that does not exist".to_owned()));
        }
        match transitions.iter().position(|transition| !is_known(&transition.trigger)) {
            Some(number) => Err(wrong(format!("transition {number} waits for something that does not exist"))),
            None => Ok(()),
        }
    }
}

/// The bytes of a text, as a program reads its value.
pub fn text_value(text: &str) -> Value {
    let end = text.floor_char_boundary(TEXT_MAX);
    let mut bytes = Vec::with_capacity(end + 3);
    let mut length = end;
    // The length, seven bits a byte, the least significant first.
    while length >= 0x80 {
        bytes.push((length & 0x7f | 0x80).to_le_bytes()[0]);
        length >>= 7;
    }
    bytes.push(length.to_le_bytes()[0]);
    bytes.extend_from_slice(&text.as_bytes()[..end]);
    Value::new(&bytes)
}

fn can_complete(states: &[ChartState], state: usize) -> bool {
    let mut inner = (0..states.len()).filter(|&other| states[other].parent == Some(state));
    match states.get(state).map(|state| &state.kind) {
        Some(StateKind::Compound { .. }) => inner.any(|child| states[child].kind == StateKind::Final),
        Some(StateKind::Parallel) => inner.all(|region| can_complete(states, region)),
        Some(StateKind::Atomic | StateKind::Final | StateKind::Suspended | StateKind::History { .. }) | None => false,
    }
}
