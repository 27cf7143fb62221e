//! Triggers from outside the activity: orders of people, lost hosts, parameters, and ends of single instances.

use super::ActivityReader;
use crate::automaton::Trigger;
use crate::check::spec::ValueKind;
use crate::diagnostic::{Code, Diagnostic};
use crate::host::host_name_problem;
use crate::plan::{Constant, Notice};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Dot};
use crate::syntax::ast::{Name, Node};

/// Returns whether a trigger is `suspend`, `resume`, `host H lost`, `link H lost`, `parameter CHILD.NAME changed` or `CHILD.done`.
pub(super) fn is_notice(trigger: &Node) -> bool {
    let word = trigger.names().next().map(|word| word.text);
    let words = ["suspend", "resume", "host", "link", "parameter"];
    trigger.token(Dot).is_some() || word.is_some_and(|word| words.contains(&word.as_str()))
}

/// Reads such a trigger of a notice.
pub(super) fn read(reader: &mut ActivityReader<'_, '_>, trigger: &Node) -> Option<Trigger> {
    let names: Vec<Name> = trigger.names().collect();
    let words: Vec<&str> = names.iter().map(|name| name.text.as_str()).collect();
    let notice = match words.as_slice() {
        [_, "done"] => Notice::Done(child(reader, &names[0])?),
        [_, "aborted"] => Notice::Aborted(child(reader, &names[0])?),
        ["suspend"] => Notice::Suspend,
        ["resume"] => Notice::Resume,
        ["host", ..] => Notice::HostLost(host(reader, trigger)?),
        ["link", ..] => Notice::LinkLost(host(reader, trigger)?),
        ["parameter", _, parameter, _] => {
            Notice::ParameterChanged { member: child(reader, &names[1])?, parameter: (*parameter).to_owned() }
        }
        _ => return None,
    };
    Some(Trigger::Notice(number_of(reader, notice, trigger.span())))
}

/// Returns the number of a notice. The same notice always has the same number.
fn number_of(reader: &mut ActivityReader<'_, '_>, notice: Notice, place: Span) -> usize {
    let notices = &mut reader.heard.notices;
    if let Some(known) = notices.iter().position(|(known, _)| *known == notice) {
        return known;
    }
    notices.push((notice, place));
    notices.len() - 1
}

/// Returns the instance of this activity that a trigger names.
fn child(reader: &mut ActivityReader<'_, '_>, name: &Name) -> Option<String> {
    let found = reader.group.names.exact(name).map(|_| name.text.clone());
    reader.is_sound &= found.is_some();
    found
}

/// Returns the host that a trigger names. A wrong argument of the activity is reported at the argument.
fn host(reader: &mut ActivityReader<'_, '_>, trigger: &Node) -> Option<String> {
    let constant = trigger.child(SyntaxKind::Constant)?;
    let value = reader.group.reader().value(&constant);
    match value.kind {
        ValueKind::Constant(Constant::Text(host)) if host_name_problem(&host).is_none() => Some(host),
        ValueKind::Broken => {
            reader.is_sound = false;
            None
        }
        ValueKind::Constant(_) | ValueKind::Param(_) | ValueKind::Record(_) | ValueKind::List(_) => {
            let message = format!("`{}` is not the name of a host", constant.compact_text());
            reader.report(Diagnostic::new(Code::E0903, constant.span(), message));
            None
        }
    }
}
