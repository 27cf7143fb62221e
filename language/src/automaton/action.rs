//! Actions, by rules 10 to 14.

use super::chart::{Action, Fragment, ValueSource};
use super::configuration::Configuration;
use super::event::Command;
use super::select::Cue;
use super::shape::{Automaton, Scripts};
use crate::algebra::{Cause, Reason, Value};
use crate::plan::text_value;
use crate::script::{Given, Script, ScriptError, ScriptInput, ScriptSource};

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
            Action::Compute { slot, script } => {
                match computed(automaton, configuration, &automaton.chart().scripts[*script], event) {
                    Ok(value) => configuration.slots[*slot] = value,
                    Err(error) => {
                        configuration.error.get_or_insert(Reason { member: None, cause: Cause::Script(error) });
                        return;
                    }
                }
            }
        }
    }
}

/// Returns the result of a script, by rule 83. Without the true values, the result is an empty value.
fn computed(
    automaton: &Automaton,
    configuration: &mut Configuration,
    script: &Script,
    event: &Value,
) -> Result<Value, ScriptError> {
    if let Some(kind) = configuration.scripts.failure.take() {
        return Err(ScriptError::assumed(kind));
    }
    let given = |source: &ScriptSource| match source {
        ScriptSource::Event(_) => Given::Bytes(event.clone()),
        ScriptSource::Slot { slot, .. } => Given::Bytes(configuration.slots[*slot].clone()),
        ScriptSource::Variable(variable) => given_variable(automaton, configuration, *variable),
    };
    let is_missing =
        |input: &ScriptInput| matches!(given(&input.source), Given::Bytes(value) if value.bytes().is_empty());
    match automaton.scripts() {
        Scripts::Assumed => return Ok(Value::EMPTY),
        Scripts::Known if script.inputs.iter().any(is_missing) => return Ok(Value::EMPTY),
        Scripts::Known | Scripts::Run => {}
    }
    if configuration.scripts.left == 0 {
        return Err(ScriptError::too_many());
    }
    let result = script.run(&given);
    configuration.scripts.left -= 1;
    result
}

fn given_variable(automaton: &Automaton, configuration: &Configuration, variable: usize) -> Given {
    let (value, declared) = (configuration.variables[variable], &automaton.chart().variables[variable]);
    let name = usize::try_from(value).ok().and_then(|value| declared.names.get(value));
    match name.map(String::as_str) {
        Some("true") => Given::Truth(true),
        Some("false") => Given::Truth(false),
        Some(name) => Given::Name(name.to_owned()),
        None => Given::Number(value),
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
