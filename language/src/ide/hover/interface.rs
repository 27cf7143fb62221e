//! Describes an interface: the inputs, outputs and claims of a type, and whether it ends.

use super::code;
use crate::check::spec::{CallRole, Direction, Endpoint, Module, Param, Port, Process, Target};
use crate::ide::Analysis;
use crate::plan::LeafKind;
use crate::source::Span;
use crate::unit;
use std::fmt::Write as _;

impl Analysis {
    /// Returns the text of a process group: its parameters, its ports, and whether it ends.
    pub(in crate::ide) fn process_text(&self, process: usize) -> String {
        let process = &self.model.processes[process];
        let params: Vec<String> = process.params.iter().map(Param::to_string).collect();
        let mut lines = format!("process {}({})", process.name.text, params.join(", "));
        for export in &process.exports {
            let port = self.port_behind(process, &export.endpoint);
            let _infallible = write!(lines, "\n    {}", shown_port(&export.name.text, port));
        }
        let end = match process.is_service {
            true => "A *service*: nothing in it ends by itself, so `,` does not wait for it.",
            false => "A *task*: it can end.",
        };
        told(&lines, &process.doc, end)
    }

    /// Returns the text of a module: its parameters, ports and claims, whether it ends, and how it is run.
    pub(in crate::ide) fn module_text(&self, module: usize) -> String {
        let module = &self.model.modules[module];
        let params = module.params.as_deref().unwrap_or_default();
        let params: Vec<String> =
            std::iter::once("host".to_owned()).chain(params.iter().map(Param::to_string)).collect();
        let mut lines = format!("module {}({})", module.name.text, params.join(", "));
        if let Some(start) = &module.start {
            let _infallible = write!(lines, "\n    init {start}");
        }
        for port in &module.ports {
            let _infallible = write!(lines, "\n    {}", shown_port(&port.name.text, Some(port)));
        }
        for claim in &module.claims {
            let access = if claim.is_write { "" } else { "(read)" };
            let _infallible = write!(lines, "\n    claims {}{access}", claim.name.text);
        }
        let outcomes: Vec<&str> = module.outcomes.iter().map(|outcome| outcome.name.text.as_str()).collect();
        if !outcomes.is_empty() {
            let _infallible = write!(lines, "\n    done({})", outcomes.join(" | "));
        }
        if let Some(exec) = &module.exec {
            let _infallible = write!(lines, "\n    exec \"{exec}\"");
        }
        for (name, value) in &module.environment.variables {
            let _infallible = write!(lines, "\n    env {name} = {value:?}");
        }
        let inherited: Vec<&str> = module.environment.inherited.iter().map(String::as_str).collect();
        if !inherited.is_empty() {
            let _infallible = write!(lines, "\n    inherit {}", inherited.join(", "));
        }
        if let Some(directory) = &module.environment.directory {
            let _infallible = write!(lines, "\n    directory {directory:?}");
        }
        told(&lines, &module.doc, &format!("{}{}", end_of(module), memory_of(module)))
    }

    pub(super) fn export_text(&self, process: usize, place: usize) -> String {
        let process = &self.model.processes[process];
        let export = &process.exports[place];
        let port = self.port_behind(process, &export.endpoint);
        let inner = self.text(process.instances[export.endpoint.slot].name.span);
        let shown = code(&self.port_lines(&export.name.text, port));
        format!("{shown}\nA port of `{}`: the port of `{inner}`, `{}`.", process.name.text, export.endpoint.port.text)
    }

    pub(super) fn port_text(&self, module: usize, port: usize) -> String {
        let module = &self.model.modules[module];
        let port = &module.ports[port];
        let optional = if port.is_optional { " The module works without it." } else { "" };
        format!("{}\nA port of `{}`.{optional}", code(&self.port_lines(&port.name.text, Some(port))), module.name.text)
    }

    /// Returns the text of a port, with the fields of its messages if a text declares them.
    fn port_lines(&self, name: &str, port: Option<&Port>) -> String {
        let shown = shown_port(name, port);
        let kind = port.and_then(|port| port.kind.as_ref());
        let named = kind.and_then(|kind| self.model.named(kind.name()?, kind.span.origin));
        match named.map(|named| &self.model.types[named]) {
            Some(named) => format!("{shown}\ntype {} = {};", named.name.text, named.kind),
            None => shown,
        }
    }

