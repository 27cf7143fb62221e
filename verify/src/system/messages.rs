//! The messages and notices that activities distinguish: any of them may come at any time. The notice of a lost host is an
//! exception if the loss is an explored fault. It then comes when the node of the activity notices the loss.

use super::{System, small};
use language::algebra::Event;
use language::plan::{Expression, Notice, StateChart};

/// Returns the messages and notices that an activity distinguishes; none for other groups.
pub(super) fn of(expression: &Expression) -> Vec<Event> {
    if let Expression::Chart(chart) = expression { chart.heard() } else { Vec::new() }
}

impl System<'_> {
    /// Returns the numbers of the messages and notices that may come to a unit.
    pub(super) fn messages(&self, unit: usize) -> impl Iterator<Item = u16> {
        let is_faulty = self.mode.fault.is_some() || self.mode.lost.is_some();
        let is_loss = move |event: &Event| is_faulty && matches!(self.noticed(unit, event), Some(Notice::HostLost(_)));
        let messages = self.units[unit].messages.iter().enumerate();
        messages.filter(move |(_, event)| !is_loss(event)).map(|(number, _)| small(number))
    }

    /// Returns the event of a unit that learns of the loss of a host; none if no transition waits for it.
    pub(super) fn loss_notice(&self, unit: usize, host: u32) -> Option<Event> {
        let host = self.model.plan.hosts.get(host as usize)?;
        self.chart(unit)?.notice(&Notice::HostLost(host.clone()))
    }

    /// Returns whether a unit waits for the loss of a host.
    pub(super) fn awaits_loss(&self, unit: usize, host: u32) -> bool {
        self.loss_notice(unit, host).is_some()
    }

    fn chart(&self, unit: usize) -> Option<&StateChart> {
        let expression = &self.model.parts[self.units[unit].part].expression;
        if let Expression::Chart(chart) = expression { Some(chart) } else { None }
    }

    fn noticed(&self, unit: usize, event: &Event) -> Option<&Notice> {
        let Event::Notice(number) = event else { return None };
        self.chart(unit)?.notices.get(*number as usize)
    }

    /// The message of a number.
    pub(super) fn told(&self, unit: usize, number: u16) -> Option<Event> {
        self.units[unit].messages.get(usize::from(number)).cloned()
    }

    /// Returns the number of a message or notice that came in a run.
    pub(crate) fn message_number(&self, unit: usize, event: &Event) -> Option<u16> {
        let is_it = |known: &Event| match (known, event) {
            (Event::Message { port, filters, .. }, Event::Message { port: other, filters: passed, .. }) => {
                port == other && filters == passed
            }
            (Event::Notice(number), Event::Notice(other)) => number == other,
            _ => false,
        };
        self.units[unit].messages.iter().position(is_it).map(small)
    }

    /// Returns the name of a message or notice for people; for a message: its port, its text and its priority.
    pub(crate) fn message_name(&self, unit: usize, number: u16) -> String {
        let Some(chart) = self.chart(unit) else { return String::new() };
        if let Some(notice) = self.told(unit, number).and_then(|event| self.noticed(unit, &event)) {
            return notice_name(notice);
        }
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

/// The name of a notice, for a person.
fn notice_name(notice: &Notice) -> String {
    match notice {
        Notice::Suspend => "the order to suspend".to_owned(),
        Notice::Resume => "the order to resume".to_owned(),
        Notice::HostLost(host) => format!("the news that host `{host}` is lost"),
        Notice::LinkLost(host) => format!("the news that host `{host}` cannot be reached"),
        Notice::ParameterChanged { member, parameter } => {
            format!("the news that `{parameter}` of `{member}` has changed")
        }
        Notice::Answer { option, .. } => format!("the answer `{option}`"),
        Notice::Done(member) => format!("the news that `{member}` is done"),
        Notice::Aborted(member) => format!("the news that `{member}` has failed"),
    }
}
