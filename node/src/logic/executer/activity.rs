//! The reports of an activity to people: its states, its questions, its lines, the values that it sends, the messages that it
//! loses. And the messages and orders that it gets.

use super::ports::{PortLine, Sending};
use super::{ExecContext, Executer};
use crate::logic::effect::Out;
use crate::logic::printable::printable;
use crate::logic::protocol::{
    ActivityInput, ActivityStatus, Change, Ending, OpenQuestion, Taken, Target, ToCoordinator,
};
use comms::logic::control::{MessageFate, PortMessage};
use language::algebra::{Command, Event, StepRecord, Value};
use language::automaton::{Configuration, Trigger};
use language::plan::{DefaultAnswer, Expression, Notice, Plan, Question, StateChart};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The longest text of an activity that is shown to people, in bytes.
const TEXT_MAX: usize = 512;
/// The most states that are named in one line.
const STATES_MAX: usize = 16;

/// The news of a supervisor for its home: steps that are not recorded yet, and questions of an activity.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct News {
    /// How many steps were recorded.
    pub(super) recorded: u64,
    /// The steps since then.
    pub(super) steps: Vec<StepRecord>,
    /// How often the event actions were changed before these steps.
    pub(super) changes: u32,
    /// How many questions were asked.
    asked: u64,
    /// The open questions, by their places in the chart.
    open: BTreeMap<u32, Asked>,
    /// The last answer that was taken.
    answered: Option<Answered>,
}

/// An accepted answer. Another person who answers the same question is told about this answer.
#[derive(Debug, Serialize, Deserialize)]
struct Answered {
    number: u64,
    option: String,
    by: String,
}

/// A question that is open.
#[derive(Debug, Serialize, Deserialize)]
struct Asked {
    number: u64,
    question: Question,
    /// Whether an answer was taken, or its time is over. While the activity waits for a stop, its state may still be active.
    is_over: bool,
}

/// The links of a supervisor with the world outside of its group.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Outside {
    /// For its home.
    pub(super) news: News,
    /// To the program that has the ports, if the group is an activity with connections.
    pub(super) ports: PortLine,
}

/// The result of an order for an activity.
#[derive(Debug)]
pub struct Taking {
    /// How this has ended the activity. None if the activity continues.
    pub ending: Option<Ending>,
    /// The reaction of the activity, or why the activity has not taken the order.
    pub taken: Result<Taken, String>,
}

/// Where an activity was before an event.
pub(super) type Seen = Option<Vec<String>>;

impl Executer {
    /// Returns the states that an activity is in, for a person; none if the group is not an activity, or does not run.
    pub fn states(&self) -> Option<String> {
        if self.run.is_on && self.state.chart().is_some_and(Configuration::is_waiting) {
            return Some("between two states".to_owned());
        }
        let names = self.states_seen()?;
        (!names.is_empty()).then(|| format!("in {}", names.join(", ")))
    }

    /// Returns the states, the open questions and the possible orders of an activity; none if the group is not an activity, or
    /// does not run.
    pub fn activity(&self, plan: &Plan) -> Option<ActivityStatus> {
        let (chart, place) = (chart(plan, self.group)?, self.state.chart().filter(|_| self.run.is_on)?);
        let question = |Asked { number, question, .. }: &Asked| OpenQuestion {
            number: *number,
            text: question.to_string(),
            options: question.options.clone(),
        };
        let questions = self.outside.news.open.values().filter(|asked| !asked.is_over).map(question).collect();
        Some(ActivityStatus { states: self.states_seen().unwrap_or_default(), questions, orders: orders(chart, place) })
    }

