//! Checks the ports that are connected with keys of the database.

use super::OutsideEnd;
use crate::check::spec::{Direction, KeyConnection, Port};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::DATABASE;

/// The types that an input can receive from keys: their values, and the results of the process's own puts.
const HEARS: [&str; 2] = ["KeyNews", "KeyAnswer"];
/// The types that an output can put at a key.
const PUTS: [&str; 1] = ["KeyPut"];

/// Returns whether the connection is for the program itself, which uses the database without a port.
pub(super) fn is_program(connection: &KeyConnection) -> bool {
    connection.endpoint.port.text == DATABASE
}

/// Returns the reason if a program cannot be connected with keys.
pub(super) fn check_program(connection: &KeyConnection) -> Option<Diagnostic> {
    let error = || Diagnostic::new(Code::E0308, connection.span, "a program does not need a connection to read keys");
    let is_read = !connection.is_write;
    is_read.then(|| error().help(format!("to allow writing, write `robot, {DATABASE} -> db(\"team/flat/claim/**\");`")))
}

/// Returns the reason if a port cannot be connected with keys.
pub(super) fn check(connection: &KeyConnection, port: &Port) -> Option<Diagnostic> {
    let name = &connection.endpoint.port;
    let error = |message: String| {
        let diagnostic = Diagnostic::new(Code::E0308, name.span, message);
        diagnostic.reason(port.name.span, "declared here")
    };
    let (direction, types, what) = match connection.is_write {
        true => (Direction::Out, &PUTS[..], "the database stores the values of an output"),
        false => (Direction::In, &HEARS[..], "the database sends to an input"),
    };
    let outside = OutsideEnd { direction, what, not_called: "only values can be connected with the database" };
    if let Some(diagnostic) = outside.misfit(name, port, error) {
        return Some(diagnostic);
    }
    let kind = port.kind.as_ref()?.to_string();
    let fits = types.contains(&kind.as_str());
    let known: Vec<String> = types.iter().map(|name| format!("`{name}`")).collect();
    let message = || format!("`{}` is of type `{kind}`, but {what} of type {}", name.text, known.join(" or "));
    (!fits).then(|| error(message()).help("the SDK declares these types for controllers"))
}