    /// Returns the text of a named type, with its fields.
    pub(super) fn type_text(&self, named: usize) -> String {
        let named = &self.model.types[named];
        let doc = if named.doc.is_empty() { String::new() } else { format!("\n\n{}", named.doc) };
        format!("{}{doc}", code(&format!("type {} = {};", named.name.text, named.kind)))
    }

    /// Returns the text of the field with this declaration.
    pub(super) fn field_text(&self, declaration: Span) -> String {
        let mut fields = self.model.fields();
        let field = fields.find(|field| field.name.span == declaration);
        field.map_or(String::new(), |field| format!("{}\nA field.{}", code(&field.to_string()), quantity(field)))
    }

    /// Returns the port of a module that a group exports as its own port.
    pub(in crate::ide) fn port_behind<'a>(&'a self, process: &'a Process, endpoint: &'a Endpoint) -> Option<&'a Port> {
        let (mut process, mut endpoint) = (process, endpoint);
        for _ in 0..crate::plan::DEPTH_MAX {
            match process.instances[endpoint.slot].target {
                Target::Module(module) => {
                    let mut ports = self.model.modules[module].ports.iter();
                    return ports.find(|port| port.name.text == endpoint.port.text);
                }
                Target::Process(target) => {
                    process = &self.model.processes[target];
                    let mut exports = process.exports.iter();
                    let Some(export) = exports.find(|export| export.name.text == endpoint.port.text) else {
                        return process.message_port(&endpoint.port.text);
                    };
                    endpoint = &export.endpoint;
                }
                Target::Unknown => return None,
            }
        }
        None
    }
}

/// Returns `in Port: Type`.
pub(in crate::ide) fn shown_port(name: &str, port: Option<&Port>) -> String {
    let Some(port) = port else { return name.to_owned() };
    let optional = if port.is_optional { " optional" } else { "" };
    if let Some(call) = &port.call {
        let text = |kind: &Option<crate::check::spec::Kind>| kind.as_ref().map(ToString::to_string).unwrap_or_default();
        let (argument, result) = (text(&call.argument), text(&port.kind));
        let answers = if result.is_empty() { String::new() } else { format!(" -> {result}") };
        return match call.role {
            CallRole::Procedure => format!("proc {name}({argument}){answers}"),
            CallRole::State => format!("state {name}: {result}"),
            CallRole::Caller => format!("calls {name}({argument}){answers}{optional}"),
        };
    }
    let direction = if port.direction == Direction::In { "in" } else { "out" };
    let kind = port.kind.as_ref().map_or(String::new(), |kind| format!(": {kind}"));
    format!("{direction} {name}{kind}{optional}")
}

fn end_of(module: &Module) -> &'static str {
    match (module.is_service, module.has_end, module.kind) {
        (true, _, _) => "A *service*: it never ends by itself, so `,` does not wait for it.",
        (false, true, _) => "A *task*: it ends by itself.",
        (false, false, LeafKind::Plain) => "A plain program: done when it exits with 0.",
        (false, false, LeafKind::Controller) if module.is_asked => {
            "Its program in Python has its interface. `dca check` asks the program; an editor does not start it."
        }
        (false, false, LeafKind::Controller) => "Taken as a *task*: its interface does not say whether it ends.",
    }
}

/// Returns the quantity of the type of a parameter or field.
pub(super) fn quantity(param: &Param) -> String {
    let kind = param.kind.as_ref().and_then(|kind| unit::of_type(&kind.text));
    kind.map_or(String::new(), |(_, example)| format!(" A quantity such as `{example}`."))
}

/// Returns the remark for a module that remembers its state, so that its program may not be restarted alone. For other
/// modules, the text is empty.
fn memory_of(module: &Module) -> &'static str {
    match module.remembers {
        true => " The module *remembers*: it may not be restarted alone.",
        false => "",
    }
}

fn told(lines: &str, doc: &str, end: &str) -> String {
    let doc = if doc.is_empty() { String::new() } else { format!("\n\n{doc}") };
    format!("{}{doc}\n\n{end}", code(lines))
}
