//! The visible parts of an activity in a simulation: its states, its lines, and the messages that it sends and loses.

use super::{Simulation, SimulationError, Transition};
use crate::algebra::{Command, Event};
use crate::plan::{Expression, Notice, StateChart};

impl Simulation<'_> {
    /// Sends a message to the running activities with this port: `stop`, or `5 stop` with a priority of 5.
    ///
    /// # Errors
    /// If no running activity has the port.
    pub fn send(&mut self, port: &str, text: &str) -> Result<(), SimulationError> {
        let (first, rest) = text.split_once(' ').unwrap_or((text, ""));
        let (priority, text) = match first.parse() {
            Ok(priority) if !rest.is_empty() => (priority, rest.trim()),
            Ok(_) | Err(_) => (0, text),
        };
        let messages = (0..self.plan.groups.len()).filter(|&group| !self.states[group].is_idle());
        let messages = messages.filter_map(|group| Some((group, self.chart_of(group)?.message(port, text, priority)?)));
        let messages: Vec<(usize, Event)> = messages.collect();
        if messages.is_empty() {
            return Err(SimulationError::Port { name: port.to_owned() });
        }
        self.queue.extend(messages);
        self.react();
        Ok(())
    }

    /// Tells the running activities of an event outside of them: `suspend`, `host c1 lost`. Returns whether any activity waits for it.
    pub(super) fn notify(&mut self, text: &str) -> bool {
        let mut notices: Vec<(usize, Event)> = Vec::new();
        for group in (0..self.plan.groups.len()).filter(|&group| !self.states[group].is_idle()) {
            let Some(chart) = self.chart_of(group) else { continue };
            for number in chart.notices_from_outside() {
                let notice = &chart.notices[number as usize];
                if notice.to_string() == text && self.is_open(group, notice) {
                    notices.push((group, Event::Notice(number)));
                }
            }
        }
        let is_heard = !notices.is_empty();
        self.queue.extend(notices);
        self.react();
        is_heard
    }

    /// Returns whether the notice is possible. An answer needs an open question, and other notices are always possible.
    fn is_open(&self, group: usize, notice: &Notice) -> bool {
        let Notice::Answer { question, .. } = notice else { return true };
        let open = self.chart_of(group).zip(self.states[group].chart());
        open.is_some_and(|(chart, place)| chart.open_questions(place).any(|(number, _)| number == *question))
    }

    /// Gives an activity a message of a story.
    pub(super) fn told(&mut self, path: &str, number: u32) -> Result<(), &'static str> {
        let group = self.plan.groups.iter().position(|group| group.path == path).ok_or("it is not a group")?;
        let chart = self.chart_of(group).ok_or("it is not an activity")?;
        let index = (number as usize).checked_sub(1);
        let event = index.and_then(|index| chart.heard().into_iter().nth(index)).ok_or("it has no such message")?;
        self.queue.push_back((group, event));
        self.react();
        Ok(())
    }

    /// Returns the chart of a group, if the group is an activity.
    pub(super) fn chart_of(&self, group: usize) -> Option<&StateChart> {
        if let Expression::Chart(chart) = &self.plan.groups[group].expression { Some(chart) } else { None }
    }

    /// Notes the states of an activity, unless they are the same as last time.
    pub(super) fn note_states(&mut self, group: usize) {
        let (Some(automaton), Some(place)) = (self.programs[group].automaton(), self.states[group].chart()) else {
            return;
        };
        let name = |state: usize| automaton.chart().states[state].name.as_str();
        let names: Vec<&str> = place.leaves(automaton).map(name).collect();
        if place.is_waiting() || names.is_empty() {
            return;
        }
        let names = names.join(", ");
        if self.record.states.get(&group) != Some(&names) {
            let asked =
                self.chart_of(group).map(|chart| chart.open_questions(place).map(|(_, it)| format!("asks: {it}")));
            let asked: Vec<String> = asked.into_iter().flatten().collect();
            self.note(self.plan.groups[group].path.clone(), Transition::Says(format!("is in `{names}`")));
            for asks in asked {
                self.note(self.plan.groups[group].path.clone(), Transition::Says(asks));
            }
            self.record.states.insert(group, names);
        }
    }

    /// Notes an action of an activity that is visible outside.
    pub(super) fn say(&mut self, group: usize, command: &Command) {
        let Some(chart) = self.chart_of(group) else { return };
        let named = |names: &[String], number: u32| names.get(number as usize).cloned().unwrap_or_default();
        let said = match command {
            Command::Log { text } => format!("says: {text}"),
            Command::Send { output, value } => {
                let shown = value.text().map_or_else(|| format!("{} bytes", value.bytes().len()), str::to_owned);
                format!("sends through `{}`: {shown}", named(&chart.outputs, *output))
            }
            Command::Lost { port } => format!("loses a message at `{}`", named(&chart.inputs, *port)),
            Command::Connect { .. }
            | Command::Disconnect { .. }
            | Command::Activate { .. }
            | Command::Stop { .. }
            | Command::Arm { .. }
            | Command::Cancel { .. } => return,
        };
        self.note(self.plan.groups[group].path.clone(), Transition::Says(said));
    }
}
