//! Checks named types: records that contain themselves, records that are too large, misspelt names.

use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{FIELDS_MAX, Kind, Module, NamedType, Spec};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::DEPTH_MAX;
use crate::similar::Near;
use crate::source::Span;
use crate::unit;
use ros::logic::library;
use ros::logic::name::is_spec_name;

/// Checks the named types. A type that contains itself or is too large is reported, and treated as unknown.
pub(super) fn check(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    let parts = spec.types.iter().map(|named| Part::all(spec, &named.kind)).collect();
    let mut walk =
        Walk { types: &spec.types, parts, states: vec![State::New; spec.types.len()], path: Vec::new(), diagnostics };
    for named in 0..spec.types.len() {
        walk.visit(named);
    }
    let is_sound: Vec<bool> = walk.states.iter().map(|state| matches!(state, State::Closed(_))).collect();
    report_misspelt(spec, diagnostics);
    report_ros(spec, diagnostics);
    spec.type_names.values_mut().for_each(|all| all.retain(|&named| is_sound[named]));
    spec.type_names.retain(|_, all| !all.is_empty());
}

/// The use of a named type in another type, with its place.
struct Part {
    named: usize,
    span: Span,
}

impl Part {
    fn all(spec: &Spec, kind: &Kind) -> Vec<Self> {
        let mut parts = Vec::new();
        let mut kinds = vec![kind];
        while let Some(kind) = kinds.pop() {
            let named = kind.name().and_then(|name| spec.named(name, kind.span.origin));
            parts.extend(named.map(|named| Self { named, span: kind.span }));
            kinds.extend(kind.fields.iter().flatten().rev().filter_map(|field| field.kind.as_ref()));
        }
        parts
    }
}

#[derive(Clone, Copy)]
struct Size {
    fields: usize,
    depth: usize,
}

#[derive(Clone, Copy)]
enum State {
    New,
    /// The type is on the path from the start of the walk.
    Open,
    Closed(Size),
    /// The type has an error, which is reported.
    Refused,
}

struct Walk<'a> {
    types: &'a [NamedType],
    /// For each type, the named types in it.
    parts: Vec<Vec<Part>>,
    states: Vec<State>,
    /// The types on the path from the start of the walk. Each has the number of its parts that were visited.
    path: Vec<(usize, usize)>,
    diagnostics: &'a mut Diagnostics,
}

impl Walk<'_> {
    /// Walks depth first. It uses no recursion, because the depth of the input is not known yet.
    fn visit(&mut self, start: usize) {
        if !matches!(self.states[start], State::New) {
            return;
        }
        self.states[start] = State::Open;
        self.path.push((start, 0));
        while let Some((named, next)) = self.path.last_mut() {
            let Some(part) = self.parts[*named].get(*next) else {
                let named = *named;
                self.path.pop();
                self.close(named);
                continue;
            };
            *next += 1;
            let named = part.named;
            match self.states[named] {
                State::New => {
                    self.states[named] = State::Open;
                    self.path.push((named, 0));
                }
                State::Open => self.refuse_circle(named),
                State::Closed(_) | State::Refused => {}
            }
        }
    }

    fn close(&mut self, named: usize) {
        if !matches!(self.states[named], State::Open) {
            return;
        }
        let own = own_size(&self.types[named].kind);
        let sizes = self.parts[named].iter().filter_map(|part| match self.states[part.named] {
            State::Closed(size) => Some(size),
            State::New | State::Open | State::Refused => None,
        });
        let depth = own.depth + sizes.clone().map(|size| size.depth).max().unwrap_or_default();
        let fields = sizes.fold(own.fields, |sum, size| sum.saturating_add(size.fields));
        let Kind { span, .. } = self.types[named].kind;
        let name = &self.types[named].name.text;
        self.states[named] = if depth > DEPTH_MAX {
            let message = format!("records are nested deeper than {DEPTH_MAX} levels in `{name}`");
            self.diagnostics.push(Diagnostic::new(Code::E0004, span, message));
            State::Refused
        } else if fields > FIELDS_MAX {
            let message =
                format!("`{name}` has {fields} fields, including the fields of its records; the limit is {FIELDS_MAX}");
            self.diagnostics.push(Diagnostic::new(Code::E0702, span, message));
            State::Refused
        } else {
            State::Closed(Size { fields, depth })
        };
    }

    /// Reports a type that contains itself. All types on the way get one report together.
    fn refuse_circle(&mut self, named: usize) {
        let start = self.path.iter().position(|(other, _)| *other == named).unwrap_or_default();
        let circle: Vec<(usize, usize)> = self.path[start..].to_vec();
        let name = |named: usize| self.types[named].name.text.as_str();
        let mut names: Vec<&str> = circle.iter().map(|(named, _)| name(*named)).collect();
        names.push(name(named));
        // The number of visited parts includes the current part.
        let step = |(named, next): &(usize, usize)| self.parts[*named][next - 1].span;
        let Some((last, others)) = circle.split_last() else { return };
        let message = format!("`{}` contains itself: {}", name(named), names.join(" -> "));
        let mut diagnostic = Diagnostic::new(Code::E0103, step(last), message).label("closes the circle");
        for other in others {
            diagnostic = diagnostic.reason(step(other), "goes on here");
        }
        self.diagnostics.push(diagnostic.help("a value of this type would have no end"));
        for (named, _) in circle {
            self.states[named] = State::Refused;
        }
    }
}

