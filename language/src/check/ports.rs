//! Checks the ports of connections and of external ports.

mod calls;
mod keys;
mod messages;
mod topics;

use super::diagnostics::Diagnostics;
use super::names::listed;
use super::spec::{
    Connection, Direction, Endpoint, KeyConnection, Kind, Module, Port, Process, Set, Spec, Target, TopicConnection,
    TypeMatch,
};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Transfer;
use crate::source::Span;
use crate::syntax::ast::Name;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

pub(super) use topics::type_of;

/// The result of the search for a port.
enum Found<'a> {
    /// A module or an activity declares this port.
    Port(&'a Port),
    /// The module has no interface, or a part of the text is damaged.
    Unknown,
    /// There is no such port. `known` has the existing ports.
    Missing { owner: &'a Name, known: Vec<&'a Name> },
}

/// Checks that ports exist, that data goes from outputs to inputs, and that types agree.
pub(super) fn check(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    let calls = check_all(spec, diagnostics);
    let sets = spec.processes.iter_mut().flat_map(|process| &mut process.sets);
    for connection in sets.flat_map(|set| &mut set.connections).filter(|one| calls.contains(&one.span)) {
        connection.transfer = Transfer::Call;
    }
}

/// Returns the connections that carry calls.
fn check_all(spec: &Spec, diagnostics: &mut Diagnostics) -> BTreeSet<Span> {
    let interfaces = Interfaces::new(spec);
    let mut calls = BTreeSet::new();
    for process in &spec.processes {
        let mut ports = Ports { spec, interfaces: &interfaces, process, diagnostics, calls: Vec::new() };
        for export in &process.exports {
            ports.look_up(&export.endpoint);
        }
        for set in &process.sets {
            ports.check_set(set);
        }
        for connection in &process.outside.keys {
            ports.check_keys(connection);
        }
        for connection in &process.outside.topics {
            ports.check_topic(connection);
        }
        calls.extend(ports.calls);
    }
    calls
}

/// The end of a connection that is outside of all processes: the database, or a topic of ROS 2.
struct OutsideEnd {
    /// The direction of the ports that may be connected with this end.
    direction: Direction,
    /// How this end uses values, as a clause of a sentence.
    what: &'static str,
    /// The reason why this end has no calls, as a clause.
    not_called: &'static str,
}

impl OutsideEnd {
    /// Returns the reason if a port of any type cannot be connected with this end.
    fn misfit(&self, name: &Name, port: &Port, error: impl Fn(String) -> Diagnostic) -> Option<Diagnostic> {
        let Self { direction, what, not_called } = self;
        if port.call.is_some() {
            return Some(error(format!("`{}` is a port for calls; {not_called}", name.text)));
        }
        if port.direction == *direction {
            return None;
        }
        let is = if port.direction == Direction::In { "an input" } else { "an output" };
        let diagnostic = error(format!("`{}` is {is}, but {what}", name.text));
        Some(diagnostic.help("exchange the ends of the connection, or name another port"))
    }
}

/// The ports of all modules and groups, by name.
struct Interfaces<'a> {
    modules: Vec<BTreeMap<&'a str, &'a Port>>,
    exports: Vec<BTreeMap<&'a str, &'a Endpoint>>,
    /// The places where activities declare their ports.
    messages: BTreeSet<Span>,
}

impl<'a> Interfaces<'a> {
    fn new(spec: &'a Spec) -> Self {
        let of_module = |module: &'a Module| module.ports.iter().map(|port| (port.name.text.as_str(), port)).collect();
        let of_group =
            |group: &'a Process| group.exports.iter().map(|it| (it.name.text.as_str(), &it.endpoint)).collect();
        Self {
            modules: spec.modules.iter().map(of_module).collect(),
            exports: spec.processes.iter().map(of_group).collect(),
            messages: messages::declared(spec),
        }
    }
}

/// Checks the connections of one group.
struct Ports<'a> {
    spec: &'a Spec,
    interfaces: &'a Interfaces<'a>,
    process: &'a Process,
    diagnostics: &'a mut Diagnostics,
    /// The connections that carry calls.
    calls: Vec<Span>,
}

