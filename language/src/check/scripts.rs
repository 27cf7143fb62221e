//! Checks the scripts of activities: their text, and the types of the values that they read and give.

use super::diagnostics::Diagnostics;
use super::interface::layout;
use super::names::listed;
use super::spec::{ChartModel, ExprKind, Kind, Process, Readable, ReadableValue, ScriptModel, Spec};
use super::types::event_kind;
use crate::automaton::Trigger;
use crate::diagnostic::{Code, Diagnostic};
use crate::message::Layout;
use crate::script::{Mistake, SCRIPT_INPUTS_MAX, ScriptInput, ScriptMistake, ScriptReader, ScriptResult, ScriptSource};
use crate::source::Span;

/// Checks every script, and fills in its inputs and the type of its result. At this point, no group contains itself.
pub(super) fn check(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    let (mut all, mut reader) = (Vec::new(), None);
    for (process, source) in spec.processes.iter().enumerate().filter(|(_, source)| !source.damage.actions) {
        let Some(model) = source.chart() else { continue };
        for (number, script) in model.scripts.iter().enumerate() {
            let Some(written) = model.chart.chart.scripts.get(number) else { continue };
            let reader = reader.get_or_insert_with(ScriptReader::new);
            let check = ScriptCheck { spec, process: source, model, script, text: &written.text, reader };
            all.extend(check.read(diagnostics).map(|read| (process, number, read)));
        }
    }
    for (process, number, Read { inputs, result }) in all {
        let actions = spec.processes[process].actions.as_mut();
        if let Some(ExprKind::Chart(model)) = actions.map(|actions| &mut actions.kind) {
            let script = &mut model.chart.chart.scripts[number];
            (script.inputs, script.result) = (inputs, result);
        }
    }
}

/// The values that a script reads, and the type of its result.
struct Read {
    inputs: Vec<ScriptInput>,
    result: ScriptResult,
}

struct ScriptCheck<'a> {
    spec: &'a Spec,
    process: &'a Process,
    model: &'a ChartModel,
    script: &'a ScriptModel,
    text: &'a str,
    reader: &'a ScriptReader,
}

