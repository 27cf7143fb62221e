//! A recorded step, to be compared later with the result of [`step`](super::step).

use super::event::{Command, Event, Outcome, Value};
use serde::{Deserialize, Serialize};

/// The most bytes of a value that are recorded.
const VALUE_MAX: usize = 1024;

/// One step of a supervisor: the event of its group, and its reaction.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StepRecord {
    /// The event.
    pub event: Event,
    /// The commands that were carried out, in order.
    pub commands: Vec<Command>,
    /// How the group ended. None if it has not ended.
    pub outcome: Option<Outcome>,
    /// Whether a value was too long, so that its end was left out.
    pub is_cut: bool,
}

impl StepRecord {
    /// Records a step; long values are cut off.
    pub fn new(event: Event, commands: Vec<Command>, outcome: Option<Outcome>) -> Self {
        let mut record = Self { event, commands, outcome, is_cut: false };
        let is_long = record.values().any(|value| value.bytes().len() > VALUE_MAX);
        if is_long {
            record.change_values(|value| Value::new(value.bytes().get(..VALUE_MAX).unwrap_or(value.bytes())));
            record.is_cut = true;
        }
        record
    }

    /// Returns the same step with empty values.
    #[must_use]
    pub fn without_values(mut self) -> Self {
        self.change_values(|_| Value::EMPTY);
        self
    }

    fn values(&self) -> impl Iterator<Item = &Value> {
        let event = match &self.event {
            Event::Start(value)
            | Event::Done { value, .. }
            | Event::Aborted { report: value, .. }
            | Event::Message { value, .. } => Some(value),
            Event::Stop
            | Event::Stopped { .. }
            | Event::StopUnconfirmed { .. }
            | Event::Elapsed { .. }
            | Event::Notice(_) => None,
        };
        let commands = self.commands.iter().filter_map(|command| match command {
            Command::Activate { value, .. } | Command::Send { value, .. } => Some(value),
            Command::Connect { .. }
            | Command::Disconnect { .. }
            | Command::Stop { .. }
            | Command::Arm { .. }
            | Command::Cancel { .. }
            | Command::Log { .. }
            | Command::Lost { .. } => None,
        });
        let outcome = self.outcome.iter().filter_map(|outcome| match outcome {
            Outcome::Done(value) => Some(value),
            Outcome::Aborted(_) | Outcome::Stopped => None,
        });
        event.into_iter().chain(commands).chain(outcome)
    }

    fn change_values(&mut self, change: impl Fn(&Value) -> Value) {
        match &mut self.event {
            Event::Start(value)
            | Event::Done { value, .. }
            | Event::Aborted { report: value, .. }
            | Event::Message { value, .. } => {
                *value = change(value);
            }
            Event::Stop
            | Event::Stopped { .. }
            | Event::StopUnconfirmed { .. }
            | Event::Elapsed { .. }
            | Event::Notice(_) => {}
        }
        for command in &mut self.commands {
            if let Command::Activate { value, .. } | Command::Send { value, .. } = command {
                *value = change(value);
            }
        }
        if let Some(Outcome::Done(value)) = &mut self.outcome {
            *value = change(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::algebra::Activation;

    #[test]
    fn long_values_are_cut_off_and_that_is_said() {
        let done = |bytes: &[u8]| {
            let value = Value::new(bytes);
            let activate = Command::Activate { member: 1, activation: Activation(1), value: value.clone() };
            let event = Event::Done { member: 0, activation: Activation(1), value: value.clone() };
            StepRecord::new(event, vec![activate, Command::Connect { set: 0 }], Some(Outcome::Done(value)))
        };
        let (short, long) = (done(&[7; VALUE_MAX]), done(&[7; VALUE_MAX + 1]));
        assert!(!short.is_cut && long.is_cut);
        assert_eq!(StepRecord { is_cut: false, ..long.clone() }, short);
        assert_eq!(long.without_values().values().map(|value| value.bytes().len()).sum::<usize>(), 0);
    }
}
