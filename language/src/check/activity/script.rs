//! Scripts in actions: `where = script { … };`. The types of the values that a script reads are found later.

use super::ActivityReader;
use crate::automaton::Action;
use crate::check::spec::{Kind, Readable, ReadableValue, ScriptModel};
use crate::diagnostic::{Code, Diagnostic};
use crate::message::Layout;
use crate::script::{SCRIPT_TEXT_MAX, Script, ScriptResult};
use crate::syntax::SyntaxKind::{Minus, Plus};
use crate::syntax::ast::{Name, Node, Token};
use std::collections::{BTreeMap, BTreeSet};

/// The scripts of an activity.
#[derive(Default)]
pub(super) struct Scripts {
    pub(super) models: Vec<ScriptModel>,
    /// The declared types of opaque variables, by slot.
    pub(super) kinds: BTreeMap<usize, Kind>,
    /// The event whose actions are read, if it has a value.
    pub(super) event: Option<Readable>,
}

/// Reads a script whose result is assigned to a variable.
pub(super) fn read(reader: &mut ActivityReader<'_, '_>, variable: &Name, token: &Token, node: &Node) -> Option<Action> {
    let Some(slot) = reader.kept(&variable.text) else {
        match reader.variables.contains_key(&variable.text) {
            true => {
                let message =
                    format!("a script cannot give a value to `{}`, which is a finite variable", variable.text);
                let help = "declare an opaque variable for the result: `var place: opaque Pose = ();`";
                reader.report(Diagnostic::new(Code::E0904, variable.span, message).help(help));
            }
            false => reader.report_unknown(variable, "a variable"),
        }
        return None;
    };
    if node.token(Plus).or_else(|| node.token(Minus)).is_some() {
        let message = "a script gives a whole value, which cannot be added";
        reader.report(Diagnostic::new(Code::E0904, token.span(), message).help("write `= script { … }`"));
        return None;
    }
    let text = token.text().strip_prefix('{').and_then(|text| text.strip_suffix('}'))?;
    if text.len() > SCRIPT_TEXT_MAX {
        let message = format!("this script has {} bytes, and at most {SCRIPT_TEXT_MAX} are allowed", text.len());
        reader.report(Diagnostic::new(Code::E0702, token.span(), message));
        return None;
    }
    let known = readable(reader);
    reader.scripts.models.push(ScriptModel { span: token.span(), variable: variable.clone(), slot, known });
    // The inputs and the type of the result follow when the types are known.
    let result = ScriptResult { variable: variable.text.clone(), of: String::new(), layout: Layout::Truth };
    reader.chart.scripts.push(Script { text: text.to_owned(), inputs: Vec::new(), result });
    Some(Action::Compute { slot, script: reader.chart.scripts.len() - 1 })
}

/// Returns the names that a script may read at this place. The value of the event comes before variables.
fn readable(reader: &ActivityReader<'_, '_>) -> Vec<Readable> {
    let event = reader.scripts.event.iter().map(|event| (event.name.clone(), event.value.clone()));
    let kept = reader.group.kept.variables.iter();
    let kept = kept.filter_map(|(name, slot)| Some((name.clone(), ReadableValue::Slot((*slot)?))));
    let finite = reader.variables.iter().map(|(name, (number, _))| (name.clone(), ReadableValue::Variable(*number)));
    let mut names = BTreeSet::new();
    let all = event.chain(kept).chain(finite).filter(|(name, _)| names.insert(name.clone()));
    all.map(|(name, value)| Readable { name, value }).collect()
}