/// Returns the fields and levels of a type, without the content of named types in it.
fn own_size(kind: &Kind) -> Size {
    let fields = kind.fields.iter().flatten();
    let inner = fields.map(|field| field.kind.as_ref().map_or(Size { fields: 0, depth: 0 }, own_size));
    inner.fold(Size { fields: 0, depth: 1 }, |sum, inner| Size {
        fields: sum.fields + 1 + inner.fields,
        depth: sum.depth.max(inner.depth + 1),
    })
}

/// Reports unknown types of parameters and fields if their names are similar to a known name.
fn report_misspelt(spec: &Spec, diagnostics: &mut Diagnostics) {
    let modules = spec.modules.iter().flat_map(Module::declared);
    let params = spec.processes.iter().flat_map(|process| &process.params).chain(modules);
    let kinds = params.chain(spec.fields()).filter_map(|param| param.kind.as_ref());
    let mut known: Vec<&str> = unit::names().collect();
    known.extend(spec.types.iter().map(|named| named.name.text.as_str()));
    for (kind, name) in kinds.filter_map(|kind| Some((kind, kind.name()?))) {
        if unit::is_type(name) || spec.type_names.contains_key(name) || is_spec_name(name) {
            continue;
        }
        if let Some(near) = diagnostics.near(name, known.iter().copied()) {
            let found = misspelt(kind, name, &near);
            diagnostics.push(found);
        }
    }
}

/// Reports types of ROS 2 that are not standard types. Any port, parameter or field may have a type of ROS 2.
fn report_ros(spec: &Spec, diagnostics: &mut Diagnostics) {
    let modules = spec.modules.iter();
    let ports = modules.clone().flat_map(|module| &module.ports);
    let ports =
        ports.flat_map(|port| port.kind.iter().chain(port.call.iter().filter_map(|call| call.argument.as_ref())));
    let params = spec.processes.iter().flat_map(|process| &process.params);
    let params = params.chain(modules.flat_map(Module::declared)).chain(spec.fields());
    let kinds = ports.chain(params.filter_map(|param| param.kind.as_ref()));
    let named = kinds.filter_map(|kind| Some((kind, kind.name().filter(|name| is_spec_name(name))?)));
    let unknown: Vec<(&Kind, &str)> = named.filter(|(_, name)| library::by_spec(name).is_none()).collect();
    if unknown.is_empty() {
        return;
    }
    let known: Vec<String> = library::messages().map(|name| name.spec()).collect();
    for (kind, name) in unknown {
        let found = match diagnostics.near(name, known.iter().map(String::as_str)) {
            Some(near) => misspelt(kind, name, &near),
            None => Diagnostic::new(Code::W0206, kind.span, format!("`{name}` is not a standard message of ROS 2"))
                .help("`dca echo` and records show values of this type as bytes"),
        };
        diagnostics.push(found);
    }
}

fn misspelt(kind: &Kind, name: &str, near: &Near<'_>) -> Diagnostic {
    let message = format!("`{name}` is not a known type");
    let found = Diagnostic::new(Code::W0206, kind.span, message).label(format!("did you mean `{}`?", near.name));
    let length = u32::try_from(name.len()).unwrap_or(u32::MAX);
    let span = Span { end: kind.span.start.saturating_add(length).min(kind.span.end), ..kind.span };
    found.rename(span, near)
}