impl<'a> Ports<'a> {
    fn check_set(&mut self, set: &'a Set) {
        let mut first: BTreeMap<_, Span> = BTreeMap::new();
        for connection in &set.connections {
            let (from, to) = (&connection.from, &connection.to);
            match first.entry((from.slot, &from.port.text, to.slot, &to.port.text)) {
                Entry::Occupied(first) => {
                    let message = "this set contains the connection twice";
                    let diagnostic = Diagnostic::new(Code::W0307, connection.span, message);
                    self.diagnostics.push(diagnostic.reason(*first.get(), "first here"));
                }
                Entry::Vacant(place) => drop(place.insert(connection.span)),
            }
            self.check_connection(connection);
            if let Some(owner) = set.owner.filter(|&owner| owner != from.slot && owner != to.slot) {
                let owner = &self.process.instances[owner].name.text;
                let message =
                    format!("the connection is in a set of `{owner}`, but neither end is a port of `{owner}`");
                let diagnostic = Diagnostic::new(Code::W0305, connection.span, message);
                self.diagnostics.push(diagnostic.help(format!("the connection is open only while `{owner}` runs")));
            }
        }
    }

    fn check_keys(&mut self, connection: &'a KeyConnection) {
        let found = if keys::is_program(connection) {
            keys::check_program(connection)
        } else {
            let port = self.look_up(&connection.endpoint);
            port.and_then(|port| {
                let activity = self.interfaces.outside(port, &connection.endpoint, Code::E0308);
                activity.or_else(|| keys::check(connection, port))
            })
        };
        self.diagnostics.extend(found);
    }

    fn check_topic(&mut self, connection: &'a TopicConnection) {
        let found = self.look_up(&connection.endpoint).and_then(|port| {
            let activity = self.interfaces.outside(port, &connection.endpoint, Code::E0309);
            activity.or_else(|| topics::check(connection, port))
        });
        let names = std::iter::once(&connection.name).chain(&connection.frames);
        let (params, own) = (&self.process.params, &self.process.name.text);
        self.diagnostics.extend(names.filter_map(|name| name.misfit(params, own)));
        self.diagnostics.extend(found);
    }

    fn check_connection(&mut self, connection: &'a Connection) {
        let (from, to) = (self.look_up(&connection.from), self.look_up(&connection.to));
        if let (Some(from), Some(to)) = (from, to)
            && self.interfaces.is_message_call(from, to)
        {
            self.calls.push(connection.span);
            return self.diagnostics.extend(calls::not_plain(connection));
        }
        if let Some(diagnostic) = self.interfaces.pulled(connection, to) {
            self.diagnostics.push(diagnostic);
            return;
        }
        if from.or(to).is_some_and(|port| port.call.is_some()) {
            self.calls.push(connection.span);
        }
        if let Some(diagnostic) = calls::mixed(connection, from, to) {
            self.diagnostics.push(diagnostic);
            return;
        }
        let is = |port: Option<&Port>, direction| port.is_some_and(|port| port.direction == direction);
        if is(from, Direction::In) && is(to, Direction::Out) {
            let message = "the connection goes from an input to an output";
            let diagnostic = Diagnostic::new(Code::E0304, connection.span, message);
            self.diagnostics.push(diagnostic.help("exchange its ends: data goes from an output to an input"));
            return;
        }
        let source = (from, &connection.from, Direction::In, "an input", "data comes from an output");
        let target = (to, &connection.to, Direction::Out, "an output", "data goes to an input");
        for (port, end, wrong, what, rule) in [source, target] {
            if let Some(port) = port.filter(|port| port.direction == wrong) {
                let message = format!("`{}` is {what}, but {rule}", end.port.text);
                let diagnostic = Diagnostic::new(Code::E0304, end.port.span, message);
                self.diagnostics.push(diagnostic.reason(port.name.span, "declared here"));
            }
        }
        let (Some(from), Some(to)) = (from, to) else { return };
        if let (Some(calls), Some(answers)) = (&from.call, &to.call) {
            let types = calls::check_types(self.spec, connection, from, calls, to, answers);
            self.diagnostics.extend(types);
            return;
        }
        if let (Some(sent), Some(taken)) = (&from.kind, &to.kind) {
            let (from, to) = (Typed { port: from, kind: sent }, Typed { port: to, kind: taken });
            self.diagnostics.extend(check_types(self.spec, connection, &from, &to));
        }
    }