    /// An activity gets a message, a notice or an answer, perhaps of a person. Answers and notices are shown to people.
    pub fn tell_by(
        &mut self,
        told: &ActivityInput,
        by: Option<&str>,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> Taking {
        let by = by.map_or_else(|| "a node".to_owned(), printable);
        match self.event_of(told, context.plan) {
            Err(why) => {
                if let ActivityInput::Answer { question, option } = told {
                    let text =
                        format!("does not take the answer `{option}` of {by} to question {question}: it is not open");
                    self.tell_people(text, context, out);
                }
                Taking { ending: None, taken: Err(why) }
            }
            Ok(event) => {
                if let ActivityInput::Answer { question, option } = told {
                    self.tell_people(
                        format!("gets the answer `{option}` of {by} to question {question}"),
                        context,
                        out,
                    );
                    let (number, option) = (*question, option.clone());
                    let news = &mut self.outside.news;
                    news.answered = Some(Answered { number, option, by });
                    news.open
                        .values_mut()
                        .filter(|asked| asked.number == number)
                        .for_each(|asked| asked.is_over = true);
                } else if let ActivityInput::Notice(notice @ (Notice::Suspend | Notice::Resume)) = told {
                    self.tell_people(format!("gets the order of {by}: {notice}"), context, out);
                }
                self.take(event, context, out)
            }
        }
    }

    /// An activity gets a notice. Returns how this has ended the activity. None if the activity continues. An activity drops the
    /// input if it does not run, or does not wait for such an input.
    pub fn tell(&mut self, told: &ActivityInput, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        let event = self.event_of(told, context.plan).ok()?;
        self.react(event, context, out)
    }

    /// Returns the event of an order for the activity, or the reason why the activity cannot take the order.
    fn event_of(&self, told: &ActivityInput, plan: &Plan) -> Result<Event, String> {
        let path = plan.groups.get(self.group as usize).map_or("", |group| group.path.as_str());
        let idle = || format!("`{path}` is not active");
        let (chart, place) =
            chart(plan, self.group).zip(self.state.chart()).filter(|_| self.run.is_on).ok_or_else(idle)?;
        match told {
            ActivityInput::Message { port, text, priority } => {
                let event = chart.message(port, text, *priority);
                let event = event.ok_or_else(|| format!("`{path}` has no input port `{port}`"))?;
                if let (Event::Message { port: number, .. }, Some(automaton)) = (&event, self.program.automaton())
                    && place.has_no_room(automaton, *number as usize, *priority)
                {
                    return Err(format!("too many messages wait at `{port}` of `{path}`"));
                }
                Ok(event)
            }
            ActivityInput::Notice(notice) => {
                chart.notice(notice).ok_or_else(|| format!("`{path}` has no transition `on {notice}`"))
            }
            ActivityInput::Answer { question, option } => {
                let is_meant = |asked: &Asked| asked.number == *question && !asked.is_over;
                let open = self.outside.news.open.iter().find(|(_, asked)| is_meant(asked)).map(|(place, _)| *place);
                let notice = open.map(|question| Notice::Answer { question, option: option.clone() });
                let event = notice.and_then(|notice| chart.notice(&notice));
                event.ok_or_else(|| {
                    let answered = self.outside.news.answered.as_ref().filter(|one| one.number == *question);
                    let why = answered.map(|one| format!(": the answer `{}` of {} was taken", one.option, one.by));
                    format!("question {question} of `{path}` is not open{}", why.unwrap_or_default())
                })
            }
        }
    }

    /// Takes an order of a person.
    fn take(&mut self, event: Event, context: ExecContext<'_>, out: &mut Out<'_>) -> Taking {
        let place = self.program.automaton().zip(self.state.chart());
        let takes = |(automaton, place): (_, &Configuration)| {
            event.clone().told().is_some_and(|told| place.takes(automaton, told))
        };
        let taken = match place {
            Some((_, place)) if place.is_waiting() => Taken::Waits,
            place if place.is_some_and(takes) => Taken::Reacted,
            _ => Taken::Ignored,
        };
        Taking { ending: self.react(event, context, out), taken: Ok(taken) }
    }

    /// Takes a message for a port. Returns how this has ended the activity. None if the activity continues.
    pub fn take_message(
        &mut self,
        message: PortMessage,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> (MessageFate, Option<Ending>) {
        let PortMessage { port, value, priority, has_receipt, lost, .. } = message;
        if lost > 0 {
            let text = format!("loses {lost} values at `{port}`: its queue was full, or the values could not be read");
            self.tell_of_work(text, context, out);
        }
        let place = self.program.automaton().zip(self.state.chart()).filter(|_| self.run.is_on);
        let event = chart(context.plan, self.group).and_then(|chart| {
            let number = chart.inputs.iter().position(|name| *name == port)?;
            chart.value_at(u32::try_from(number).ok()?, Value::new(&value), priority)
        });
        let (Some((automaton, place)), Some(event)) = (place, event) else { return (MessageFate::Idle, None) };
        if let Event::Message { port, .. } = &event
            && has_receipt
            && place.has_no_room(automaton, *port as usize, priority)
        {
            return (MessageFate::Full, None);
        }
        (MessageFate::Taken, self.react(event, context, out))
    }

    /// Returns the values that the program that has the ports is to send now.
    pub fn take_sendings(&mut self) -> Vec<Sending> {
        self.outside.ports.take()
    }

    /// Takes note that a value was sent.
    pub fn value_sent(&mut self, number: u64) {
        self.outside.ports.sent(number);
    }

    /// Takes note that a value cannot be sent.
    pub fn not_sent(&self, port: &str, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.tell_of_work(
            format!("loses a value at `{port}`: the program of its ports does not take it"),
            context,
            out,
        );
    }

    /// Takes note that the program that has the ports is gone, with the values that it had to send.
    pub fn ports_lost(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let count = self.outside.ports.lost();
        if count > 0 {
            let text = format!("may have lost {count} values that it was sending: the program of its ports is gone");
            self.tell_people(text, context, out);
        }
    }

    /// Has a value sent, if its output leads somewhere.
    pub(super) fn send(&mut self, output: u32, value: &Value, context: ExecContext<'_>, out: &mut Out<'_>) {
        let plan = context.plan;
        let port = chart(plan, self.group).and_then(|chart| chart.outputs.get(output as usize));
        let Some(((_, leaf), port)) = plan.ports_of(self.group).zip(port) else { return };
        let leads = plan.wires.iter().any(|wire| wire.from.leaf == leaf && wire.from.port == *port);
        if leads && !self.outside.ports.send(port, value.bytes()) {
            self.not_sent(port, context, out);
        }
    }

    /// The names of the active states without active inner states. While a transition waits for a stop, there are none.
    pub(super) fn states_seen(&self) -> Seen {
        let (automaton, place) = (self.program.automaton()?, self.state.chart()?);
        if place.is_waiting() {
            return None;
        }
        let name = |state: usize| automaton.chart().states.get(state).map(|state| state.name.clone());
        Some(place.leaves(automaton).take(STATES_MAX).filter_map(name).collect())
    }

    /// Tells the people who watch the present states of the activity, if these differ from
    /// `before`. Also tells them the questions that the activity asks and withdraws.
    pub(super) fn tell_states(&mut self, before: Seen, event: &Event, context: ExecContext<'_>, out: &mut Out<'_>) {
        let states = self.states_seen();
        if states != before
            && let Some(names) = states.filter(|names| !names.is_empty())
        {
            self.announce(Change::Entered { states: names }, context, out);
        }
        let Some(chart) = chart(context.plan, self.group).filter(|chart| !chart.questions.is_empty()) else { return };
        self.end_of_time(event, context, out);
        for Asked { number, is_over, .. } in self.close_questions(chart) {
            if !is_over {
                self.tell_people(format!("closes question {number}: it is withdrawn"), context, out);
            }
        }
        self.ask_questions(chart, context, out);
    }

    /// If the event is the end of the time for a question, notes this and tells it to people.
    fn end_of_time(&mut self, event: &Event, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(timed) = self.program.timed_state(event) else { return };
        let open = self.outside.news.open.values_mut();
        let is_meant = |asked: &&mut Asked| !asked.is_over && asked.question.state as usize == timed;
        let Some(Asked { number, question, is_over }) = open.into_iter().find(is_meant) else { return };
        let Some(DefaultAnswer { option, .. }) = &question.default else { return };
        *is_over = true;
        let text = format!("closes question {number}: no answer came in time, so it is `{option}`");
        self.tell_people(text, context, out);
    }

    /// Takes note of the questions of a changed chart. A question that reads as before keeps its number.
    pub(super) fn renew_questions(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(chart) = chart(context.plan, self.group) else { return };
        let open = &mut self.outside.news.open;
        let mut gone = Vec::new();
        for Asked { number, question, is_over } in std::mem::take(open).into_values() {
            let reads_so = |(place, other): &(u32, &Question)| {
                !open.contains_key(place) && (&other.text, &other.options) == (&question.text, &question.options)
            };
            match (0..).zip(&chart.questions).find(reads_so) {
                Some((place, other)) => drop(open.insert(place, Asked { number, question: other.clone(), is_over })),
                None => gone.push(number),
            }
        }
        gone.extend(self.close_questions(chart).into_iter().map(|asked| asked.number));
        for number in gone {
            self.tell_people(format!("closes question {number}: the activity has changed"), context, out);
        }
        self.ask_questions(chart, context, out);
    }

    /// Returns the places of the questions that are open now.
    fn open_questions(&self, chart: &StateChart) -> BTreeSet<u32> {
        let place = self.state.chart().filter(|_| self.run.is_on);
        place.into_iter().flat_map(|place| chart.open_questions(place).map(|(number, _)| number)).collect()
    }

    /// Forgets the questions that are not open any more, and returns them. If a question that is over is open again, it is another
    /// question.
    fn close_questions(&mut self, chart: &StateChart) -> Vec<Asked> {
        let open = self.open_questions(chart);
        let is_waiting = self.state.chart().is_some_and(Configuration::is_waiting);
        let is_closed = |place: &u32, asked: &mut Asked| !open.contains(place) || (asked.is_over && !is_waiting);
        self.outside.news.open.extract_if(.., is_closed).map(|(_, asked)| asked).collect()
    }

    /// Gives numbers to the questions without a number, and shows these questions to people.
    fn ask_questions(&mut self, chart: &StateChart, context: ExecContext<'_>, out: &mut Out<'_>) {
        for place in self.open_questions(chart) {
            let news = &mut self.outside.news;
            let Some(question) = chart.questions.get(place as usize).filter(|_| !news.open.contains_key(&place)) else {
                continue;
            };
            news.asked += 1;
            let number = news.asked;
            news.open.insert(place, Asked { number, question: question.clone(), is_over: false });
            self.tell_people(format!("asks, as question {number}: {question}"), context, out);
        }
    }

    /// Tells the people who watch of a command that is seen outside.
    pub(super) fn say(&self, command: &Command, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(chart) = chart(context.plan, self.group) else { return };
        let named = |names: &[String], number: u32| names.get(number as usize).cloned().unwrap_or_default();
        let text = if let Command::Log { text } = command {
            format!("says: {text}")
        } else if let Command::Send { output, value } = command {
            let shown = value.text().map_or_else(|| format!("{} bytes", value.bytes().len()), str::to_owned);
            format!("sends through `{}`: {shown}", named(&chart.outputs, *output))
        } else if let Command::Lost { port } = command {
            format!("loses a message at `{}`: too many wait", named(&chart.inputs, *port))
        } else {
            return;
        };
        self.tell_of_work(text, context, out);
    }

    /// Tells people about something that they should see.
    fn tell_people(&self, text: String, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.announce(says(&text, false), context, out);
    }

    /// Tells people about the usual work of the activity, which may come in floods.
    fn tell_of_work(&self, text: String, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.announce(says(&text, true), context, out);
    }

    fn announce(&self, change: Change, context: ExecContext<'_>, out: &mut Out<'_>) {
        let target = Target::Group(self.group);
        out.send(context.home, context.deployment.to_coordinator(ToCoordinator::Happened { target, change }));
    }
}

fn says(text: &str, is_routine: bool) -> Change {
    Change::Says { text: printable(&text[..text.floor_char_boundary(TEXT_MAX)]), is_routine }
}

/// The chart of a group that is an activity.
fn chart(plan: &Plan, group: u32) -> Option<&StateChart> {
    let expression = &plan.groups.get(group as usize)?.expression;
    if let Expression::Chart(chart) = expression { Some(chart) } else { None }
}

/// The orders that a person may give an activity now, as `dca ctl` takes them.
fn orders(chart: &StateChart, place: &Configuration) -> Vec<String> {
    let mut orders: Vec<String> = Vec::new();
    for transition in chart.chart.transitions.iter().filter(|transition| place.is_active(transition.source)) {
        let order = match &transition.trigger {
            Trigger::Message { port, .. } => chart.inputs.get(*port).map(|port| format!("message {port} TEXT")),
            Trigger::Notice(number) => {
                let notice = chart.notices.get(*number);
                notice.filter(|notice| matches!(notice, Notice::Suspend | Notice::Resume)).map(Notice::to_string)
            }
            Trigger::Always
            | Trigger::Any
            | Trigger::Signal(_)
            | Trigger::Done(_)
            | Trigger::Aborted(_)
            | Trigger::Complete
            | Trigger::After(_)
            | Trigger::Every(_) => None,
        };
        orders.extend(order.filter(|order| !orders.contains(order)));
    }
    orders
}