impl ScriptCheck<'_> {
    fn read(&self, diagnostics: &mut Diagnostics) -> Option<Read> {
        let (mut inputs, mut closed) = (Vec::new(), Vec::new());
        for known in self.script.known.iter().filter(|known| has_word(self.text, &known.name)) {
            match self.source(&known.value) {
                Ok(source) => inputs.push(ScriptInput { name: known.name.clone(), source }),
                Err(why) => closed.push((known, why)),
            }
        }
        if inputs.len() > SCRIPT_INPUTS_MAX {
            let message =
                format!("this script reads {} values, and at most {SCRIPT_INPUTS_MAX} are allowed", inputs.len());
            diagnostics.push(Diagnostic::new(Code::E0702, self.script.span, message));
            return None;
        }
        let result = self.result();
        let names = inputs.iter().map(|input| input.name.as_str());
        if let Some(mistake) = self.reader.mistake(self.text, names, result.as_ref().ok()) {
            let found = self.mistaken(&mistake, &closed, diagnostics);
            diagnostics.push(found);
            return None;
        }
        match result {
            Ok(result) => Some(Read { inputs, result }),
            Err(found) => {
                diagnostics.push(*found);
                None
            }
        }
    }

    fn source(&self, value: &ReadableValue) -> Result<ScriptSource, String> {
        match value {
            ReadableValue::Variable(variable) => Ok(ScriptSource::Variable(*variable)),
            ReadableValue::Slot(slot) => {
                let kind = self.model.kinds.get(slot).ok_or("declare its type: `var place: opaque Pose = ();`")?;
                Ok(ScriptSource::Slot { slot: *slot, layout: self.readable(kind)? })
            }
            ReadableValue::Event { trigger, state } => {
                let kind = event_kind(self.spec, self.process, trigger, *state).ok_or_else(|| undeclared(trigger))?;
                Ok(ScriptSource::Event(self.readable(kind)?))
            }
        }
    }

    /// Returns the layout of a type whose values a script can read and give.
    fn readable(&self, kind: &Kind) -> Result<Layout, String> {
        let layout = layout(self.spec, kind).filter(|layout| !has_ros(layout));
        layout.ok_or_else(|| {
            format!(
                "a script can use numbers, quantities, truths, texts, and records and lists of them, and not {kind}"
            )
        })
    }

    /// Returns the declared type of the variable that gets the result.
    fn kind(&self) -> Option<&Kind> {
        self.model.kinds.get(&self.script.slot)
    }

    fn result(&self) -> Result<ScriptResult, Box<Diagnostic>> {
        let name = &self.script.variable;
        let Some(kind) = self.kind() else {
            let message = format!("the type of `{}` is not declared, so a script cannot give its value", name.text);
            let help = format!("declare the type: `var {}: opaque Pose = ();`", name.text);
            return Err(Box::new(Diagnostic::new(Code::E0910, name.span, message).help(help)));
        };
        let layout = self.readable(kind).map_err(|why| {
            let message = format!("a script cannot give a value of type {kind}");
            Box::new(Diagnostic::new(Code::E0910, name.span, message).reason(kind.span, "declared here").help(why))
        })?;
        Ok(ScriptResult { variable: name.text.clone(), of: kind.to_string(), layout })
    }

    /// Makes the diagnostic for a mistake in the text. `closed` are the names whose values the script cannot read.
    fn mistaken(
        &self,
        mistake: &ScriptMistake,
        closed: &[(&Readable, String)],
        diagnostics: &mut Diagnostics,
    ) -> Diagnostic {
        let span = self.place(mistake.offset);
        match &mistake.mistake {
            Mistake::Text(why) => Diagnostic::new(Code::E0909, span, format!("this script cannot be read: {why}")),
            Mistake::Name(name) => self.unknown_name(name, span, closed, diagnostics),
            Mistake::Function(name) => {
                let found = Diagnostic::new(Code::E0909, span, format!("scripts have no function `{name}`"));
                match diagnostics.near(name, self.reader.functions()) {
                    Some(near) => found.rename(span, &near),
                    None => found,
                }
            }
            Mistake::Arguments(name) => {
                Diagnostic::new(Code::E0909, span, format!("`{name}` has another number of parameters"))
            }
            Mistake::Result(why) => {
                let found = Diagnostic::new(Code::E0910, span, why.clone());
                match self.kind() {
                    Some(kind) => found.reason(kind.span, "declared here"),
                    None => found,
                }
            }
        }
    }

    fn unknown_name(
        &self,
        name: &str,
        span: Span,
        closed: &[(&Readable, String)],
        diagnostics: &mut Diagnostics,
    ) -> Diagnostic {
        if let Some((_, why)) = closed.iter().find(|(known, _)| known.name == *name) {
            let message = format!("this script cannot read the value of `{name}`");
            return Diagnostic::new(Code::E0910, span, message).help(why.clone());
        }
        let known = self.script.known.iter().map(|known| known.name.as_str());
        let found = Diagnostic::new(Code::E0909, span, format!("this script does not know `{name}`"));
        match diagnostics.near(name, known.clone()) {
            Some(near) => found.rename(span, &near),
            None if self.script.known.is_empty() => found,
            None => found.help(format!("here it can read {}; a function sees only its parameters", listed(known))),
        }
    }

    /// Returns the word or the sign at a byte of the text.
    fn place(&self, offset: usize) -> Span {
        let rest = self.text.get(offset..).unwrap_or_default();
        let word = rest.find(|c: char| !is_letter(c)).unwrap_or(rest.len());
        let length = if word > 0 { word } else { rest.chars().next().map_or(1, char::len_utf8) };
        let small = |bytes: usize| u32::try_from(bytes).unwrap_or(u32::MAX);
        // The span has the brace before the text.
        let start = self.script.span.start.saturating_add(small(offset + 1));
        Span { start, end: start.saturating_add(small(length)), ..self.script.span }
    }
}

/// Returns what a spec can write, so that the type of the value of an event is known.
fn undeclared(trigger: &Trigger) -> String {
    match trigger {
        Trigger::Done(None) => "name the outcome as well: `on done(found p)`".to_owned(),
        Trigger::Done(Some(tag)) => {
            format!("no interface declares the type of `{tag}`: write `done({tag}: Pose);` in the module")
        }
        Trigger::Message { .. }
        | Trigger::Always
        | Trigger::Any
        | Trigger::Signal(_)
        | Trigger::Notice(_)
        | Trigger::Aborted(_)
        | Trigger::Complete
        | Trigger::After(_)
        | Trigger::Every(_) => "the value of this event has no declared type".to_owned(),
    }
}

fn is_letter(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Returns whether a text has a word.
pub(super) fn has_word(text: &str, word: &str) -> bool {
    text.split(|c| !is_letter(c)).any(|other| other == word)
}

fn has_ros(layout: &Layout) -> bool {
    match layout {
        Layout::Ros { .. } => true,
        Layout::Number { .. } | Layout::Truth | Layout::Text => false,
        Layout::Record(fields) => fields.iter().any(|(_, layout)| has_ros(layout)),
        Layout::List { of, .. } => has_ros(of),
    }
}