    /// Finds the module's port for an endpoint. Reports a port that does not exist.
    fn look_up(&mut self, endpoint: &'a Endpoint) -> Option<&'a Port> {
        match self.find(endpoint) {
            Found::Port(port) => Some(port),
            Found::Unknown => None,
            Found::Missing { owner, known } => {
                self.report_missing(endpoint, owner, &known);
                None
            }
        }
    }

    /// Follows external ports down to the leaf. At this point, no group contains itself.
    fn find(&self, endpoint: &'a Endpoint) -> Found<'a> {
        let (mut process, mut slot, mut port) = (self.process, endpoint.slot, &endpoint.port.text);
        let mut is_direct = true;
        loop {
            let target = match process.instances[slot].target {
                Target::Unknown => return Found::Unknown,
                Target::Module(number) => {
                    let module = &self.spec.modules[number];
                    return match self.interfaces.modules[number].get(port.as_str()) {
                        Some(port) => Found::Port(port),
                        None if is_direct && !module.is_damaged => {
                            let known = module.ports.iter().map(|port| &port.name).collect();
                            Found::Missing { owner: &module.name, known }
                        }
                        // This is reported where the group exports the port, or where the text is damaged.
                        None => Found::Unknown,
                    };
                }
                Target::Process(target) => target,
            };
            let group = &self.spec.processes[target];
            let Some(inner) = self.interfaces.exports[target].get(port.as_str()) else {
                if let Some(port) = group.message_port(port) {
                    return Found::Port(port);
                }
                let messages = group.chart().into_iter().flat_map(|chart| &chart.ports).map(|port| &port.name);
                let known = group.exports.iter().map(|export| &export.name).chain(messages).collect();
                let is_known = is_direct && !group.damage.external && !group.damage.instances;
                return if is_known { Found::Missing { owner: &group.name, known } } else { Found::Unknown };
            };
            (process, slot, port) = (group, inner.slot, &inner.port.text);
            is_direct = false;
        }
    }

    fn report_missing(&mut self, endpoint: &Endpoint, owner: &Name, known: &[&Name]) {
        let (instance, port) = (&self.process.instances[endpoint.slot].name.text, &endpoint.port);
        let message = format!("`{instance}` has no port `{}`", port.text);
        let diagnostic = Diagnostic::new(Code::E0303, port.span, message);
        let diagnostic = diagnostic.label(format!("not a port of {}", owner.text));
        let near = self.diagnostics.near(&port.text, known.iter().map(|name| name.text.as_str()));
        let diagnostic = match near.and_then(|near| known.iter().find(|name| name.text == near.name)) {
            Some(near) => {
                let diagnostic = diagnostic.reason(near.span, "a port with a similar name");
                diagnostic.help(format!("did you mean `{}`?", near.text))
            }
            None if known.is_empty() => diagnostic.reason(owner.span, "it declares no ports"),
            None => diagnostic.help(format!("its ports are {}", listed(known.iter().map(|name| name.text.as_str())))),
        };
        self.diagnostics.push(diagnostic);
    }
}

/// A port and its type.
struct Typed<'a> {
    port: &'a Port,
    kind: &'a Kind,
}

/// Checks that both ends of a connection have the same type.
fn check_types(spec: &Spec, connection: &Connection, from: &Typed<'_>, to: &Typed<'_>) -> Option<Diagnostic> {
    let (sent, taken) = (from.kind, to.kind);
    let (from_name, to_name) = (&connection.from.port.text, &connection.to.port.text);
    match spec.compare(sent, taken) {
        TypeMatch::Same => None,
        TypeMatch::Different => {
            let message = format!("`{from_name}` sends {sent}, but `{to_name}` takes {taken}");
            let diagnostic = Diagnostic::new(Code::E0305, connection.span, message);
            Some(diagnostic.reason(from.port.name.span, "the output").reason(to.port.name.span, "the input"))
        }
        TypeMatch::OnlyByName(one, other) => {
            let (one, other) = (&spec.types[one], &spec.types[other]);
            let message =
                format!("`{from_name}` sends a {sent}, but the {sent} that `{to_name}` takes has other fields");
            let diagnostic = Diagnostic::new(Code::E0306, connection.span, message);
            let diagnostic = diagnostic.reason(one.name.span, format!("the sent type: {}", one.kind));
            let diagnostic = diagnostic.reason(other.name.span, format!("the expected type: {}", other.kind));
            Some(diagnostic.help("values are sent field by field: declare the same fields, in the same order"))
        }
    }
}
