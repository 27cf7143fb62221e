//! The messages that activities tell apart: any of them may come at any time.

use super::{System, small};
use language::algebra::Event;
use language::plan::Expression;

/// The messages that an activity tells apart; none for other groups.
pub(super) fn of(expression: &Expression) -> Vec<Event> {
    let Expression::Chart(chart) = expression else { return Vec::new() };
    let messages = chart.messages().into_iter();
    messages.filter_map(|(port, text, priority)| chart.message_at(port, &text, priority)).collect()
}

impl System<'_> {
    /// How many messages a unit tells apart.
    pub(super) fn messages(&self, unit: usize) -> u16 {
        small(self.units[unit].messages.len())
    }

    /// The message of a number.
    pub(super) fn told(&self, unit: usize, number: u16) -> Option<Event> {
        self.units[unit].messages.get(usize::from(number)).cloned()
    }

    /// The number of a message that came in a run.
    pub(crate) fn message_number(&self, unit: usize, port: u32, filters: &[u32]) -> Option<u16> {
        let is_it = |event: &Event| matches!(event, Event::Message { port: other, filters: passed, .. } if *other == port && passed == filters);
        self.units[unit].messages.iter().position(is_it).map(small)
    }

    /// The name of a message for a person: its port, its text and its priority.
    pub(crate) fn message_name(&self, unit: usize, number: u16) -> String {
        let part = &self.model.parts[self.units[unit].part];
        let Expression::Chart(chart) = &part.expression else { return String::new() };
        let messages = chart.messages();
        let Some((port, text, priority)) = messages.get(usize::from(number)) else { return String::new() };
        let port = chart.inputs.get(*port as usize).map_or("", String::as_str);
        match text.as_str() {
            "" => format!("a message at `{port}`"),
            text if *priority == 0 => format!("the message `{text}` at `{port}`"),
            text => format!("the message `{text}` of priority {priority} at `{port}`"),
        }
    }
}
