//! Checks connections that carry calls: from a process that calls, to a procedure or state of another process.

use crate::check::spec::{Call, CallRole, Connection, Direction, Kind, Port, Spec, TypeMatch};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Quality, Transfer};

/// Returns the reason if a connection is neither for calls nor for data.
pub(super) fn mixed(connection: &Connection, from: Option<&Port>, to: Option<&Port>) -> Option<Diagnostic> {
    let is_call = |port: Option<&Port>| port.map(|port| port.call.is_some());
    let error = |message: String| Diagnostic::new(Code::E0307, connection.span, message);
    let (from_name, to_name) = (&connection.from.port.text, &connection.to.port.text);
    let ends = [is_call(from), is_call(to)];
    if !ends.contains(&Some(true)) {
        return None;
    }
    let data = if ends[0] == Some(false) { from_name } else { to_name };
    if ends.contains(&Some(false)) {
        let other = if data == from_name { to_name } else { from_name };
        return Some(error(format!("`{data}` is a port for data, but `{other}` is a port for calls")));
    }
    let is_wrong = |port: Option<&Port>, direction| port.is_some_and(|port| port.direction == direction);
    if is_wrong(from, Direction::In) && is_wrong(to, Direction::Out) {
        let diagnostic =
            Diagnostic::new(Code::E0304, connection.span, "the connection goes from the called process to its caller");
        return Some(diagnostic.help("exchange its ends: a call goes from the caller to the called process"));
    }
    if is_wrong(from, Direction::In) {
        return Some(error(format!("this connection has no caller: `{from_name}` is also a called port")));
    }
    if is_wrong(to, Direction::Out) {
        return Some(error(format!("this connection has no called port: `{to_name}` is also a caller")));
    }
    not_plain(connection)
}

/// Returns the reason if a call cannot be connected in this way. Only connections of values have a quality.
pub(super) fn not_plain(connection: &Connection) -> Option<Diagnostic> {
    let is_plain = connection.transfer != Transfer::Pull && connection.quality == Quality::default();
    let message = "a connection for calls cannot have `pull`, `latch`, `queue` or `rate`";
    (!is_plain).then(|| Diagnostic::new(Code::E0307, connection.span, message))
}

/// Compares the types of the argument and of the result.
pub(super) fn check_types(
    spec: &Spec,
    connection: &Connection,
    from: &Port,
    calls: &Call,
    to: &Port,
    answers: &Call,
) -> Vec<Diagnostic> {
    let (from_name, to_name) = (&connection.from.port.text, &connection.to.port.text);
    let text = |kind: &Option<Kind>| kind.as_ref().map_or_else(|| "nothing".to_owned(), ToString::to_string);
    let mut found = Vec::new();
    let mut check = |one: &Option<Kind>, other: &Option<Kind>, message: String| {
        let (code, forms) = match (one, other) {
            (None, None) => return,
            (Some(one), Some(other)) => match spec.compare(one, other) {
                TypeMatch::Same => return,
                TypeMatch::Different => (Code::E0305, None),
                TypeMatch::OnlyByName(one, other) => (Code::E0306, Some((&spec.types[one], &spec.types[other]))),
            },
            (Some(_), None) | (None, Some(_)) => (Code::E0305, None),
        };
        let diagnostic = Diagnostic::new(code, connection.span, message);
        found.push(match forms {
            Some((one, other)) => diagnostic
                .reason(one.name.span, format!("the type at one end: {}", one.kind))
                .reason(other.name.span, format!("the type at the other end: {}", other.kind))
                .help("values are sent field by field: declare the same fields, in the same order"),
            None => diagnostic.reason(from.name.span, "the caller").reason(to.name.span, "the called port"),
        });
    };
    let takes = if answers.role == CallRole::State { "is a state and takes" } else { "takes" };
    let argument = format!(
        "`{from_name}` calls with {}, but `{to_name}` {takes} {}",
        text(&calls.argument),
        text(&answers.argument)
    );
    check(&calls.argument, &answers.argument, argument);
    check(
        &from.kind,
        &to.kind,
        format!("`{to_name}` answers {}, but `{from_name}` takes {}", text(&to.kind), text(&from.kind)),
    );
    found
}
