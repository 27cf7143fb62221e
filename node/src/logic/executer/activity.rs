//! The reports of an activity to people: its states, its lines, the values that it sends, the messages that it loses. And the
//! messages that it gets.

use super::{ExecContext, Executer};
use crate::logic::effect::Out;
use crate::logic::printable::printable;
use crate::logic::protocol::{ActivityInput, Change, Ending, Target, ToCoordinator};
use language::algebra::Command;
use language::plan::{Expression, Plan, StateChart};

/// The longest text of an activity that people are told of, in bytes.
const TEXT_MAX: usize = 512;
/// The most states that are named in one line.
const STATES_MAX: usize = 16;

impl Executer {
    /// Returns the states that an activity is in, for a person; none if the group is not an activity, or does not run.
    pub fn states(&self) -> Option<String> {
        let names = self.states_seen()?;
        (!names.is_empty()).then(|| format!("in {}", names.join(", ")))
    }

    /// An activity gets a message or a notice. Returns how it ended by that, if it did. An activity that does not run, or
    /// does not wait for such a thing, drops it.
    pub fn tell(&mut self, told: &ActivityInput, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        let chart = chart(context.plan, self.group).filter(|_| self.running)?;
        let event = match told {
            ActivityInput::Message { port, text, priority } => chart.message(port, text, *priority),
            ActivityInput::Notice(notice) => chart.notice(notice),
        };
        self.react(event?, context, out)
    }

    /// The names of the active states without active inner states. While a transition waits for a stop, there are none.
    pub(super) fn states_seen(&self) -> Option<Vec<String>> {
        let (automaton, place) = (self.program.automaton()?, self.state.chart()?);
        if place.is_waiting() {
            return None;
        }
        let name = |state: usize| automaton.chart().states.get(state).map(|state| state.name.clone());
        Some(place.leaves(automaton).take(STATES_MAX).filter_map(name).collect())
    }

    /// Tells the people who watch in which states the activity is, if these are not those of `before`.
    pub(super) fn tell_states(&self, before: Option<Vec<String>>, context: ExecContext<'_>, out: &mut Out<'_>) {
        let states = self.states_seen();
        if states == before {
            return;
        }
        if let Some(names) = states.filter(|names| !names.is_empty()) {
            self.tell_people(format!("is in {}", names.join(", ")), context, out);
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
        self.tell_people(text, context, out);
    }

    fn tell_people(&self, text: String, context: ExecContext<'_>, out: &mut Out<'_>) {
        let end = (0..=text.len().min(TEXT_MAX)).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        let change = Change::Says { text: printable(text.get(..end).unwrap_or("")) };
        let target = Target::Group(self.group);
        out.send(context.home, context.deployment.to_coordinator(ToCoordinator::Happened { target, change }));
    }
}

/// The chart of a group that is an activity.
fn chart(plan: &Plan, group: u32) -> Option<&StateChart> {
    let expression = &plan.groups.get(group as usize)?.expression;
    if let Expression::Chart(chart) = expression { Some(chart) } else { None }
}
