//! The normal ends of an activity: `done(held: Pose | gave_up);` declares the outcomes, and each `-> done(held v)`
//! names one of them.

use super::ActivityReader;
use crate::algebra::Value;
use crate::automaton::{Target, ValueSource};
use crate::check::names::listed;
use crate::check::spec::Outcome;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind;
use crate::syntax::ast::{Name, Node};

/// Reads `done`, `done(v)`, `done(held)` or `done(held v)`. `event` is the name of the value of the event.
pub(super) fn target(reader: &mut ActivityReader<'_, '_>, node: &Node, event: Option<&str>) -> Option<Target> {
    let formula = node.child(SyntaxKind::Formula);
    let named = node.names().nth(1);
    if reader.interface.outcomes.is_empty() {
        return match (named, formula) {
            (Some(name), _) => {
                let message = format!("this activity declares no outcome `{}`", name.text);
                let diagnostic = Diagnostic::new(Code::E0421, name.span, message);
                reader.report(diagnostic.help(format!("declare its outcomes: `done({} | missing);`", name.text)));
                None
            }
            (None, Some(formula)) => Some(Target::Done(reader.value_of(&formula, event)?)),
            (None, None) => Some(Target::Done(ValueSource::Constant(Value::EMPTY))),
        };
    }
    // A name without a value is the outcome.
    let (name, value) = match (named, formula) {
        (Some(name), value) => (Some(name), value),
        (None, Some(formula)) => (formula.names().next().filter(|_| formula.children().next().is_none()), None),
        (None, None) => (None, None),
    };
    let Some(name) = name else {
        let message = "this `done` does not name an outcome of the activity";
        let help = format!("its outcomes are {}", known(&reader.interface.outcomes));
        reader.report(Diagnostic::new(Code::E0421, node.span(), message).help(help));
        return None;
    };
    let outcome = declared(reader, &name)?;
    let kind = outcome.kind.as_ref().map(|kind| kind.text.clone());
    let of = match (value, kind) {
        (Some(value), Some(_)) => reader.value_of(&value, event)?,
        (None, None) => ValueSource::Constant(Value::EMPTY),
        (None, Some(kind)) => {
            let message = format!("the outcome `{}` needs a value of type `{kind}`", name.text);
            let help = format!("add the value: `-> done({} v)`", name.text);
            reader.report(Diagnostic::new(Code::E0904, name.span, message).help(help));
            return None;
        }
        (Some(value), None) => {
            let message = format!("the outcome `{}` has no value", name.text);
            let help =
                format!("declare its type, as in `done({}: Text);`, or write `-> done({})`", name.text, name.text);
            reader.report(Diagnostic::new(Code::E0904, value.span(), message).help(help));
            return None;
        }
    };
    Some(Target::Done(ValueSource::Tagged { tag: name.text, of: Box::new(of) }))
}

/// Returns the outcome with this name. If there is none, reports this, with a similar name.
fn declared<'r>(reader: &'r mut ActivityReader<'_, '_>, name: &Name) -> Option<&'r Outcome> {
    let outcomes = &reader.interface.outcomes;
    if let Some(place) = outcomes.iter().position(|outcome| outcome.name.text == name.text) {
        return reader.interface.outcomes.get(place);
    }
    let names: Vec<String> = outcomes.iter().map(|outcome| outcome.name.text.clone()).collect();
    let diagnostic = Diagnostic::new(Code::E0421, name.span, format!("no outcome is called `{}`", name.text));
    let near = reader.group.diagnostics().near(&name.text, names.iter().map(String::as_str));
    let diagnostic = match &near {
        Some(near) => diagnostic.rename(name.span, near),
        None => diagnostic.help(format!("the outcomes are {}", known(&reader.interface.outcomes))),
    };
    reader.report(diagnostic);
    None
}

fn known(outcomes: &[Outcome]) -> String {
    listed(outcomes.iter().map(|outcome| outcome.name.text.as_str()))
}
