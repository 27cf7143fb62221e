//! Reads the interfaces of controller modules.

use super::{environment, python, ros_action, ros_node};
use crate::algebra::TAG_MAX;
use crate::check::names::twice;
use crate::check::spec::{Call, CallRole, Claim, Direction, Module, Outcome, Param, Port, Times};
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{self, Environment, LeafKind};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Constant, Params, Text};
use crate::syntax::ast::Node;
use std::time::Duration;

/// How long a module may take to stop, unless its interface declares another time.
pub(super) const STOP_WITHIN: Duration = Duration::from_secs(2);

/// Reads a `module` block. `places` are the places where its text is damaged.
pub(super) fn module(node: &Node, places: &[Span], reader: &mut Reader<'_>) -> Option<Module> {
    let is_damaged = !places.is_empty();
    let params = node.child(Params).filter(|_| !is_damaged).map(|node| super::params(&node, "parameter", reader));
    let host = params.as_ref().and_then(|params| params.iter().find(|param| is_host(param)));
    let mut module = Module {
        name: node.title()?,
        doc: node.doc(),
        host: host.filter(|host| host.default.is_none()).map(|host| host.name.span),
        params: params.map(|params| params.into_iter().filter(|param| !is_host(param)).collect()),
        start: None,
        ports: Vec::new(),
        is_service: false,
        has_end: false,
        remembers: false,
        outcomes: Vec::new(),
        exec: None,
        is_asked: false,
        environment: Environment::default(),
        kind: LeafKind::Controller,
        times: Times { stop_within: STOP_WITHIN, takes: None, ready_within: None },
        claims: Vec::new(),
        is_damaged,
    };
    for item in node.children() {
        read_item(&mut module, &item, reader);
    }
    python::program(&mut module, node, reader);
    ros_action::read(&mut module, node, reader);
    ros_node::read(&mut module, node, reader);
    Some(module)
}

/// Returns whether a parameter is the host. The host is the first argument of every module, and an interface need not
/// declare it.
fn is_host(param: &Param) -> bool {
    param.name.text == "host" || param.kind.as_ref().is_some_and(|kind| kind.text == "Host")
}

fn read_item(module: &mut Module, item: &Node, reader: &mut Reader<'_>) {
    let words: Vec<String> = item.names().map(|name| name.text).collect();
    let word = words.first().map_or("", String::as_str);
    if item.kind() == SyntaxKind::Port {
        add_port(module, item, reader);
    } else if item.kind() == SyntaxKind::Flag {
        module.is_service |= word == "service";
        module.has_end |= word == "done";
        module.remembers |= word == "remembers";
        outcomes(item, &mut module.outcomes, reader);
        if word == "plain" {
            module.kind = LeafKind::Plain;
        }
    } else if item.kind() == SyntaxKind::Init {
        add_start(module, item, reader);
    } else if item.kind() == SyntaxKind::Exec {
        let Some(token) = item.token(Text) else { return };
        let exec = token.content();
        if let Err(why) = plan::words(&exec) {
            let found = Diagnostic::new(Code::E0011, token.span(), format!("this `exec` starts nothing: {why}"));
            reader
                .diagnostics
                .push(found.help(
                    "blanks separate words; put quotes around a word with blanks: `exec \"say 'good morning'\"`",
                ));
        }
        module.exec = Some(exec);
    } else if item.kind() == SyntaxKind::Environment {
        environment::variables(&mut module.environment, item, reader);
    } else if item.kind() == SyntaxKind::Inherit {
        environment::inherited(&mut module.environment, item, reader);
    } else if item.kind() == SyntaxKind::Folder {
        environment::directory(&mut module.environment, item, reader);
    } else if item.kind() == SyntaxKind::StopWithin {
        let limit = item.child(Constant).and_then(|node| reader.duration(&node));
        module.times.stop_within = limit.unwrap_or(STOP_WITHIN);
    } else if item.kind() == SyntaxKind::Takes {
        let mut times = item.children_of(Constant).map(|node| reader.duration(&node)).collect::<Vec<_>>().into_iter();
        let (Some(Some(least)), Some(Some(most))) = (times.next(), times.next()) else { return };
        if least > most {
            let message = "the shortest time comes first: `duration 1 s .. 15 s`";
            reader.diagnostics.push(Diagnostic::new(Code::E0009, item.span(), message));
        }
        module.times.takes = Some((least, most));
    } else if item.kind() == SyntaxKind::Claims {
        for claim in item.children_of(SyntaxKind::Claim) {
            let mut names = claim.names();
            let Some(name) = names.next() else { continue };
            let is_write = names.next().is_none_or(|access| access.text == "write");
            module.claims.push(Claim { name, is_write });
        }
    }
}

/// Reads `done(found: Pose | missing);`.
pub(in crate::check) fn outcomes(item: &Node, known: &mut Vec<Outcome>, reader: &mut Reader<'_>) {
    for outcome in item.children_of(SyntaxKind::Outcome) {
        let Some(name) = outcome.names().next() else { continue };
        if let Some(first) = known.iter().find(|other| other.name.text == name.text) {
            reader.diagnostics.push(twice("outcome", &name.text, name.span, first.name.span));
        } else if name.text.len() > TAG_MAX {
            let message = format!("the name of an outcome has at most {TAG_MAX} bytes");
            reader.diagnostics.push(Diagnostic::new(Code::E0009, name.span, message));
        } else {
            let kind = super::kind(&outcome, reader);
            known.push(Outcome { name, kind });
        }
    }
}

/// Reads `init goal: Place;`.
fn add_start(module: &mut Module, item: &Node, reader: &mut Reader<'_>) {
    let Some(start) = super::params(item, "start value", reader).pop() else { return };
    if let Some(first) = &module.start {
        reader.diagnostics.push(twice("start value", &start.name.text, start.name.span, first.name.span));
        return;
    }
    if let Some(default) = &start.default {
        let message = format!(
            "`{}` cannot have a default: a process that is started without a value gets no value",
            start.name.text
        );
        reader.diagnostics.push(Diagnostic::new(Code::E0425, default.span, message).help("remove the default"));
    }
    module.start = Some(Param { default: None, ..start });
}

fn add_port(module: &mut Module, item: &Node, reader: &mut Reader<'_>) {
    let mut names = item.names();
    let (Some(word), Some(name)) = (names.next(), names.next()) else { return };
    if let Some(first) = module.ports.iter().find(|port| port.name.text == name.text) {
        reader.diagnostics.push(twice("port", &name.text, name.span, first.name.span));
        return;
    }
    let role = match word.text.as_str() {
        "proc" => Some(CallRole::Procedure),
        "state" => Some(CallRole::State),
        "calls" => Some(CallRole::Caller),
        _ => None,
    };
    let is_answer = matches!(role, Some(CallRole::Procedure | CallRole::State));
    let direction = if word.text == "in" || is_answer { Direction::In } else { Direction::Out };
    // Callers need not use an export, so the port is optional.
    let is_optional = is_answer || names.any(|word| word.text == "optional");
    let argument = item.child(SyntaxKind::Called).and_then(|called| super::kind(&called, reader));
    let kind = super::kind(item, reader);
    let call = role.map(|role| Call { role, argument });
    module.ports.push(Port { name, direction, kind, is_optional, call });
}
