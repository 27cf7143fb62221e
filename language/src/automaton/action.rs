//! Actions, by rules 10 to 14.

use super::chart::{Action, Fragment, ValueSource};
use super::configuration::Configuration;
use super::event::Command;
use super::select::Cue;
use super::shape::Automaton;
use crate::algebra::{Cause, Reason, Value};
use crate::plan::text_value;

/// Carries out one block of actions. An error ends the block. The configuration keeps the first error.
pub(super) fn carry_out(
    automaton: &Automaton,
    configuration: &mut Configuration,
    actions: &[Action],
    event: &Value,
    commands: &mut Vec<Command>,
) {
    for action in actions {
        match action {
            Action::Assign { variable, formula } => {
                let value = formula.value(configuration);
                let declared = &automaton.chart().variables[*variable];
                let in_range = i32::try_from(value).ok().filter(|value| (declared.min..=declared.max).contains(value));
                let Some(value) = in_range else {
                    let (name, min, max) = (&declared.name, declared.min, declared.max);
                    let why = format!("`{name}` would be {value}, which is outside {min}..{max}");
                    configuration.error.get_or_insert(failed(&why));
                    return;
                };
                configuration.variables[*variable] = value;
            }
            Action::Keep { slot, value } => configuration.slots[*slot] = value_of(configuration, value, event),
            Action::Raise(signal) => configuration.raised.push_back(Cue::Signal(*signal)),
            Action::Send { output, value } => {
                commands.push(Command::Send { output: *output, value: value_of(configuration, value, event) });
            }
            Action::Log(fragments) => commands.push(Command::Log(text_of(configuration, fragments))),
        }
    }
}

/// Returns the text that the fragments make together.
fn text_of(configuration: &Configuration, fragments: &[Fragment]) -> String {
    let text = |fragment: &Fragment| match fragment {
        Fragment::Text(text) => text.clone(),
        Fragment::Number(formula) => formula.value(configuration).to_string(),
        Fragment::Name(formula, names) => {
            let value = formula.value(configuration);
            let name = usize::try_from(value).ok().and_then(|value| names.get(value));
            name.cloned().unwrap_or_else(|| value.to_string())
        }
    };
    fragments.iter().map(text).collect()
}

/// Returns the value that a source stands for.
pub(super) fn value_of(configuration: &Configuration, source: &ValueSource, event: &Value) -> Value {
    match source {
        ValueSource::Constant(value) => value.clone(),
        ValueSource::Slot(slot) => configuration.slots[*slot].clone(),
        ValueSource::Event => event.clone(),
        ValueSource::Tagged { tag, of } => {
            let value = value_of(configuration, of, event);
            Value::tagged(tag, value.bytes()).unwrap_or(value)
        }
        ValueSource::Text(fragments) => text_value(&text_of(configuration, fragments)),
        ValueSource::Number(formula) => {
            #[expect(clippy::cast_precision_loss, reason = "programs have numbers of 64 bits with a fraction")]
            let number = formula.value(configuration) as f64;
            Value::new(&number.to_le_bytes())
        }
    }
}

/// Returns the reason of an abort with this text.
pub(super) fn failed(why: &str) -> Reason {
    Reason { member: None, cause: Cause::Failed(why.into()) }
}
