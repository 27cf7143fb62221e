//! Ports of connections and of external io.

use super::spec::{Connection, Direction, Endpoint, Kind, Likeness, Process, Set, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::similar::nearest;
use crate::source::Span;
use crate::syntax::ast::Name;

/// What is known of a port.
enum Found<'a> {
    /// Declared by a module, here.
    Port(&'a super::spec::Port),
    /// Its module has no interface, or a part of the text is damaged.
    Unknown,
    /// No such port; these are there.
    Missing { owner: &'a Name, known: Vec<&'a Name> },
}

/// Checks that ports exist, that data goes from outputs to inputs, and that types agree.
pub(super) fn check(spec: &Spec, diagnostics: &mut Vec<Diagnostic>) {
    for process in &spec.processes {
        for export in &process.exports {
            look_up(spec, process, &export.endpoint, diagnostics);
        }
        for set in &process.sets {
            check_set(spec, process, set, diagnostics);
        }
    }
}

fn check_set(spec: &Spec, process: &Process, set: &Set, diagnostics: &mut Vec<Diagnostic>) {
    for (index, connection) in set.connections.iter().enumerate() {
        let is_same = |other: &&Connection| {
            let key = |c: &Connection| (c.from.slot, c.from.port.text.clone(), c.to.slot, c.to.port.text.clone());
            key(other) == key(connection)
        };
        if let Some(first) = set.connections[..index].iter().rev().take(1000).find(is_same) {
            let diagnostic = Diagnostic::new(Code::W0307, connection.span, "the connection stands twice in this set");
            diagnostics.push(diagnostic.reason(first.span, "first here"));
        }
        check_connection(spec, process, connection, diagnostics);
        if let Some(owner) = set.owner.filter(|&owner| owner != connection.from.slot && owner != connection.to.slot) {
            let owner = &process.instances[owner].name.text;
            let message = format!("the connection is in a set of `{owner}` but does not touch it");
            let diagnostic = Diagnostic::new(Code::W0305, connection.span, message);
            diagnostics.push(diagnostic.help(format!("it is open only while `{owner}` runs")));
        }
    }
}

fn check_connection(spec: &Spec, process: &Process, connection: &Connection, diagnostics: &mut Vec<Diagnostic>) {
    let from = look_up(spec, process, &connection.from, diagnostics);
    let to = look_up(spec, process, &connection.to, diagnostics);
    let is = |port: Option<&super::spec::Port>, direction| port.is_some_and(|port| port.direction == direction);
    if is(from, Direction::In) && is(to, Direction::Out) {
        let diagnostic =
            Diagnostic::new(Code::E0304, connection.span, "the connection goes from an input to an output");
        diagnostics.push(diagnostic.help("exchange its ends: data goes from an output to an input"));
        return;
    }
    let ends = [(from, &connection.from, Direction::In, "an input"), (to, &connection.to, Direction::Out, "an output")];
    for (port, end, wrong, what) in ends {
        if let Some(port) = port.filter(|port| port.direction == wrong) {
            let side = if wrong == Direction::In { "data comes from an output" } else { "data goes to an input" };
            let message = format!("`{}` is {what}, but {side}", end.port.text);
            let diagnostic = Diagnostic::new(Code::E0304, end.port.span, message);
            diagnostics.push(diagnostic.reason(port.name.span, "declared here"));
        }
    }
    let (Some(from), Some(to)) = (from, to) else { return };
    if let (Some(sent), Some(taken)) = (&from.kind, &to.kind) {
        diagnostics.extend(check_types(spec, connection, (from, sent), (to, taken)));
    }
}

/// Both ends of a connection have the same type.
fn check_types(
    spec: &Spec,
    connection: &Connection,
    (from, sent): (&super::spec::Port, &Kind),
    (to, taken): (&super::spec::Port, &Kind),
) -> Option<Diagnostic> {
    let (from_name, to_name) = (&connection.from.port.text, &connection.to.port.text);
    match spec.compare(sent, taken) {
        Likeness::Same => None,
        Likeness::Different => {
            let message = format!("`{from_name}` sends {sent}, but `{to_name}` takes {taken}");
            let diagnostic = Diagnostic::new(Code::E0305, connection.span, message);
            Some(diagnostic.reason(from.name.span, "the output").reason(to.name.span, "the input"))
        }
        Likeness::OnlyByName(one, other) => {
            let (one, other) = (&spec.types[one], &spec.types[other]);
            let message = format!("`{from_name}` sends another {sent} than `{to_name}` takes");
            let diagnostic = Diagnostic::new(Code::E0306, connection.span, message);
            let diagnostic = diagnostic.reason(one.name.span, format!("what is sent: {}", one.kind));
            let diagnostic = diagnostic.reason(other.name.span, format!("what is taken: {}", other.kind));
            Some(diagnostic.help("values are sent field by field: declare the same fields, in the same order"))
        }
    }
}

/// Finds the module's port behind an endpoint; reports a port that is not there.
fn look_up<'a>(
    spec: &'a Spec,
    process: &'a Process,
    endpoint: &'a Endpoint,
    diagnostics: &mut Vec<Diagnostic>,
) -> Option<&'a super::spec::Port> {
    match find(spec, process, endpoint) {
        Found::Port(port) => Some(port),
        Found::Unknown => None,
        Found::Missing { owner, known } => {
            let instance = &process.instances[endpoint.slot].name.text;
            diagnostics.push(missing(owner, instance, &known, &endpoint.port.text, endpoint.port.span));
            None
        }
    }
}

/// Follows external ports down to the leaf; groups nest finitely here.
fn find<'a>(spec: &'a Spec, process: &'a Process, endpoint: &'a Endpoint) -> Found<'a> {
    let (mut process, mut slot, mut port) = (process, endpoint.slot, &endpoint.port.text);
    let mut is_direct = true;
    loop {
        let target = match process.instances[slot].target {
            Target::Unknown => return Found::Unknown,
            Target::Module(module) => {
                let module = &spec.modules[module];
                return match module.ports.iter().find(|known| known.name.text == *port) {
                    Some(port) => Found::Port(port),
                    None if is_direct && !module.is_damaged => {
                        let known = module.ports.iter().map(|port| &port.name).collect();
                        Found::Missing { owner: &module.name, known }
                    }
                    // Reported where the group exports it, or where its text is damaged.
                    None => Found::Unknown,
                };
            }
            Target::Process(target) => &spec.processes[target],
        };
        let Some(export) = target.exports.iter().find(|export| export.name.text == *port) else {
            let known = target.exports.iter().map(|export| &export.name).collect();
            let is_known = is_direct && !target.damage.external && !target.damage.instances;
            return if is_known { Found::Missing { owner: &target.name, known } } else { Found::Unknown };
        };
        (process, slot, port) = (target, export.endpoint.slot, &export.endpoint.port.text);
        is_direct = false;
    }
}

fn missing(owner: &Name, instance: &str, known: &[&Name], port: &str, span: Span) -> Diagnostic {
    let message = format!("`{instance}` has no port `{port}`");
    let diagnostic = Diagnostic::new(Code::E0303, span, message);
    let diagnostic = diagnostic.label(format!("not a port of {}", owner.text));
    let near = nearest(port, known.iter().map(|name| name.text.as_str()));
    match near.and_then(|near| known.iter().find(|name| name.text == near)) {
        Some(near) => {
            let diagnostic = diagnostic.reason(near.span, "a port with a similar name");
            diagnostic.help(format!("did you mean `{}`?", near.text))
        }
        None if known.is_empty() => diagnostic.reason(owner.span, "it declares no ports"),
        None => {
            let known: Vec<String> = known.iter().map(|name| format!("`{}`", name.text)).collect();
            diagnostic.help(format!("its ports are {}", known.join(", ")))
        }
    }
}
